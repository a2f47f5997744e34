"""What a value of a scenario may be.

A rule reads a raw value, as TOML or a caller gives it, and returns it in the one form that is kept; or it raises
`Refused` with the sentence that says what the value must be.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, is_dataclass
from difflib import get_close_matches
from enum import StrEnum
from typing import Protocol

__all__ = [
    "Choice",
    "Integer",
    "Maybe",
    "Noise",
    "Number",
    "Odd",
    "Pair",
    "Refused",
    "Rule",
    "Text",
    "plain",
    "sequence",
    "shown",
    "suggestion",
]

_LONGEST_TEXT = 1000
_NOISE_ENTRIES = 8
_NOISE_TOLERANCE = 1e-9


class Refused(Exception):
    """The value breaks the rule; the message is the rule."""


class Rule(Protocol):
    """Reads one value."""

    def read(self, value: object) -> object:
        """Return the value as it is kept. Raises Refused."""


@dataclass(frozen=True)
class Number:
    """A finite number in a range; integers become floats, truth values are not numbers."""

    unit: str = ""
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None

    def read(self, value: object) -> float:
        """Return the number as a float. Raises Refused."""
        try:
            number = float(plain(value))  # type: ignore[arg-type]
        except (TypeError, OverflowError):
            raise Refused(f"must be {self}") from None
        if not math.isfinite(number) or not _within(number, self.above, self.at_least, self.at_most):
            raise Refused(f"must be {self}")
        return number

    def __str__(self) -> str:
        unit = f" in {self.unit}" if self.unit else ""
        return f"a finite number{unit}{_range(self.above, self.at_least, self.at_most)}"


@dataclass(frozen=True)
class Integer:
    """A whole number in a range, written without a decimal point."""

    at_least: int
    at_most: int

    def read(self, value: object) -> int:
        """Return the integer. Raises Refused."""
        number = plain(value)
        if not isinstance(number, int) or not self.at_least <= number <= self.at_most:
            raise Refused(f"must be a whole number from {self.at_least} to {self.at_most}")
        return number


@dataclass(frozen=True)
class Odd:
    """An odd whole number in a range."""

    at_least: int
    at_most: int

    def read(self, value: object) -> int:
        """Return the number. Raises Refused."""
        rule = f"must be an odd whole number from {self.at_least} to {self.at_most}"
        try:
            number = Integer(self.at_least, self.at_most).read(value)
        except Refused:
            raise Refused(rule) from None
        if number % 2 == 0:
            raise Refused(rule)
        return number


@dataclass(frozen=True)
class Text:
    """A text that UTF-8 can hold."""

    def read(self, value: object) -> str:
        """Return the text. Raises Refused."""
        if not isinstance(value, str) or len(value) > _LONGEST_TEXT or not _encodes(value):
            raise Refused(f"must be a text of at most {_LONGEST_TEXT} characters")
        return value


@dataclass(frozen=True)
class Choice:
    """One of the names of an enumeration."""

    among: type[StrEnum]

    def read(self, value: object) -> StrEnum:
        """Return the member of the enumeration. Raises Refused."""
        names = [member.value for member in self.among]
        if isinstance(value, str) and value in names:
            return self.among(value)
        allowed = ", ".join(f'"{name}"' for name in names)
        raise Refused(f"must be one of {allowed}{suggestion(value, names)}")


@dataclass(frozen=True)
class Pair:
    """Two values of the same rule, `[x, y]`."""

    rule: Number | Integer

    def read(self, value: object) -> tuple[float, float]:
        """Return the pair as a tuple. Raises Refused."""
        entries = sequence(value)
        if entries is None or len(entries) != 2:
            raise Refused("must be two numbers, [x, y]")
        try:
            return (self.rule.read(entries[0]), self.rule.read(entries[1]))
        except Refused as refused:
            raise Refused(f"each of the two {refused}") from None


@dataclass(frozen=True)
class Noise:
    """Probabilities of 0, +-1, +-2 ... heading steps: one to eight, not negative, one in sum when doubled."""

    def read(self, value: object) -> tuple[float, ...]:
        """Return the probabilities as a tuple. Raises Refused."""
        entries = sequence(value)
        if entries is None or not 1 <= len(entries) <= _NOISE_ENTRIES:
            raise Refused(f"must be 1 to {_NOISE_ENTRIES} probabilities, [P(0), P(+-1), P(+-2), ...]")
        try:
            noise = tuple(Number(at_least=0, at_most=1).read(entry) for entry in entries)
        except Refused as refused:
            raise Refused(f"each probability {refused}") from None
        total = noise[0] + 2 * math.fsum(noise[1:])
        if abs(total - 1) > _NOISE_TOLERANCE:
            raise Refused(f"P(0) + 2 * (P(+-1) + P(+-2) + ...) must be 1, not {total:.10g}")
        return noise


@dataclass(frozen=True)
class Maybe:
    """A value of a rule, or none at all."""

    rule: Rule

    def read(self, value: object) -> object:
        """Return the value, or None. Raises Refused."""
        return None if value is None else self.rule.read(value)


def shown(value: object, depth: int = 3) -> str:
    """Return the value as TOML would write it, what is nested deeper than `depth` left out."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    entries = sequence(value)
    if entries is not None:
        return f"[{', '.join(shown(entry, depth - 1) for entry in entries) if depth else '...'}]"
    return "{...}" if isinstance(value, dict) or is_dataclass(value) else str(value)


def suggestion(value: object, names: Iterable[str]) -> str:
    """Return `; did you mean "..."?` where one of `names` is close to `value`, else nothing."""
    close = get_close_matches(value, list(names), n=1, cutoff=0.6) if isinstance(value, str) else []
    return f'; did you mean "{close[0]}"?' if close else ""


def sequence(value: object) -> list[object] | None:
    """Return lists, tuples and arrays as a list, and None for anything else."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    return list(value) if isinstance(value, list | tuple) else None


def plain(value: object) -> object:
    """Return a number, of NumPy or of Python, as one of Python, and None for anything else."""
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return value


def _within(number: float, above: float | None, at_least: float | None, at_most: float | None) -> bool:
    return (
        (above is None or number > above)
        and (at_least is None or number >= at_least)
        and (at_most is None or number <= at_most)
    )


def _range(above: float | None, at_least: float | None, at_most: float | None) -> str:
    parts = [
        f"{word} {limit:,.10g}"
        for word, limit in (("above", above), ("at least", at_least), ("at most", at_most))
        if limit is not None
    ]
    return f" {' and '.join(parts)}" if parts else ""


def _encodes(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True
