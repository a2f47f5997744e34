"""Bodies of messages that only a display reads: STATUS, STRING, POLYDATA, SENSOR."""

from __future__ import annotations

import struct

from needleplan.devices.igtl.contents import IgtlStatus, Sensor, StatusCode
from needleplan.devices.igtl.messages import text_of
from needleplan.errors import ProtocolError

_STATUS = struct.Struct(">Hq20s")
_STRING = struct.Struct(">HH")
_SENSOR = struct.Struct(">BBQ")
_POLYDATA = struct.Struct(">10I")
_CODES = frozenset(map(int, StatusCode))
_ENCODINGS = {3: "ascii", 106: "utf-8", 4: "latin-1"}


def decode_status(content: bytes) -> IgtlStatus:
    """Return the status in the body of STATUS; unknown codes become UNKNOWN_ERROR. Raises ProtocolError."""
    if len(content) < _STATUS.size:
        raise ProtocolError(f"OpenIGTLink: STATUS of {len(content)} bytes")
    number, subcode, name = _STATUS.unpack_from(content)
    code = StatusCode(number) if number in _CODES else StatusCode.UNKNOWN_ERROR
    return IgtlStatus(code, text_of(name), text_of(content[_STATUS.size :]), subcode)


def decode_string(content: bytes) -> str:
    """Return the text in the body of STRING; undecodable bytes become U+FFFD. Raises ProtocolError."""
    if len(content) < _STRING.size:
        raise ProtocolError(f"OpenIGTLink: STRING of {len(content)} bytes")
    encoding, length = _STRING.unpack_from(content)
    if length != len(content) - _STRING.size or encoding not in _ENCODINGS:
        raise ProtocolError(f"OpenIGTLink: STRING has a wrong length ({length}) or an unknown encoding ({encoding})")
    return content[_STRING.size :].decode(_ENCODINGS[encoding], "replace")


def decode_polyline(content: bytes) -> tuple[tuple[float, float, float], ...]:
    """Return the points of the line in the body of POLYDATA; () without a line.

    Raises ProtocolError for other shapes.
    """
    if len(content) < _POLYDATA.size:
        raise ProtocolError(f"OpenIGTLink: POLYDATA of {len(content)} bytes")
    count, *others = _POLYDATA.unpack_from(content)
    if not any((count, *others)) and len(content) == _POLYDATA.size:
        return ()
    if others != [0, 0, 1, 4 * count + 4, 0, 0, 0, 0, 0] or len(content) != _POLYDATA.size + 16 * count + 4:
        raise ProtocolError("OpenIGTLink: POLYDATA is not a single line")
    numbers = struct.unpack_from(f">{3 * count}f{count + 1}I", content, _POLYDATA.size)
    points = [(numbers[at], numbers[at + 1], numbers[at + 2]) for at in range(0, 3 * count, 3)]
    length, *order = numbers[3 * count :]
    if length != count or any(index >= count for index in order):
        raise ProtocolError("OpenIGTLink: the line of POLYDATA refers to missing points")
    return tuple(points[index] for index in order)


def decode_sensor(content: bytes) -> Sensor:
    """Return the readings in the body of SENSOR. Raises ProtocolError."""
    if len(content) < _SENSOR.size or len(content) != _SENSOR.size + 8 * content[0]:
        raise ProtocolError(f"OpenIGTLink: SENSOR of {len(content)} bytes")
    count, _, unit = _SENSOR.unpack_from(content)
    return Sensor(struct.unpack_from(f">{count}d", content, _SENSOR.size), unit)
