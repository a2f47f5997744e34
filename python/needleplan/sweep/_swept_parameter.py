"""One parameter of a sweep: a key of the scenario, and its values or its range."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

from needleplan.config import Choice, ConfigTable, Integer, Maybe, Number, Text, Violation, ruled, sequence
from needleplan.errors import Mistake, SweepError

__all__ = ["RangeScale", "SweptParameter"]

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
