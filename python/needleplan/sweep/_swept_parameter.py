"""One parameter of a sweep: a key of the scenario, and its values or its range.

Texts of parameters: their values, their names as words, and their units.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

from needleplan.config import Choice, ConfigTable, Integer, Maybe, Number, Text, Violation, ruled, sequence
from needleplan.errors import Mistake, SweepError

__all__ = [
    "RangeScale",
    "SweptParameter",
    "name_and_unit",
    "record_unit",
    "value_text",
    "values_text",
    "words_and_unit",
]


# Keys whose values are files instead of values of a key.
_FILES = ("scenario", "anatomy")


class RangeScale(StrEnum):
    """How values are spread over a range."""

    LINEAR = "linear"
    LOG = "log"


@dataclass(frozen=True)
class _Levels:
    """Rule for the values of a parameter: a list of numbers, texts, or lists of numbers."""

    def read(self, value: object) -> tuple[object, ...]:
        """Return the values as a tuple, with lists as tuples. Raises Violation."""
        entries = sequence(value)
        if not entries:
            raise Violation("must be a list of at least one value", value)
        return tuple(self._level(entry) for entry in entries)

    def _level(self, value: object) -> object:
        entries = sequence(value)
        if entries is not None:
            return tuple(self._level(entry) for entry in entries)
        if isinstance(value, bool | str | int):
            return value
        return Number().read(value)


def _one_source(
    values: tuple[object, ...] | None, low: float | None, high: float | None, scale: RangeScale
) -> Iterator[Mistake]:
    """Yield a mistake unless a parameter has either values or a range."""
    if values is not None:
        for name, limit in (("low", low), ("high", high)):
            if limit is not None:
                yield Mistake(name, f"{limit:g}", "must be left out beside values")
        return
    if low is None or high is None:
        yield Mistake("values", "", "is missing: give values, or low and high")
    elif not low < high:
        yield Mistake("high", f"{high:g}", f"must be larger than low, {low:g}")
    elif scale is RangeScale.LOG and low <= 0:
        yield Mistake("low", f"{low:g}", 'must be above 0 with scale = "log"')


@dataclass(frozen=True)
class SweptParameter(ConfigTable, key="parameter", error=SweepError, between=(_one_source,)):
    """One table `[[parameter]]` of a sweep: a key of the scenario, and its values or its range.

    Parameters
    ----------
    scenario_key : str
        Path of the key, such as `needle.curvature_radius_mm`. A table of a list is named by its `name` or its number
        from 1 (`obstacle.vessel.margin_mm`), a coordinate by `x` or `y` (`target.center_mm.x`). File key: `key`.
    name : str, optional
        Name of the parameter in the table set. Default: the last part of the key.
    values : sequence, optional
        The values: numbers, texts, or lists such as probabilities.
    low, high : float, optional
        Range of a number, instead of values.
    count : int, default 5
        Number of values in the range; not used by a sampled design.
    scale : RangeScale, default "linear"
        How values are spread over the range.

    Raises
    ------
    SweepError
        If a value breaks its rule, or neither values nor a range are given.
    """

    scenario_key: str = ruled(Text(200, filled=True), key="key")
    name: str = ruled(Text(100), "")
    values: tuple[object, ...] | None = ruled(Maybe(_Levels()), None)
    low: float | None = ruled(Maybe(Number()), None)
    high: float | None = ruled(Maybe(Number()), None)
    count: int = ruled(Integer(2, 1_000_000_000), 5)
    scale: RangeScale = ruled(Choice(RangeScale), RangeScale.LINEAR)

    @property
    def is_file(self) -> bool:
        """Whether the values are names of files: the key is `scenario` or `anatomy`."""
        return self.scenario_key in _FILES

    @property
    def title(self) -> str:
        """Name of the parameter in the table set."""
        return self.name or self.scenario_key.rpartition(".")[2]

    @property
    def size(self) -> int:
        """Number of values."""
        return len(self.values) if self.values is not None else self.count

    @cached_property
    def levels(self) -> tuple[object, ...]:
        """The values; a range includes both ends."""
        return (
            self.values if self.values is not None else tuple(self.at(i / (self.count - 1)) for i in range(self.count))
        )

    @property
    def repeated(self) -> object | None:
        """A value that is listed twice, or None."""
        levels = list(self.values or ())
        return next((level for number, level in enumerate(levels) if level in levels[:number]), None)

    def at(self, share: float) -> object:
        """Return the value at a share of the range, 0 to 1; with `values`, the value at that share of the list."""
        if self.values is not None:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        assert self.low is not None
        assert self.high is not None
        if share in (0.0, 1.0):
            return (self.low, self.high)[int(share)]
        if self.scale is RangeScale.LOG:
            return self.low * (self.high / self.low) ** share
        return self.low + share * (self.high - self.low)


# Endings of keys, with their units.
_UNITS = (("_per_mm", "1/mm"), ("_mm", "mm"), ("_deg", "degrees"), ("_rad", "rad"), ("_n", "N"), ("_s", "s"))

# Tables whose keys are understood without the name of the table.
_PLAIN_TABLES = ("", "needle", "motion", "grid", "lattice", "workspace", "objective", "solver", "anatomy")

# Units of the numbers of a record whose names do not state them. `at` has the form that xarray reads as dates.
_RECORD_UNITS = {
    "cost": "cost units",
    "start_cost": "cost units",
    "seconds": "s",
    "bytes": "byte",
    "at": "seconds since 1970-01-01",
    "direction_s": "",
}


def value_text(value: object) -> str:
    """Return the text of a value for answers: numbers with six digits, lists in brackets."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(value_text, value))}]"
    return str(value)


def values_text(values: Mapping[str, object]) -> str:
    """Return the text of the values of a point, such as `radius_mm = 40, rotation = 4`."""
    return ", ".join(f"{name} = {value_text(value)}" for name, value in values.items())


def words_and_unit(parameter: SweptParameter) -> tuple[str, str]:
    """Return the name of a parameter as words, and the unit that its key states; empty if it states none."""
    *_, table, key = ["", *parameter.scenario_key.split(".")]
    coordinate = len(key) == 1  # x, y, z, or the number of an entry
    text, unit = name_and_unit(table if coordinate else key)
    if coordinate:
        of = parameter.scenario_key.split(".")[:-2]
        text = " ".join([*of[-1:], text, key])
    elif table not in _PLAIN_TABLES:  # a radius or a margin of what?
        text = " ".join([*parameter.scenario_key.split(".")[-3 if table.isdecimal() else -2 : -1], text])
    if parameter.scenario_key.startswith("objective."):
        unit = {"1/mm": "cost units/mm", "": "cost units" if key != "discount" else ""}.get(unit, unit)
        text = text if unit in ("mm", "") else f"cost of {text}"
    if parameter.name:
        text = name_and_unit(parameter.name)[0]
    return text, unit


def name_and_unit(name: str) -> tuple[str, str]:
    """Return a name as words, and the unit that its ending states; empty if it states none."""
    for ending, unit in _UNITS:
        if name.endswith(ending):
            return name.removesuffix(ending).replace("_", " "), unit
    return name.replace("_", " "), ""


def record_unit(name: str) -> str:
    """Return the unit of a number of a record; empty if it has none."""
    return _RECORD_UNITS.get(name, name_and_unit(name)[1])
