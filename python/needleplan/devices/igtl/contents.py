"""Encoding of message bodies without poses: STATUS, STRING, POINT, POLYDATA, SENSOR, NDARRAY, requests and replies."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from math import prod

import numpy as np
import numpy.typing as npt

from needleplan.artifacts import CallRepr
from needleplan.devices.igtl.messages import padded, text_of
from needleplan.errors import InputError, Mistake, ProtocolError

__all__ = [
    "IgtlStatus",
    "Point",
    "Sensor",
    "StatusCode",
    "Unit",
    "decode_array",
    "decode_points",
    "decode_reply",
    "decode_start",
    "encode_array",
    "encode_points",
    "encode_polyline",
    "encode_reply",
    "encode_sensor",
    "encode_start",
    "encode_status",
    "encode_string",
]

_STATUS = struct.Struct(">Hq20s")
_STRING = struct.Struct(">HH")
_POINT = struct.Struct(">64s32s4B4f20s")
_SENSOR = struct.Struct(">BBQ")
_POLYDATA = struct.Struct(">10I")
_START = struct.Struct(">I32s")
_NUMBERS = {2: "i1", 3: "u1", 4: ">i2", 5: ">u2", 6: ">i4", 7: ">u4", 10: ">f4", 11: ">f8"}
"""Types of the numbers of NDARRAY (source: `igtl_ndarray.h` of the OpenIGTLink library), without complex ones."""

_MOST_DIMENSIONS = 4  # largest number of dimensions of an NDARRAY; numpy has a limit of its own

_ASCII, _UTF8, _LATIN = 3, 106, 4
_ENCODINGS = {_ASCII: "ascii", _UTF8: "utf-8", _LATIN: "latin-1"}


class StatusCode(IntEnum):
    """Status codes of OpenIGTLink STATUS messages."""

    INVALID = 0
    OK = 1
    UNKNOWN_ERROR = 2
    PANIC = 3
    NOT_FOUND = 4
    ACCESS_DENIED = 5
    BUSY = 6
    TIMEOUT = 7
    OVERFLOW = 8
    CHECKSUM_ERROR = 9
    CONFIGURATION_ERROR = 10
    RESOURCE_ERROR = 11
    UNKNOWN_INSTRUCTION = 12
    NOT_READY = 13
    MANUAL = 14
    DISABLED = 15
    NOT_PRESENT = 16
    UNKNOWN_VERSION = 17
    HARDWARE_FAILURE = 18
    SHUTTING_DOWN = 19


_CODES = frozenset(map(int, StatusCode))


class Unit(IntEnum):
    """Units of SENSOR as 64-bit numbers: a prefix (4 bits), then units (6 bits each) with exponents (4 bits each)."""

    NONE = 0
    NEWTON = 0x0B << 54 | 1 << 50
    MILLIMETRE = 0xB << 60 | 0x01 << 54 | 1 << 50
    NEWTON_METRE = 0x0B << 54 | 1 << 50 | 0x01 << 44 | 1 << 40
    NEWTON_MILLIMETRE = 0xB << 60 | NEWTON_METRE


@dataclass(frozen=True)
class IgtlStatus:
    """Status of a device: code, name, text, and a device-specific subcode."""

    code: StatusCode
    name: str = ""
    text: str = ""
    subcode: int = 0


@dataclass(frozen=True)
class Point(CallRepr):
    """A named point in mm; `colour` holds red, green, blue and opacity, each from 0 to 255."""

    name: str
    position_mm: tuple[float, float, float]
    group: str = ""
    colour: tuple[int, int, int, int] = (255, 255, 0, 255)
    diameter_mm: float = 0.0
    owner: str = ""


@dataclass(frozen=True)
class Sensor(CallRepr):
    """Up to 255 readings in the same unit; `unit` may also be a 64-bit number that is not in `Unit`."""

    values: tuple[float, ...]
    unit: int = Unit.NONE


def encode_status(status: IgtlStatus) -> bytes:
    """Return the body of STATUS. Raises InputError if the name is longer than 20 bytes."""
    return _STATUS.pack(status.code, status.subcode, padded(status.name, 20, "status name")) + status.text.encode()


def encode_string(text: str) -> bytes:
    """Return the body of STRING, in ASCII if possible, else in UTF-8. Raises InputError above 65535 bytes."""
    data = text.encode()
    if len(data) > 0xFFFF:
        raise InputError(Mistake("text", text, "must have at most 65535 bytes"))
    return _STRING.pack(_ASCII if data.isascii() else _UTF8, len(data)) + data


def encode_points(points: Sequence[Point]) -> bytes:
    """Return the body of POINT. Raises InputError if a name (64 bytes), group (32) or owner (20) is too long."""
    return b"".join(
        _POINT.pack(
            padded(point.name, 64, "point"), padded(point.group, 32, "group"), *point.colour, *point.position_mm,
            point.diameter_mm, padded(point.owner, 20, "owner"),
        )
        for point in points
    )  # fmt: skip


def decode_points(content: bytes) -> tuple[Point, ...]:
    """Return the points in the body of POINT. Raises ProtocolError."""
    if len(content) % _POINT.size:
        raise ProtocolError(f"OpenIGTLink: POINT of {len(content)} bytes")
    return tuple(
        Point(text_of(name), (x, y, z), text_of(group), (red, green, blue, opacity), diameter, text_of(owner))
        for name, group, red, green, blue, opacity, x, y, z, diameter, owner in _POINT.iter_unpack(content)
    )


def encode_polyline(points_mm: Sequence[tuple[float, float, float]]) -> bytes:
    """Return the body of POLYDATA with one line through `points_mm`; fewer than two points give no line."""
    count = len(points_mm) if len(points_mm) > 1 else 0
    flat = [number for point in points_mm[:count] for number in point]
    lines = [count, *range(count)] if count else []
    head = _POLYDATA.pack(count, 0, 0, int(count > 0), 4 * len(lines), 0, 0, 0, 0, 0)
    return head + struct.pack(f">{len(flat)}f{len(lines)}I", *flat, *lines)


def encode_sensor(sensor: Sensor) -> bytes:
    """Return the body of SENSOR. Raises InputError for more than 255 readings."""
    if len(sensor.values) > 0xFF:
        raise InputError(Mistake("values", str(len(sensor.values)), "must be at most 255 (number of readings)"))
    return _SENSOR.pack(len(sensor.values), 0, sensor.unit) + struct.pack(f">{len(sensor.values)}d", *sensor.values)


def encode_array(array: npt.NDArray[np.float64]) -> bytes:
    """Return the body of NDARRAY, with numbers of 8 bytes."""
    return struct.pack(f">BB{array.ndim}H", 11, array.ndim, *array.shape) + array.astype(">f8").tobytes()


def decode_array(content: bytes) -> npt.NDArray[np.float64]:
    """Return the array in the body of NDARRAY, in its shape. Raises ProtocolError; complex numbers are none of ours."""
    size = content[1] if len(content) > 1 else 0
    begin = 2 + 2 * size
    if not 1 <= size <= _MOST_DIMENSIONS or len(content) < begin or content[0] not in _NUMBERS:
        raise ProtocolError(f"OpenIGTLink: NDARRAY of {len(content)} bytes, or of another type of numbers")
    shape = struct.unpack_from(f">{size}H", content, 2)
    kind = np.dtype(_NUMBERS[content[0]])
    if len(content) != begin + kind.itemsize * prod(shape):
        raise ProtocolError(f"OpenIGTLink: NDARRAY of {len(content)} bytes for the shape {shape}")
    return np.frombuffer(content, kind, offset=begin).reshape(shape).astype(np.float64)


def encode_start(interval_ms: int, coordinates: str = "") -> bytes:
    """Return the body of STT_TDATA and STT_QTDATA, which request frames at least `interval_ms` apart.

    Raises InputError if `interval_ms` is out of range or `coordinates` is longer than 32 bytes.
    """
    if not 0 <= interval_ms < 1 << 31:
        raise InputError(Mistake("interval_ms", str(interval_ms), "must be from 0 to 2147483647"))
    return _START.pack(interval_ms, padded(coordinates, 32, "coordinates"))


def decode_start(content: bytes) -> tuple[int, str]:
    """Return interval (ms) and coordinate system in the body of STT_TDATA or STT_QTDATA. Raises ProtocolError."""
    if len(content) != _START.size:
        raise ProtocolError(f"OpenIGTLink: STT_TDATA of {len(content)} bytes")
    interval_ms, coordinates = _START.unpack(content)
    return interval_ms, text_of(coordinates)


def encode_reply(granted: bool) -> bytes:
    """Return the body of RTS_TDATA and similar replies: whether the request is granted."""
    return b"\0" if granted else b"\1"


def decode_reply(content: bytes) -> bool:
    """Return whether the body of a RTS_ reply grants the request, as an empty body does. Raises ProtocolError."""
    if len(content) > 1:
        raise ProtocolError(f"OpenIGTLink: RTS_ of {len(content)} bytes")
    return content in (b"", b"\0")
