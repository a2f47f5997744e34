"""Kinds of messages: numbers as ROS 2 messages (CDR), everything else as JSON; Foxglove reads both.

A `Packed` message costs as many bytes as its numbers. Its fields stand in the order of their size, so that CDR has no
padding, and its strings at the end; a kind is therefore one `struct` and its strings. A sample may be anything that has
the attributes, such as those of `needleplan.devices`: recordings know what a sample looks like, not who made it.
"""

from __future__ import annotations

import json
import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from needleplan.errors import DataError, Mistake

__all__ = ["EVENT", "FORCE", "POSE", "STAGE", "STATUS", "Field", "Json", "Kind", "Packed"]

_CODES = {"int64": "q", "uint64": "Q", "float64": "d", "int32": "i", "uint32": "I", "uint8": "B", "bool": "?"}
_ORDER = ("int64", "uint64", "float64", "int32", "uint32", "uint8", "bool", "string")
_SIZES = {"int64": 8, "uint64": 8, "float64": 8, "int32": 4, "uint32": 4, "uint8": 1, "bool": 1, "string": 0}
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


class Kind(ABC):
    """How a message becomes bytes, and its schema; abstract."""

    name: str
    encoding: str
    schema_encoding: str

    @property
    @abstractmethod
    def schema(self) -> bytes:
        """The schema as it stands in the file."""

    @abstractmethod
    def encode(self, value: Any) -> bytes:
        """Return the bytes of a message. Raises ValueError, TypeError, KeyError or struct.error for another value."""

    @abstractmethod
    def decode(self, data: bytes) -> dict[str, Any]:
        """Return the fields of a message. Raises DataError."""


@dataclass(frozen=True)
class Field:
    """A field of a packed message: a ROS 2 type; `choices` are the names of the values of a `uint8`."""

    name: str
    type: str = "float64"
    choices: tuple[str, ...] = ()
    comment: str = ""


@dataclass(frozen=True)
class Packed(Kind):
    """A ROS 2 message of numbers and strings, `package/msg/Name`.

    Fields must stand in the order int64, uint64, float64, int32, uint32, uint8 or bool, string. `row` makes the values
    of a sample; without it, a value is a mapping by the names of its fields. Raises DataError for a wrong order.
    """

    name: str
    fields: tuple[Field, ...]
    row: Callable[[Any], Sequence[Any]] | None = None
    encoding = "cdr"
    schema_encoding = "ros2msg"
    _numbers: struct.Struct = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        unknown = [Mistake(each.name, each.type, "is no type of a message") for each in self.fields
                   if each.type not in _ORDER]  # fmt: skip
        if unknown:
            raise DataError(unknown, self.name)
        sizes = [_SIZES[each.type] for each in self.fields]
        if sizes != sorted(sizes, reverse=True) or len({each.name for each in self.fields}) != len(self.fields):
            raise DataError("fields must have names of their own and stand in the order of their size", self.name)
        codes = "".join(_CODES[each.type] for each in self.fields if each.type != "string")
        object.__setattr__(self, "_numbers", struct.Struct(f"<4s{codes}"))

    @property
    def schema(self) -> bytes:
        """The definition in the language of ROS 2."""
        lines: list[str] = []
        for each in self.fields:
            prefix = each.name.upper()
            lines += [f"uint8 {prefix}_{choice.upper()}={code}" for code, choice in enumerate(each.choices)]
            lines.append(f"{each.type} {each.name}" + (f"  # {each.comment}" if each.comment else ""))
        return ("\n".join(lines) + "\n").encode()

    def encode(self, value: Any) -> bytes:
        """Return CDR, little-endian."""
        values = self.row(value) if self.row else [value[each.name] for each in self.fields]
        numbers: list[Any] = []
        texts: list[str] = []
        for each, one in zip(self.fields, values, strict=True):
            if each.type == "string":
                texts.append(one)
            else:
                numbers.append(each.choices.index(one) if each.choices else one)
        data = self._numbers.pack(_LITTLE_ENDIAN, *numbers)
        for text in texts:
            words = text.encode().replace(b"\0", b"") + b"\0"
            data += b"\0" * (-len(data) % 4) + struct.pack("<I", len(words)) + words
        return data

    def decode(self, data: bytes) -> dict[str, Any]:
        """Return the fields by their names; `uint8` with choices as their name."""
        try:
            mark, *numbers = self._numbers.unpack_from(data)
            if mark != _LITTLE_ENDIAN:
                raise ValueError("it is not little-endian CDR")
            found: dict[str, Any] = {}
            at, rest = self._numbers.size, iter(numbers)
            for each in self.fields:
                if each.type != "string":
                    number = next(rest)
                    found[each.name] = each.choices[number] if each.choices else number
                    continue
                at += -at % 4
                (length,) = struct.unpack_from("<I", data, at)
                words = data[at + 4 : at + 4 + length]
                if len(words) != length or not words.endswith(b"\0"):
                    raise ValueError("a string is cut off")
                found[each.name] = words[:-1].decode()
                at += 4 + length
        except (struct.error, ValueError, IndexError) as error:
            raise DataError(f"a message of {self.name} is damaged: {error}") from error
        return found

    @classmethod
    def from_schema(cls, name: str, schema: bytes) -> Packed:
        """Return the kind that a file describes, to decode what another version wrote. Raises DataError."""
        fields, choices = [], []
        for line in schema.decode("utf-8", "replace").splitlines():
            words, _, comment = line.partition("#")
            match words.split():
                case ["uint8", constant] if "=" in constant:
                    choices.append(constant.partition("=")[0])
                case [type_, field_name]:
                    prefix = f"{field_name.upper()}_"
                    its = tuple(each.removeprefix(prefix).lower() for each in choices if each.startswith(prefix))
                    fields.append(Field(field_name, type_, its if type_ == "uint8" else (), comment.strip()))
                case []:
                    pass
                case _:
                    raise DataError(Mistake("schema", line, "is not understood"), name)
        return cls(name, tuple(fields))


@dataclass(frozen=True)
class Json(Kind):
    """A JSON object; `properties` are those of its JSON schema. NaN and infinite numbers become null."""

    name: str
    properties: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    encoding = "json"
    schema_encoding = "jsonschema"

    @property
    def schema(self) -> bytes:
        """The JSON schema."""
        return json.dumps({"title": self.name, "type": "object", "properties": dict(self.properties)}).encode()

    def encode(self, value: Any) -> bytes:
        """Return UTF-8."""
        plain = _plain(value)
        if not isinstance(plain, dict):
            raise TypeError(f"must be a mapping, not {type(value).__name__}")
        return json.dumps(plain, allow_nan=False, separators=(",", ":")).encode()

    def decode(self, data: bytes) -> dict[str, Any]:
        """Return the object."""
        try:
            found = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise DataError(f"a message of {self.name} is damaged: {error}") from error
        if not isinstance(found, dict):
            raise DataError(f"a message of {self.name} is damaged: not an object")
        return found


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _plain(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if hasattr(value, "tolist"):  # arrays and numbers of numpy
        return _plain(value.tolist())
    return value


class _Stamp(Protocol):
    @property
    def received_ns(self) -> int: ...
    @property
    def sequence(self) -> int: ...
    @property
    def lost(self) -> int: ...
    @property
    def device_time_s(self) -> float | None: ...


class _Sample(Protocol):
    @property
    def stamp(self) -> _Stamp: ...
    @property
    def health(self) -> str: ...
    @property
    def notes(self) -> tuple[str, ...]: ...


class _Force(_Sample, Protocol):
    @property
    def force_n(self) -> tuple[float, float, float]: ...
    @property
    def torque_n_mm(self) -> tuple[float, float, float]: ...


class _Pose(_Sample, Protocol):
    @property
    def position_mm(self) -> tuple[float, float, float]: ...
    @property
    def quaternion(self) -> tuple[float, float, float, float]: ...
    @property
    def error_mm(self) -> float: ...


class _Stage(_Sample, Protocol):
    @property
    def depth_mm(self) -> float: ...
    @property
    def velocity_mm_s(self) -> float: ...
    @property
    def roll_rad(self) -> float: ...
    @property
    def moving(self) -> bool: ...


def _start(sample: _Sample) -> tuple[Any, ...]:
    stamp = sample.stamp
    device_time_s = math.nan if stamp.device_time_s is None else stamp.device_time_s
    return stamp.received_ns, stamp.sequence, device_time_s


def _force_row(sample: _Force) -> tuple[Any, ...]:
    end = (sample.stamp.lost, str(sample.health), "; ".join(sample.notes))
    return (*_start(sample), *sample.force_n, *sample.torque_n_mm, *end)


def _pose_row(sample: _Pose) -> tuple[Any, ...]:
    end = (sample.stamp.lost, str(sample.health), "; ".join(sample.notes))
    return (*_start(sample), *sample.position_mm, *sample.quaternion, sample.error_mm, *end)


def _stage_row(sample: _Stage) -> tuple[Any, ...]:
    numbers = (sample.depth_mm, sample.velocity_mm_s, sample.roll_rad)
    end = (sample.stamp.lost, str(sample.health), sample.moving, "; ".join(sample.notes))
    return (*_start(sample), *numbers, *end)


_HEAD = (
    Field("received_ns", "int64", comment="on the monotonic clock of the recording machine"),
    Field("sequence", "uint64", comment="the device's own number"),
    Field("device_time_s", comment="NaN where the device has no clock"),
)
_LOST = Field("lost", "uint32", comment="samples lost just before this one")
_HEALTH = Field("health", "uint8", ("good", "suspect", "missing"))
_NOTES = Field("notes", "string")


def _numbers(names: str) -> tuple[Field, ...]:
    return tuple(Field(name) for name in names.split())


FORCE = Packed(
    "needleplan_msgs/msg/Force",
    (*_HEAD, *_numbers("force_x_n force_y_n force_z_n torque_x_n_mm torque_y_n_mm torque_z_n_mm"),
     _LOST, _HEALTH, _NOTES),
    _force_row,
)  # fmt: skip
"""A wrench at the base of the needle, in the frame of the sensor."""

POSE = Packed(
    "needleplan_msgs/msg/Pose",
    (*_HEAD, *_numbers("x_mm y_mm z_mm qw qx qy qz error_mm"), _LOST, _HEALTH, _NOTES),
    _pose_row,
)
"""A pose of a tracked coil."""

STAGE = Packed(
    "needleplan_msgs/msg/Stage",
    (*_HEAD, *_numbers("depth_mm velocity_mm_s roll_rad"), _LOST, _HEALTH, Field("moving", "bool"), _NOTES),
    _stage_row,
)
"""Where the stage is."""

EVENT = Json(
    "needleplan.Event",
    {"name": {"type": "string"}, "cause": {"type": "string"}, "text": {"type": "string"}},
)
"""Something happened: its name, its cause, and a sentence; further entries are welcome."""

STATUS = Json(
    "needleplan.RecorderStatus",
    {
        "state": {"type": "string"},
        "cause": {"type": "string"},
        "written": {"type": "integer"},
        "overflowed": {"type": "object", "additionalProperties": {"type": "integer"}},
        "refused": {"type": "integer"},
    },
)
"""What the recorder says of itself, whenever it changes."""
