"""The sweep file: which values of which scenario keys a table set has tables for."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path

from needleplan.artifacts import digest
from needleplan.config import (
    REQUIRED,
    Choice,
    ConfigTable,
    Integer,
    Maybe,
    Numbers,
    Subtable,
    TableList,
    Text,
    parse_toml,
    raw_of,
    ruled,
    shipped_names,
    shown,
    text_of,
    toml_text,
)
from needleplan.errors import Mistake, SweepError
from needleplan.planning import Edge
from needleplan.scenario import Scenario
from needleplan.sweep._problems import PlaneProblem, SpaceProblem, SweptProblem, SweptProblems
from needleplan.sweep._swept_parameter import SweptParameter

__all__ = ["Design", "Keep", "Sweep", "SweepEntry", "shipped_sweeps"]

_FOLDER = Path(__file__).parent.parent / "sweeps"

# Largest number of tables of a sweep: their list takes about 1 GB of memory, their tables weeks on one machine
_MOST_TABLES = 1_000_000

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
    """What a table set holds."""

    TABLES = "tables"
    """Policy tables and their records."""

    RECORDS = "records"
    """Records only, which take a thousandth of the space."""


@dataclass(frozen=True)
class SweepEntry(ConfigTable, key="entry", error=SweepError):
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


def _one_problem(scenario: str, anatomy: str, parameters: tuple[SweptParameter | None, ...]) -> Iterator[Mistake]:
    files = [parameter for parameter in parameters if parameter and parameter.is_file]
    if not (scenario or anatomy or files):
        yield Mistake("scenario", "", "is missing: give a scenario or an anatomy")
    elif scenario and anatomy:
        yield Mistake("anatomy", anatomy, "must be left out beside a scenario")
    elif files and (scenario or anatomy):
        yield Mistake("parameter.key", files[0].scenario_key, "holds the files: leave out scenario and anatomy")
    for file in files[1:]:
        yield Mistake("parameter.key", file.scenario_key, "only one parameter may hold files")
    for file in files:
        if file.values is None or not all(isinstance(value, str) and value for value in file.values):
            yield Mistake("parameter.values", "", f"must be names of files for the key {file.scenario_key}")


def _as_many_as_the_design_needs(
    parameters: tuple[SweptParameter | None, ...], design: Design, samples: int | None
) -> Iterator[Mistake]:
    known = [parameter for parameter in parameters if parameter]
    titles = [parameter.title for parameter in known]
    for number, title in enumerate(titles, start=1):
        if title in titles[: number - 1]:
            yield Mistake(f"parameter {number}.name", title, "is the name of an earlier parameter; give another name")
        if design is Design.PRODUCT and (twice := known[number - 1].repeated) is not None:
            rule = f'must differ with design = "product": {shown(twice)} is there twice'
            yield Mistake(f"parameter {number}.values", title, rule)
    if not parameters:
        yield Mistake("parameter", "", "is missing: a sweep needs at least one [[parameter]]")
    if design is Design.SAMPLED and samples is None:
        yield Mistake("samples", "", 'is missing: design = "sampled" needs the number of tables')
    if design is not Design.SAMPLED and samples is not None:
        yield Mistake("samples", str(samples), 'must be left out unless design = "sampled"')
    sizes = {parameter.title: parameter.size for parameter in known}
    if design is Design.LIST and len(set(sizes.values())) > 1:
        numbers = ", ".join(f"{title}: {size}" for title, size in sizes.items())
        yield Mistake("parameter", "", f'must all have as many values with design = "list" ({numbers})')


@dataclass(frozen=True)
class Sweep(
    ConfigTable, error=SweepError, schema="needleplan.sweep/1", between=(_one_problem, _as_many_as_the_design_needs)
):
    """A scenario, and the values of its keys that a table set has tables for.

    Parameters
    ----------
    scenario : str, optional
        Name of a shipped scenario, or path of a scenario file; a relative path begins at the folder of the sweep file.
    parameters : sequence of SweptParameter
        The keys that vary.
    anatomy : str, optional
        Path of an anatomy file, instead of a scenario: 3D tables.
    keep : Keep, default "tables"
        Whether the table set holds tables and records, or records only.
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
    SweepError
        With every mistake: key, value and rule.

    Examples
    --------
    >>> from needleplan.sweep import Sweep, SweptParameter
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
        SweepError
            If the file cannot be read, or with every mistake of the file.

        Examples
        --------
        >>> from needleplan.sweep import Sweep
        >>> Sweep.read("curvature_and_noise").tables
        48
        """
        sweep = cls.from_toml(text_of(path, SweepError, _FOLDER, "sweep"), os.fspath(path))
        folder = Path(path).parent
        return replace(
            sweep,
            scenario=_beside(folder, sweep.scenario),
            anatomy=_beside(folder, sweep.anatomy),
            parameters=tuple(
                replace(parameter, values=tuple(_beside(folder, str(value)) for value in parameter.values or ()))
                if parameter.is_file
                else parameter
                for parameter in sweep.parameters
            ),
        )

    @classmethod
    def from_toml(cls, text: str, source: str = "") -> Sweep:
        """Parse the text of a sweep file.

        Parameters
        ----------
        text : str
            Text of the file.
        source : str, optional
            Name of the text in messages.

        Returns
        -------
        Sweep

        Raises
        ------
        SweepError
            The text is not TOML, or has mistakes. The error lists all of them.
        """
        return parse_toml(text, cls, source)

    def problems(self) -> SweptProblems:
        """Return the scenarios or anatomies whose keys vary. Raises ScenarioError if one cannot be read."""
        for parameter in self.parameters:
            if parameter.is_file:
                read = SpaceProblem if parameter.scenario_key == "anatomy" else _plane
                return SweptProblems({str(file): read(str(file)) for file in parameter.levels}, parameter.title)
        return SweptProblems.one(SpaceProblem(self.anatomy) if self.anatomy else _plane(self.scenario))

    @property
    def in_space(self) -> bool:
        """Whether the tables are in 3D."""
        return bool(self.anatomy) or any(parameter.scenario_key == "anatomy" for parameter in self.parameters)

    @property
    def tables(self) -> int:
        """Number of combinations of values."""
        if self.design is Design.SAMPLED:
            assert self.samples is not None
            return self.samples
        if self.design is Design.LIST:
            return self.parameters[0].size
        return math.prod(parameter.size for parameter in self.parameters)

    def require_finite(self, problems: SweptProblems) -> None:
        """Raise SweepError if the sweep has more than `_MOST_TABLES` tables; the message names their time."""
        if self.tables <= _MOST_TABLES:
            return
        seconds = self.tables * problems.states / _STATES_PER_SECOND
        rule = (
            f"would make {self.tables:,} tables of {problems.states:,} states, {_duration(seconds)} on one processor; "
            f"at most {_MOST_TABLES:,} are allowed. Take fewer "
            + ("samples" if self.design is Design.SAMPLED else 'values, or design = "sampled"')
        )
        raise SweepError(Mistake("parameter", "", rule))

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


def _plane(scenario: str) -> SweptProblem:
    return PlaneProblem(Scenario.read(scenario))


def _beside(folder: Path, name: str) -> str:
    """Return the absolute path of a file whose name is relative to a folder, or the name if there is no such file."""
    path = folder / name
    return os.path.abspath(path) if name and path.is_file() else name  # noqa: PTH100  symbolic links stay


def shipped_sweeps() -> list[str]:
    """Return the names of the shipped sweeps."""
    return shipped_names(_FOLDER)


def _duration(seconds: float) -> str:
    for unit, size in (("years", 365.25 * 86400), ("days", 86400.0), ("hours", 3600.0)):
        if seconds >= size:
            return f"{seconds / size:,.0f} {unit}"
    return f"{seconds:,.0f} seconds"
