"""Rules for single values: numbers, texts, choices, and short sequences of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from difflib import get_close_matches
from enum import StrEnum
from itertools import pairwise, takewhile
from typing import Any, Protocol

from needleplan.errors import Mistake

__all__ = [
    "SEED",
    "Choice",
    "Flag",
    "Integer",
    "Maybe",
    "Number",
    "NumberList",
    "Numbers",
    "Pair",
    "Rule",
    "Sign",
    "Text",
    "Texts",
    "Violation",
    "closest",
    "plain",
    "sequence",
    "shown",
    "suggestion",
]


class Violation(Exception):
    """Raised if a value violates a rule.

    `mistakes` is a list of mistakes, or the text of the one rule that `value` violates. The key of each mistake is the
    path within the value; the key is empty if the value as a whole is wrong. If single tables of a list are wrong,
    `partial` is the tuple of the tables with None for each wrong table; otherwise `partial` is None.
    """

    def __init__(self, mistakes: str | Sequence[Mistake], value: object = None, partial: object = None) -> None:
        text = "" if value is None else shown(value)
        self.mistakes: list[Mistake] = [Mistake("", text, mistakes)] if isinstance(mistakes, str) else list(mistakes)
        self.partial = partial
        super().__init__("; ".join(mistake.rule for mistake in self.mistakes))


class Rule(Protocol):
    """Rule that checks one value of a file, or an argument of a constructor, and converts it to its stored form."""

    def read(self, value: object) -> Any:
        """Return the value in its stored form. Raises Violation if the value breaks the rule."""


@dataclass(frozen=True)
class Number:
    """Rule for a number in a range, stored as a float. Refuses NaN, truth values and, if `finite`, infinity.

    `above` is an excluded lower limit; `at_least` and `at_most` are included limits. A limit of None does not apply.
    """

    unit: str = ""
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    finite: bool = True

    def read(self, value: object) -> float:
        """Return the number as a float. Raises Violation."""
        try:
            number = float(plain(value))  # type: ignore[arg-type]
        except (TypeError, OverflowError):
            raise Violation(f"must be {self}", value) from None
        if (
            math.isnan(number)
            or (self.finite and math.isinf(number))
            or not _within(number, self.above, self.at_least, self.at_most)
        ):
            raise Violation(f"must be {self}", value)
        return number

    def __str__(self) -> str:
        unit = f" in {self.unit}" if self.unit else ""
        return f"a {'finite ' * self.finite}number{unit}{_range(self.above, self.at_least, self.at_most)}"


@dataclass(frozen=True)
class Integer:
    """Rule for a whole number from `at_least` to `at_most`, without a decimal point. If `odd`, refuses even numbers."""

    at_least: int
    at_most: int
    odd: bool = False

    def read(self, value: object) -> int:
        """Return the integer. Raises Violation."""
        number = plain(value)
        if isinstance(number, int) and self.at_least <= number <= self.at_most and (number % 2 or not self.odd):
            return number
        raise Violation(f"must be {self}", value)

    def __str__(self) -> str:
        return f"{'an odd' if self.odd else 'a'} whole number from {self.at_least} to {self.at_most}"


SEED = Integer(0, 2**32 - 1)
"""Rule for the seed of a random generator."""


@dataclass(frozen=True)
class Sign:
    """Rule for a sign: the whole number 1 or -1."""

    def read(self, value: object) -> int:
        """Return the sign. Raises Violation."""
        number = plain(value)
        if isinstance(number, int) and abs(number) == 1:
            return number
        raise Violation("must be 1 or -1", value)


@dataclass(frozen=True)
class Flag:
    """Rule for a truth value."""

    def read(self, value: object) -> bool:
        """Return the truth value. Raises Violation."""
        if isinstance(value, bool):
            return value
        raise Violation("must be true or false", value)


@dataclass(frozen=True)
class Text:
    """Rule for a text of at most `at_most` characters that UTF-8 can encode.

    If `filled`, refuses a blank text; if `one_line`, line breaks and other characters that cannot be printed.
    """

    at_most: int = 1000
    filled: bool = False
    one_line: bool = False

    def read(self, value: object) -> str:
        """Return `value` if it is a text that obeys the rule. Raises Violation if not."""
        if not isinstance(value, str) or len(value) > self.at_most or not _encodes(value):
            raise Violation(f"must be a text of at most {self.at_most} characters", value)
        if self.filled and not value.strip():
            raise Violation("must not be empty", value)
        if self.one_line and not value.isprintable():
            raise Violation("must be one line of characters that can be printed", value)
        return value


@dataclass(frozen=True)
class Texts:
    """Rule for a list of texts that begin with `prefix`."""

    prefix: str = ""

    def read(self, value: object) -> tuple[str, ...]:
        """Return `value`, a list of texts, as a tuple. Raises Violation if it does not obey the rule."""
        entries = sequence(value)
        if entries is None or not all(isinstance(entry, str) and entry.startswith(self.prefix) for entry in entries):
            form = f' of the form "{self.prefix}..."' if self.prefix else ""
            raise Violation(f"must be a list of texts{form}", value)
        return tuple(str(entry) for entry in entries)


@dataclass(frozen=True)
class Choice:
    """Rule for one of several names: the values of an enumeration or the keys of a mapping, `among`.

    The member of the enumeration or the value of the mapping is stored.
    """

    among: type[StrEnum] | Mapping[str, Any]

    def read(self, value: object) -> Any:
        """Return the member or the mapped value with the name `value`. Raises Violation if no name equals `value`."""
        known = self._known
        if isinstance(value, str) and value in known:
            return known[value]
        raise Violation(f"must be {self}{suggestion(value, known) if len(known) > 1 else ''}", value)

    @property
    def _known(self) -> dict[str, Any]:
        return dict(self.among) if isinstance(self.among, Mapping) else {each.value: each for each in self.among}

    def __str__(self) -> str:
        names = [f'"{name}"' for name in self._known]
        return f"one of {', '.join(names)}" if len(names) > 1 else names[0]


@dataclass(frozen=True)
class Pair:
    """Rule for two numbers, `[x, y]`, each read by `rule`."""

    rule: Number | Integer

    def read(self, value: object) -> tuple[float, float]:
        """Return the pair as a tuple. Raises Violation."""
        entries = sequence(value)
        if entries is None or len(entries) != 2:
            raise Violation("must be two numbers, [x, y]", value)
        try:
            return (self.rule.read(entries[0]), self.rule.read(entries[1]))
        except Violation as broken:
            raise Violation(f"each of the two {broken}", value) from None


@dataclass(frozen=True)
class Numbers:
    """Rule for a list of `count` finite numbers. If `unit_length`, their Euclidean norm must be 1 within 1e-6."""

    count: int
    unit_length: bool = False

    def read(self, value: object) -> tuple[float, ...]:
        """Return `value`, a list of numbers, as a tuple. Raises Violation if it does not obey the rule."""
        entries = sequence(value)
        if entries is None or len(entries) != self.count:
            raise Violation(f"must be {self.count} numbers", value)
        try:
            numbers = tuple(Number().read(entry) for entry in entries)
        except Violation as broken:
            raise Violation(f"each of the {self.count} {broken}", value) from None
        if self.unit_length and abs(math.hypot(*numbers) - 1) > 1e-6:
            raise Violation("must be of length 1", value)
        return numbers


@dataclass(frozen=True)
class NumberList:
    """Rule for a list of `least` to `most` numbers, which increase if `increasing` says by which order."""

    unit: str
    least: int
    most: int
    increasing: str = ""

    def read(self, value: object) -> tuple[float, ...]:
        """Return the numbers as a tuple. Raises Violation."""
        entries = sequence(value)
        if entries is None or not self.least <= len(entries) <= self.most:
            raise Violation(f"must be {self.least} to {self.most} numbers{self.unit and ' in ' + self.unit}", value)
        numbers = tuple(Number(self.unit, at_least=-1000, at_most=1000).read(entry) for entry in entries)
        if self.increasing and any(b <= a for a, b in pairwise(numbers)):
            raise Violation(f"must increase: {self.increasing}", value)
        return numbers


@dataclass(frozen=True)
class Maybe:
    """Rule for a value that obeys `rule`, or None. In a file, a missing key means None."""

    rule: Rule

    def read(self, value: object) -> Any:
        """Return `value` as `rule` reads it, or None if it is None. Raises Violation if it does not obey `rule`."""
        return None if value is None else self.rule.read(value)


def shown(value: object, depth: int = 3) -> str:
    """Return a value in TOML syntax, for messages.

    Parameters
    ----------
    value : object
        Value. Tables are shown as `{...}`.
    depth : int, default 3
        Number of levels of nested lists that are shown; deeper lists are shown as `[...]`.

    Returns
    -------
    str
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    entries = sequence(value)
    if entries is not None:
        return f"[{', '.join(shown(entry, depth - 1) for entry in entries) if depth else '...'}]"
    return "{...}" if isinstance(value, dict) or is_dataclass(value) else str(value)


def closest(value: object, names: Iterable[str], cutoff: float = 0.6) -> str:
    """Return the most similar name, or an empty text if no name is similar.

    Names that differ by one letter take precedence (`_is_one_letter_off`).

    Parameters
    ----------
    value : object
        Unknown name. For a value that is not a text, the result is empty.
    names : iterable of str
        Known names.
    cutoff : float, default 0.6
        Least similarity of the other names, from 0 to 1, as `difflib` computes it.

    Returns
    -------
    str
    """
    if not isinstance(value, str):
        return ""
    known = list(names)
    slips = [name for name in known if _is_one_letter_off(value, name)]
    return next(iter(slips or get_close_matches(value, known, n=1, cutoff=cutoff)), "")


def suggestion(value: object, names: Iterable[str]) -> str:
    """Return `; did you mean "NAME"?` with the most similar name, or an empty text if no name is similar.

    Parameters
    ----------
    value : object
        Unknown name.
    names : iterable of str
        Known names.

    Returns
    -------
    str
    """
    name = closest(value, names)
    return f'; did you mean "{name}"?' if name else ""


def sequence(value: object) -> list[object] | None:
    """Return a list, tuple or NumPy array as a list. Returns None for any other value."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    return list(value) if isinstance(value, list | tuple) else None


def plain(value: object) -> object:
    """Return a real NumPy or Python number as int or float. Returns None for any other value and for truth values."""
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return value


def _is_one_letter_off(value: str, name: str) -> bool:
    """Return whether `value` becomes `name` if one letter is replaced, added or removed.

    Returns False if both have fewer than four letters, or one has fewer than three: `x` is not a misspelt `y`.
    """
    longer = max(len(value), len(name))
    start = _common_letters(value, name)
    end = _common_letters(value[start:][::-1], name[start:][::-1])
    return min(len(value), len(name)) >= 3 and longer >= 4 and longer - start - end == 1


def _common_letters(a: str, b: str) -> int:
    """Return the length of the common prefix of two texts."""
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(a, b, strict=False)))


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
