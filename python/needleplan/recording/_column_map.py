r"""Columns of a foreign text file: which of them hold time, depth, force and so on, and in which units.

A map is written as `time=t[ms], force=-Fz[mN], depth=2[m]`. Each entry assigns to a quantity

- a column, by its name in the header or by its number from 1, with the unit in brackets,
- with a minus sign before it if the file has the opposite sign,
- or a sum of columns, such as `time=sec[s]+nanosec[ns]`.

`trial`, `role` and `phase` take columns of text. `speed=3[mm/s]` is a number: the speed of an insertion at constant
speed, for files that have a depth but no time.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from needleplan.artifacts import CallRepr
from needleplan.config import closest
from needleplan.errors import InputError, Mistake
from needleplan.recording.columns import TEXTS, column_of, unit_factor, unit_of, units_of

__all__ = ["ColumnMap", "ColumnTerm", "Vocabulary", "described", "unit_in"]

_SPEED = "speed"
# A comma or line break before the next entry; other commas belong to the name of a column.
_BETWEEN = re.compile(r"[,\n]\s*(?=[A-Za-z_]+\s*=)")
# A sign that begins a term: at the beginning, or after the bracket of the term before it.
_TERM = re.compile(r"\s*(?P<sign>[+-]?)\s*(?P<name>.*?)\s*(?:\[(?P<unit>[^\[\]]*)\]|$)\s*(?=[+-]|$)")
_NAME_WITH_UNIT = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]*)[\])]\s*$")


@dataclass(frozen=True)
class Vocabulary:
    """Quantities and texts that a map may name.

    Parameters
    ----------
    columns : mapping of str to str
        Column by quantity, such as x_mm for `x`; the column itself is also accepted.
    texts : tuple of str
        Names of texts.
    trial : bool
        Whether the map is of trials, which need times or a speed.
    """

    columns: Mapping[str, str]
    texts: tuple[str, ...] = ()
    trial: bool = False

    def column_of(self, quantity: str) -> str | None:
        """Return the column of a quantity, or None for an unknown quantity."""
        return quantity if quantity in self.columns.values() else self.columns.get(quantity)

    @property
    def names(self) -> tuple[str, ...]:
        """All names that a map may give."""
        return (*self.columns, *self.texts, *([_SPEED] if self.trial else []))


_TRIAL = Vocabulary(
    {
        quantity: f"{column_of(quantity)}"
        for quantity in ("time", "depth", "velocity", "force", "torque", "angle", "x", "y", "z", "duty_cycle")
    },
    TEXTS,
    trial=True,
)


@dataclass(frozen=True)
class ColumnTerm:
    """One column of a file as part of a quantity: `name` is its name or number, `unit` is "" if none was given."""

    name: str
    unit: str = ""
    sign: int = 1

    @property
    def number(self) -> int | None:
        """Number of the column from 1 if the name is a whole number, else None."""
        return int(self.name) if re.fullmatch(r"[1-9][0-9]*", self.name) else None

    def places_in(self, header: Sequence[str]) -> tuple[int, ...]:
        """Return the indices of the columns of a header that the term names: none, one, or several if it is ambiguous.

        The name may be the whole cell, the cell without its unit in brackets, or the number of the column. The same
        case of letters precedes another case.
        """
        whole = f"{self.name} [{self.unit}]"
        names = {self.name, whole, whole.replace(" [", "[")}
        cells = [each.strip() for each in header]
        bare = [match["name"] if (match := _NAME_WITH_UNIT.match(each)) else "" for each in cells]
        plain, lower = self.name.lower(), {each.lower() for each in names}
        for found in (
            [cell in names for cell in cells],
            [name == self.name for name in bare],
            [cell.lower() in lower or name.lower() == plain for cell, name in zip(cells, bare, strict=True)],
        ):
            if any(found):
                return tuple(index for index, hit in enumerate(found) if hit)
        number = self.number
        return (number - 1,) if number and number <= len(header) else ()

    def unit_of(self, cell: str, column: str) -> str:
        """Return the unit of the term, or else that of its cell in the header.

        Raises InputError if both are units of the quantity `column` and differ. A unit after an underscore, as in
        `x_cm`, may also be part of a name: it is not used, and must be given in the map.
        """
        stated = unit_in(cell)
        factor = unit_factor(column, stated) if stated else None
        if self.unit:
            if factor is not None and factor != unit_factor(column, self.unit):
                rule = f"contradicts the header, which has {stated}: correct the map, or the header"
                raise InputError(Mistake(f"unit of column {self.name}", self.unit, rule))
            return self.unit
        ending = cell.strip().rpartition("_")[2]
        if not stated and "_" in cell and unit_factor(column, ending) not in (None, 1.0):
            rule = f"seems to be in {ending}: give the unit in brackets, as in {self.name}[{ending}]"
            raise InputError(Mistake(f"unit of column {self.name}", "", rule))
        return stated

    def __str__(self) -> str:
        return f"{'-' * (self.sign < 0)}{self.name}{f' [{self.unit}]' if self.unit else ''}"


def unit_in(cell: str) -> str:
    """Return the unit in brackets at the end of a cell of a header, or ""."""
    match = _NAME_WITH_UNIT.match(cell.strip())
    return match["unit"] if match else ""


@dataclass(frozen=True)
class ColumnMap(CallRepr):
    """Columns and units of foreign text files.

    Parameters
    ----------
    numbers : dict of str to tuple of ColumnTerm
        The columns whose sum is a quantity, by its name in `UNITS`, such as force_n.
    texts : dict of str to str
        Names of columns of text, by `trial`, `role` or `phase`.
    speed_mm_s : float, optional
        Speed of an insertion at constant speed, for files without times.
    surface_mm : float, optional
        Reading of the depth at the surface of the tissue: depth and x count from it, y and z from their medians before
        the entry. The default changes nothing.

    Examples
    --------
    >>> from needleplan.recording import ColumnMap
    >>> columns = ColumnMap.parse("time=t[ms], force=-Fz[mN], depth=2[m]")
    >>> columns.numbers["force_n"][0].sign, columns.numbers["depth_mm"][0].number
    (-1, 2)
    """

    numbers: dict[str, tuple[ColumnTerm, ...]] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    speed_mm_s: float | None = None
    surface_mm: float | None = None

    @classmethod
    def parse(
        cls, text: str | Sequence[str], *, surface_mm: float | None = None, vocabulary: Vocabulary = _TRIAL
    ) -> ColumnMap:
        """Return the map that a text describes; a sequence of texts is joined.

        Parameters
        ----------
        text : str or sequence of str
            Entries such as `time=t[ms]`, separated by commas; see the module.
        surface_mm : float, optional
            Reading of the depth at the surface of the tissue.
        vocabulary : Vocabulary, optional
            Quantities that the map may name; by default those of trials.

        Returns
        -------
        ColumnMap
            The map.

        Raises
        ------
        InputError
            An entry is not of this form, names an unknown quantity or unit, or occurs twice; or neither `time` nor
            `speed` and `depth` are given.

        Examples
        --------
        >>> from needleplan.recording import ColumnMap
        >>> ColumnMap.parse("depth=1[m], force=2[N], speed=3[mm/s]").speed_mm_s
        3.0
        """
        entries = [each.strip() for each in _BETWEEN.split(text if isinstance(text, str) else "\n".join(text))]
        numbers: dict[str, tuple[ColumnTerm, ...]] = {}
        texts: dict[str, str] = {}
        speed: float | None = None
        mistakes: list[Mistake] = []
        for entry in filter(None, (each.rstrip(",") for each in entries)):
            key, equals, value = (part.strip() for part in entry.partition("="))
            key = key.lower()
            column = vocabulary.column_of(key)
            if not equals or not value:
                mistakes.append(Mistake("--columns", entry, "must be QUANTITY=COLUMN[UNIT], as in force=Fz[mN]"))
            elif (column or key) in {**numbers, **texts} or (key == _SPEED and speed is not None):
                mistakes.append(Mistake("--columns", entry, f"gives {key} a second time"))
            elif key in vocabulary.texts:
                texts[key] = value
            elif key == _SPEED and vocabulary.trial:
                speed, wrong = _speed(value)
                mistakes += wrong
            elif column is None:
                close = closest(key, vocabulary.names, cutoff=0.6)
                hint = f'did you mean "{close}"?' if close else f"must be one of {', '.join(vocabulary.names)}"
                mistakes.append(Mistake("--columns", key, hint))
            else:
                numbers[column], wrong = _terms(column, value)
                mistakes += wrong
        mistakes += _of_whole(numbers, speed, surface_mm) if vocabulary.trial and not mistakes else []
        if mistakes:
            raise InputError(mistakes)
        return cls(numbers, texts, speed, surface_mm)


def _terms(column: str, text: str) -> tuple[tuple[ColumnTerm, ...], list[Mistake]]:
    found: list[ColumnTerm] = []
    mistakes: list[Mistake] = []
    at = 0
    while at < len(text):
        match = _TERM.match(text, at)
        if not match or match.end() == at or not match["name"]:
            rule = "must be a column with its unit in brackets, or a sum of such columns"
            return tuple(found), [Mistake("--columns", text, rule)]
        unit = (match["unit"] or "").strip()
        if unit and unit_factor(column, unit) is None:
            mistakes.append(_wrong_unit(column, unit))
        found.append(ColumnTerm(match["name"], unit, -1 if match["sign"] == "-" else 1))
        at = match.end()
    return tuple(found), mistakes


def _wrong_unit(column: str, unit: str) -> Mistake:
    return Mistake(f"--columns, unit of {column}", unit, f"must be one of {', '.join(units_of(column))}")


def _speed(text: str) -> tuple[float | None, list[Mistake]]:
    match = _NAME_WITH_UNIT.match(text)
    number, unit = (match["name"], match["unit"]) if match else (text, "mm/s")
    factor = unit_factor("velocity_mm_s", unit)
    if factor is None:
        return None, [_wrong_unit("velocity_mm_s", unit)]
    try:
        speed = float(number) * factor
    except ValueError:
        speed = 0.0
    wrong = [] if 0 < speed < float("inf") else [Mistake("--columns, speed", text, "must be a number above 0, in mm/s")]
    return speed, wrong


def _of_whole(
    numbers: dict[str, tuple[ColumnTerm, ...]], speed: float | None, surface_mm: float | None
) -> list[Mistake]:
    mistakes = []
    if speed is None and "time_s" not in numbers:
        mistakes.append(Mistake("--columns", "", "must give time=..., or speed=... for an insertion at constant speed"))
    if speed is not None and "time_s" in numbers:
        mistakes.append(Mistake("--columns", "speed", "is for files without times: give either time or speed"))
    if speed is not None and "depth_mm" not in numbers:
        mistakes.append(Mistake("--columns", "speed", "needs depth=..., from which the times follow"))
    if surface_mm is not None and not abs(surface_mm) < float("inf"):
        mistakes.append(Mistake("--surface", f"{surface_mm:g}", "must be a finite number"))
    return mistakes


def described(column: str, terms: Sequence[ColumnTerm], units: Sequence[str]) -> str:
    """Return how a column was read, such as `force_n = -Fz [mN]`; `units` are the units that were used."""
    said = []
    for index, (term, unit) in enumerate(zip(terms, units, strict=True)):
        sign = "-" if term.sign < 0 else "+" if index else ""
        name = f"column {term.name}" if term.number else term.name
        said.append(f"{sign}{name} [{unit}]" if unit else f"{sign}{name} (taken as {unit_of(column)})")
    return f"{column} = {' '.join(said)}"
