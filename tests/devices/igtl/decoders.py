"""Decoders of the message bodies that needleplan only sends: the inverse of the encoders, for intact bodies."""

import struct

from needleplan.devices.igtl.contents import (
    _POINT,
    _POLYDATA,
    _SENSOR,
    _STATUS,
    _STRING,
    IgtlStatus,
    Point,
    Sensor,
    StatusCode,
)
from needleplan.devices.igtl.messages import text_of


def decode_status(content: bytes) -> IgtlStatus:
    number, subcode, name = _STATUS.unpack_from(content)
    return IgtlStatus(StatusCode(number), text_of(name), text_of(content[_STATUS.size :]), subcode)


def decode_string(content: bytes) -> str:
    _, length = _STRING.unpack_from(content)
    assert length == len(content) - _STRING.size
    return content[_STRING.size :].decode()


def decode_points(content: bytes) -> tuple[Point, ...]:
    return tuple(
        Point(text_of(name), (x, y, z), text_of(group), (red, green, blue, opacity), diameter, text_of(owner))
        for name, group, red, green, blue, opacity, x, y, z, diameter, owner in _POINT.iter_unpack(content)
    )


def decode_polyline(content: bytes) -> tuple[tuple[float, float, float], ...]:
    count, *others = _POLYDATA.unpack_from(content)
    assert others == ([0, 0, 1, 4 * count + 4, 0, 0, 0, 0, 0] if count else [0] * 9)
    numbers = struct.unpack_from(f">{3 * count}f{count + 1 if count else 0}I", content, _POLYDATA.size)
    points = [(numbers[at], numbers[at + 1], numbers[at + 2]) for at in range(0, 3 * count, 3)]
    return tuple(points[index] for index in numbers[3 * count + 1 :])


def decode_sensor(content: bytes) -> Sensor:
    count, _, unit = _SENSOR.unpack_from(content)
    return Sensor(struct.unpack_from(f">{count}d", content, _SENSOR.size), unit)
