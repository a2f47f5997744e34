"""The sweep file: which values of which scenario keys an atlas has tables for."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path

from needleplan.artifacts import digest
from needleplan.atlas._problems import PlaneProblem, SpaceProblem, SweptProblem
from needleplan.config import (
    REQUIRED,
    Choice,
    ConfigTable,
    Integer,
    Maybe,
    Number,
    Numbers,
    Subtable,
    TableList,
    Text,
    Violation,
    parse_toml,
    raw_of,
    ruled,
    sequence,
    shipped_names,
    text_of,
    toml_text,
)
from needleplan.errors import AtlasError, Mistake
from needleplan.planning import Edge
from needleplan.scenario import Scenario

__all__ = ["MOST_TABLES", "Design", "Keep", "RangeScale", "Sweep", "SweepEntry", "SweptParameter", "shipped_sweeps"]

_FOLDER = Path(__file__).parent.parent / "sweeps"

MOST_TABLES = 1_000_000
"""Largest number of tables of a sweep: their list takes about 1 GB of memory, their tables weeks on one machine."""

# States that one processor solves per second, for the estimate in the message about too many tables; measured on the
# shipped scenarios: 1.5 to 6 million.
_STATES_PER_SECOND = 2e6


class Design(StrEnum):
    """How the values of the parameters are combined."""

    PRODUCT = "product"
    """Every value of each parameter with every value of the others."""

    LIST = "list"
    """The first values together, the second values together, and so on."""

    SAMPLED = "sampled"
    """A Latin hypercube in the ranges of the parameters."""


class Keep(StrEnum):
    """What an atlas holds."""

    TABLES = "tables"
    """Policy tables and their records."""

    RECORDS = "records"
    """Records only, which take a thousandth of the space."""


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
        return tuple(self._level(each) for each in entries)

    def _level(self, value: object) -> object:
        entries = sequence(value)
        if entries is not None:
            return tuple(self._level(each) for each in entries)
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
class SweptParameter(ConfigTable, key="parameter", error=AtlasError, between=(_one_source,)):
    """One table `[[parameter]]` of a sweep: a key of the scenario, and its values or its range.

    Parameters
    ----------
    scenario_key : str
        Path of the key, such as `needle.curvature_radius_mm`. A table of a list is named by its `name` or its number
        from 1 (`obstacle.vessel.margin_mm`), a coordinate by `x` or `y` (`target.center_mm.x`). File key: `key`.
    name : str, optional
        Name of the parameter in the atlas. Default: the last part of the key.
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
    AtlasError
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
    def title(self) -> str:
        """Name of the parameter in the atlas."""
        return self.name or self.scenario_key.rpartition(".")[2]

    @property
    def size(self) -> int:
        """Number of values."""
        return len(self.values) if self.values is not None else self.count

    @cached_property
    def levels(self) -> tuple[object, ...]:
        """The values; those of a range include both ends."""
        return (
            self.values if self.values is not None else tuple(self.at(i / (self.count - 1)) for i in range(self.count))
        )

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


@dataclass(frozen=True)
class SweepEntry(ConfigTable, key="entry", error=AtlasError):
    """Table `[entry]` of a sweep: the entries that the record of a table describes.

    Parameters
    ----------
    edge : Edge, default "left"
        Edge whose best entry is recorded.
    start : sequence of float, optional
        A fixed pose, [x_mm, y_mm, heading_deg], whose success and cost are recorded too.
    """

    edge: Edge = ruled(Choice(Edge), Edge.LEFT)
    start: tuple[float, ...] | None = ruled(Maybe(Numbers(3)), None)


def _one_problem(scenario: str, anatomy: str) -> Iterator[Mistake]:
    if not (scenario or anatomy):
        yield Mistake("scenario", "", "is missing: give a scenario or an anatomy")
    elif scenario and anatomy:
        yield Mistake("anatomy", anatomy, "must be left out beside a scenario")


def _as_many_as_the_design_needs(
    parameters: tuple[SweptParameter | None, ...], design: Design, samples: int | None
) -> Iterator[Mistake]:
    known = [each for each in parameters if each]
    titles = [each.title for each in known]
    for number, title in enumerate(titles, start=1):
        if title in titles[: number - 1]:
            yield Mistake(f"parameter {number}.name", title, "is the name of an earlier parameter; give another name")
    if not parameters:
        yield Mistake("parameter", "", "is missing: a sweep needs at least one [[parameter]]")
    if design is Design.SAMPLED and samples is None:
        yield Mistake("samples", "", 'is missing: design = "sampled" needs the number of tables')
    if design is not Design.SAMPLED and samples is not None:
        yield Mistake("samples", str(samples), 'must be left out unless design = "sampled"')
    sizes = {each.title: each.size for each in known}
    if design is Design.LIST and len(set(sizes.values())) > 1:
        numbers = ", ".join(f"{title}: {size}" for title, size in sizes.items())
        yield Mistake("parameter", "", f'must all have as many values with design = "list" ({numbers})')


@dataclass(frozen=True)
class Sweep(
    ConfigTable, error=AtlasError, schema="needleplan.sweep/1", between=(_one_problem, _as_many_as_the_design_needs)
):
    """A scenario, and the values of its keys that an atlas has tables for.

    Parameters
    ----------
    scenario : str, optional
        Name of a shipped scenario, or path of a scenario file; a relative path begins at the folder of the sweep file.
    parameters : sequence of SweptParameter
        The keys that vary.
    anatomy : str, optional
        Path of an anatomy file, instead of a scenario: tables in space.
    keep : Keep, default "tables"
        Whether the atlas holds tables and records, or records only.
    design : Design, default "product"
        How the values are combined.
    samples : int, optional
        Number of tables of a sampled design.
    seed : int, default 0
        Seed of a sampled design.
    entry : SweepEntry, optional
        The entries that are recorded. Default: the best one on the left edge.
    title : str, optional
        Title for figures and messages.

    Raises
    ------
    AtlasError
        With every mistake: key, value and rule.

    Examples
    --------
    >>> from needleplan.atlas import Sweep, SweptParameter
    >>> radius = SweptParameter("needle.curvature_radius_mm", values=[30.0, 40.0, 60.0])
    >>> rotation = SweptParameter("objective.rotation", low=1.0, high=16.0, scale="log")
    >>> Sweep("four_obstacles", [radius, rotation]).tables
    15
    """

    scenario: str = ruled(Text(4000), "")
    parameters: tuple[SweptParameter, ...] = ruled(TableList(SweptParameter, 20), REQUIRED, key="parameter")
    anatomy: str = ruled(Text(4000), "")
    keep: Keep = ruled(Choice(Keep), Keep.TABLES)
    design: Design = ruled(Choice(Design), Design.PRODUCT)
    samples: int | None = ruled(Maybe(Integer(1, 1_000_000_000)), None)
    seed: int = ruled(Integer(0, 2**63 - 1), 0)
    entry: SweepEntry = ruled(Subtable(SweepEntry), SweepEntry())
    title: str = ruled(Text(), "")

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Sweep:
        """Read a sweep file or a shipped sweep, and make the path of its scenario absolute.

        Parameters
        ----------
        path : str or path
            A TOML file, or the name of a shipped sweep. An existing file takes precedence over the name.

        Returns
        -------
        Sweep

        Raises
        ------
        AtlasError
            If the file cannot be read, or with every mistake of the file.

        Examples
        --------
        >>> from needleplan.atlas import Sweep
        >>> Sweep.read("curvature_and_noise").tables
        48
        """
        sweep = cls.from_toml(text_of(path, AtlasError, _FOLDER, "sweep"), os.fspath(path))
        if sweep.anatomy:
            return replace(sweep, anatomy=os.path.abspath(Path(path).parent / sweep.anatomy))  # noqa: PTH100  links stay
        beside = Path(path).parent / sweep.scenario
        return replace(sweep, scenario=os.path.abspath(beside)) if beside.is_file() else sweep  # noqa: PTH100

    @classmethod
    def from_toml(cls, text: str, source: str = "") -> Sweep:
        """Return the sweep that a text describes; `source` names the text in messages.

        Raises AtlasError if the text is not TOML, or with every mistake of the text.
        """
        return parse_toml(text, cls, source)

    def problem(self) -> SweptProblem:
        """Return the scenario or the anatomy whose keys vary. Raises ScenarioError if it cannot be read."""
        return SpaceProblem(self.anatomy) if self.anatomy else PlaneProblem(Scenario.read(self.scenario))

    @property
    def tables(self) -> int:
        """Number of combinations of values."""
        if self.design is Design.SAMPLED:
            assert self.samples is not None
            return self.samples
        if self.design is Design.LIST:
            return self.parameters[0].size
        return math.prod(each.size for each in self.parameters)

    def require_finite(self, problem: SweptProblem) -> None:
        """Raise AtlasError if the sweep has more than `MOST_TABLES` tables; the message names their time."""
        if self.tables <= MOST_TABLES:
            return
        seconds = self.tables * problem.states / _STATES_PER_SECOND
        rule = (
            f"would make {self.tables:,} tables of {problem.states:,} states, {_duration(seconds)} on one processor; "
            f'at most {MOST_TABLES:,} are allowed. Take fewer values, or design = "sampled"'
        )
        raise AtlasError(Mistake("parameter", "", rule))

    def to_toml(self) -> str:
        """Return the text of the sweep: a sweep file that reads back as exactly this sweep.

        Returns
        -------
        str
            TOML, with default values written out.
        """
        return toml_text(raw_of(self))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the text of the sweep."""
        return digest(self.to_toml())


def shipped_sweeps() -> list[str]:
    """Return the names of the shipped sweeps."""
    return shipped_names(_FOLDER)


def _duration(seconds: float) -> str:
    for unit, size in (("years", 365.25 * 86400), ("days", 86400.0), ("hours", 3600.0)):
        if seconds >= size:
            return f"{seconds / size:,.0f} {unit}"
    return f"{seconds:,.0f} seconds"
