"""Encodings of messages: `Packed` for numbers (ROS 2 messages in CDR), `Json` for other values.

The program Foxglove reads both. The fields of a `Packed` message are ordered by decreasing size, with the strings last,
so that CDR needs no padding between numbers and one `struct` encodes all numbers.
"""

from __future__ import annotations

import json
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from needleplan.artifacts import CallRepr, json_values
from needleplan.errors import DataError, Mistake

__all__ = ["Field", "Json", "MessageKind", "Packed"]

_CODES = {"int64": "q", "uint64": "Q", "float64": "d", "int32": "i", "uint32": "I", "uint8": "B", "bool": "?"}
_KINDS = {"int64": "i8", "uint64": "u8", "float64": "f8", "int32": "i4", "uint32": "u4", "uint8": "u1"}
_ORDER = ("int64", "uint64", "float64", "int32", "uint32", "uint8", "bool", "string")
_SIZES = {"int64": 8, "uint64": 8, "float64": 8, "int32": 4, "uint32": 4, "uint8": 1, "bool": 1, "string": 0}
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"


class MessageKind(ABC):
    """Abstract base of the encodings: converts values to bytes and back, and describes the fields by a schema.

    Examples
    --------
    >>> from needleplan.recording import EVENT, FORCE
    >>> EVENT.encoding, FORCE.encoding
    ('json', 'cdr')
    """

    name: str
    encoding: str
    schema_encoding: str

    @property
    @abstractmethod
    def schema(self) -> bytes:
        """Description of the fields, as stored in the file."""

    @abstractmethod
    def encode(self, value: Any) -> bytes:
        """Return the bytes of a message.

        Parameters
        ----------
        value : object
            A value of this kind.

        Returns
        -------
        bytes
            The encoded message.

        Raises
        ------
        ValueError, TypeError, KeyError, struct.error
            The value does not fit the kind.

        """

    @abstractmethod
    def decode(self, data: bytes) -> dict[str, Any]:
        """Return the fields of a message.

        Parameters
        ----------
        data : bytes
            The encoded message.

        Returns
        -------
        dict
            The values by the name of their field.

        Raises
        ------
        DataError
            The bytes are damaged.

        """


@dataclass(frozen=True)
class Field(CallRepr):
    """A field of a packed message.

    Attributes
    ----------
    name : str
        Name of the field.
    type : str
        A ROS 2 type: int64, uint64, float64, int32, uint32, uint8, bool or string.
    choices : tuple of str
        Names of the values 0, 1, ... of a `uint8`.
    comment : str
        Comment in the schema, such as the unit.

    Examples
    --------
    >>> from needleplan.recording import Field, Packed
    >>> health = Field("health", "uint8", ("good", "suspect", "missing"))
    >>> Packed("needleplan_msgs/msg/Health", (health,)).encode({"health": "suspect"})[-1]
    1
    """

    name: str
    type: str = "float64"
    choices: tuple[str, ...] = ()
    comment: str = ""


@dataclass(frozen=True)
class Packed(CallRepr, MessageKind):
    """A message of numbers and strings, encoded as a ROS 2 message.

    Attributes
    ----------
    name : str
        Name of the message type, `package/msg/Name`.
    fields : tuple of Field
        The fields, ordered by size: first int64, uint64, float64; then int32, uint32; then uint8, bool; then string.
    row : callable, optional
        Returns the values of the fields for one value; if None, a value is a mapping by field name.

    Raises
    ------
    DataError
        A type is unknown, two fields have the same name, or the order is wrong.

    Examples
    --------
    >>> from needleplan.recording import Field, Packed
    >>> tip = Packed("needleplan_msgs/msg/Tip", (Field("x_mm"), Field("note", "string")))
    >>> tip.decode(tip.encode({"x_mm": 1.5, "note": "entry"}))
    {'x_mm': 1.5, 'note': 'entry'}

    """

    name: str
    fields: tuple[Field, ...]
    row: Callable[[Any], Sequence[Any]] | None = None
    encoding = "cdr"
    schema_encoding = "ros2msg"
    _numbers: struct.Struct = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        unknown = [Mistake(each.name, each.type, "is not a type of a message field") for each in self.fields
                   if each.type not in _ORDER]  # fmt: skip
        if unknown:
            raise DataError(unknown, self.name)
        sizes = [_SIZES[each.type] for each in self.fields]
        if sizes != sorted(sizes, reverse=True) or len({each.name for each in self.fields}) != len(self.fields):
            raise DataError("fields must have different names and be ordered by size", self.name)
        codes = "".join(_CODES[each.type] for each in self.fields if each.type != "string")
        object.__setattr__(self, "_numbers", struct.Struct(f"<4s{codes}"))

    @property
    def schema(self) -> bytes:
        """The message definition in the ROS 2 interface language."""
        lines: list[str] = []
        for each in self.fields:
            prefix = each.name.upper()
            lines += [f"uint8 {prefix}_{choice.upper()}={code}" for code, choice in enumerate(each.choices)]
            lines.append(f"{each.type} {each.name}" + (f"  # {each.comment}" if each.comment else ""))
        return ("\n".join(lines) + "\n").encode()

    def encode(self, value: Any) -> bytes:
        """Return the message in little-endian CDR; zero characters are removed from texts."""
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
        """Return the values by field name; a `uint8` with choices becomes a name.

        Raises DataError if `data` is damaged.
        """
        try:
            mark, *numbers = self._numbers.unpack_from(data)
            if mark != _LITTLE_ENDIAN:
                raise ValueError("the bytes are not little-endian CDR")
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

    def decode_block(self, block: Sequence[bytes]) -> dict[str, Any]:
        """Return many messages as columns.

        Parameters
        ----------
        block : sequence of bytes
            The encoded messages.

        Returns
        -------
        dict of str to ndarray
            One array of shape (messages,) for each field, with the types that `decode` returns; of uint64, as stored.

        Raises
        ------
        DataError
            A message is damaged.

        """
        size = self._numbers.size
        numbers = [(each.name, "u1" if each.type == "bool" else f"<{_KINDS[each.type]}")
                   for each in self.fields if each.type != "string"]  # fmt: skip
        joined = b"".join([message[:size] for message in block])
        if len(joined) != size * len(block):
            raise DataError(f"a message of {self.name} is damaged: it is cut off")
        rows = np.frombuffer(joined, np.dtype([("<mark>", "<u4"), *numbers]))
        # The ends of most messages are equal: each is decoded once.
        ends: dict[bytes, int] = {}
        codes = np.array([ends.setdefault(message[size:], len(ends)) for message in block], np.int32)
        firsts = np.unique(codes, return_index=True)[1]
        texts = [self.decode(block[first]) for first in firsts]
        if np.any(rows["<mark>"] != int.from_bytes(_LITTLE_ENDIAN, "little")):
            raise DataError(f"a message of {self.name} is damaged: the bytes are not little-endian CDR")
        columns: dict[str, Any] = {}
        for each in self.fields:
            if each.type == "string":
                columns[each.name] = np.array([text[each.name] for text in texts])[codes]
                continue
            column = rows[each.name]
            if each.choices:
                if column.max() >= len(each.choices):
                    raise DataError(f"a message of {self.name} is damaged: {each.name} is {column.max()}")
                columns[each.name] = np.array(each.choices[: column.max() + 1])[column]
            elif each.type == "bool":
                columns[each.name] = column != 0
            else:
                columns[each.name] = column.astype(column.dtype if column.dtype.itemsize == 8 else np.int64)
        return columns

    @classmethod
    def from_schema(cls, name: str, schema: bytes) -> Packed:
        """Return the kind that the schema in a file describes, also for messages written by other versions.

        Parameters
        ----------
        name : str
            Name of the message type.
        schema : bytes
            The message definition in the ROS 2 interface language.

        Returns
        -------
        Packed
            The kind; its values are mappings by field name.

        Raises
        ------
        DataError
            The definition has lines that this package does not write.

        """
        fields, choices = [], []
        for line in schema.decode("utf-8", "replace").splitlines():
            words, _, comment = line.partition("#")
            match words.split():
                case ["uint8", constant] if "=" in constant:
                    choices.append(constant.partition("=")[0])
                case [type_, field_name]:
                    prefix = f"{field_name.upper()}_"
                    its = tuple(choice.removeprefix(prefix).lower() for choice in choices if choice.startswith(prefix))
                    fields.append(Field(field_name, type_, its if type_ == "uint8" else (), comment.strip()))
                case []:
                    pass
                case _:
                    raise DataError(Mistake("schema", line, "is not understood"), name)
        return cls(name, tuple(fields))


@dataclass(frozen=True)
class Json(CallRepr, MessageKind):
    """A JSON object; NaN and infinite numbers are stored as null.

    Attributes
    ----------
    name : str
        Name of the message type.
    properties : mapping
        The entry `properties` of the JSON schema.

    Examples
    --------
    >>> from needleplan.recording import EVENT
    >>> EVENT.decode(EVENT.encode({"name": "stop", "cause": "force", "limit_n": float("inf")}))
    {'name': 'stop', 'cause': 'force', 'limit_n': None}

    """

    name: str
    properties: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    encoding = "json"
    schema_encoding = "jsonschema"

    @property
    def schema(self) -> bytes:
        """The JSON schema of the message."""
        return json.dumps({"title": self.name, "type": "object", "properties": dict(self.properties)}).encode()

    def encode(self, value: Any) -> bytes:
        """Return the JSON text of `value`. Raises TypeError if `value` is not a mapping or has no JSON form."""
        plain = json_values(value)
        if not isinstance(plain, dict):
            raise TypeError(f"must be a mapping, not {type(value).__name__}")
        return json.dumps(plain, allow_nan=False, separators=(",", ":")).encode()

    def decode(self, data: bytes) -> dict[str, Any]:
        """Return the JSON object in `data`. Raises DataError if `data` is damaged."""
        try:
            found = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise DataError(f"a message of {self.name} is damaged: {error}") from error
        if not isinstance(found, dict):
            raise DataError(f"a message of {self.name} is damaged: not an object")
        return found
