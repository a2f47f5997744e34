"""`CallRepr` and `ShortRepr`: what objects show, in a line of less than 200 characters or in a notebook."""

from __future__ import annotations

from collections.abc import Mapping, Sized
from dataclasses import fields, is_dataclass
from enum import Enum
from html import escape
from typing import Any

__all__ = ["MOST_CHARACTERS", "CallRepr", "ShortRepr", "short_html", "short_repr"]

MOST_CHARACTERS = 200
"""Length below which every repr stays."""

# Characters of a text beyond which it is cut; numbers of values and of keys beyond which only the number is shown.
_LONGEST_TEXT, _LONGEST_SEQUENCE, _MOST_KEYS = 40, 4, 6


def short_repr(self: Any) -> str:
    """Return class and fields of a dataclass or a named tuple, such as `<Record: trial 'a', role train>`.

    Shapes stand for arrays, keys or their number for mappings, the number of values for long sequences, and class names
    for objects. Empty fields are left out, and those that do not fit, with "...".
    """
    parts = [f"{name} {text}" for name, text in _shown(self)]
    kept, length = [], len(f"<{type(self).__name__}: , ...>")
    for part in parts:
        length += len(part) + len(", ")
        if length >= MOST_CHARACTERS:
            kept.append("...")
            break
        kept.append(part)
    return f"<{type(self).__name__}: {', '.join(kept)}>"


def short_html(self: Any) -> str:
    """Return an HTML table for a notebook: the class name, and one row for each field of a dataclass or named tuple."""
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in _shown(self))
    return f"<table><caption>{type(self).__name__}</caption>{rows}</table>"


class CallRepr:
    """Base class of dataclasses: shows the call that makes one, or a summary if it is long; a table in a notebook."""

    __slots__ = ()

    _repr_html_ = short_html

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        # A dataclass gets a `__repr__` of any length, unless its own class has one. An assignment would hide the types
        # from editors.
        type.__setattr__(cls, "__repr__", cls.__repr__)

    def __repr__(self) -> str:
        if not is_dataclass(self):
            return object.__repr__(self)
        call = ", ".join(f"{field.name}={getattr(self, field.name)!r}" for field in fields(self) if field.repr)
        text = f"{type(self).__name__}({call})"
        return text if len(text) < MOST_CHARACTERS and "\n" not in text else short_repr(self)


class ShortRepr(CallRepr):
    """Base class of dataclasses that hold arrays or many values: shows a summary; a table in a notebook."""

    __slots__ = ()

    __repr__ = short_repr


def _shown(self: Any) -> list[tuple[str, str]]:
    """Return pairs of field name and text, for the fields that are not empty."""
    names = [field.name for field in fields(self) if field.repr] if is_dataclass(self) else list(self._fields)
    return [(name, text) for name in names if (text := _brief(getattr(self, name)))]


def _brief(value: object) -> str:
    """Return a text of about 50 characters at most for a value; an empty text for None and empty containers."""
    if isinstance(value, Enum):
        return str(value)
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    if shape is not None and dtype is not None:
        return f"{dtype} {shape}" if shape else str(value)
    if value is None or (isinstance(value, Sized) and len(value) == 0):
        return ""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        keys = ", ".join(map(str, value)) if len(value) <= _MOST_KEYS else ""
        return f"{{{keys}}}" if keys and len(keys) <= _LONGEST_TEXT else f"{len(value)} entries"
    if isinstance(value, tuple | list | set | frozenset):
        parts = [_brief(item) for item in value] if len(value) <= _LONGEST_SEQUENCE else []
        joined = ", ".join(parts)
        return f"({joined})" if all(parts) and parts and len(joined) <= _LONGEST_TEXT else f"{len(value)} values"
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    if is_dataclass(value):
        return type(value).__name__
    text = repr(value)
    return text if len(text) <= _LONGEST_TEXT else f"{text[: _LONGEST_TEXT - 3]}..."
