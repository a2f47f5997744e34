"""The scenario: all that a plan depends on."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from needleplan.errors import Mistake, ScenarioError
from needleplan.provenance import digest, write_whole
from needleplan.scenario import toml
from needleplan.scenario.agreement import disagreements
from needleplan.scenario.parts import Grid, Motion, Needle, Objective, Obstacle, Solver, Target, Workspace
from needleplan.scenario.rules import Refused, Text
from needleplan.scenario.shipped import text_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["Scenario"]


@dataclass(frozen=True)
class Scenario:
    """Anatomy, target, needle, tip noise, grid, objective and solver.

    Plane: x along the insertion, y lateral, both in mm; headings in rad from +x, counter-clockwise.
    Raises ScenarioError where the parts contradict each other, with all the contradictions.
    """

    workspace: Workspace
    target: Target
    needle: Needle
    obstacles: tuple[Obstacle, ...] = ()
    motion: Motion = Motion()
    grid: Grid = Grid()
    objective: Objective = Objective()
    solver: Solver = Solver()
    title: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "obstacles", tuple(self.obstacles))
        mistakes = disagreements(vars(self))
        try:
            Text().read(self.title)
        except Refused as refused:
            mistakes.insert(0, Mistake("title", "", str(refused)))
        if mistakes:
            raise ScenarioError(mistakes)

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Scenario:
        """Read a scenario file, or a shipped scenario by its name (`Scenario.read("four_obstacles")`).

        Raises ScenarioError with every mistake of the file.
        """
        return cls.from_toml(text_of(path), os.fspath(path))

    @classmethod
    def from_toml(cls, text: str, source: str = "") -> Scenario:
        """Make a scenario of the text of a scenario file; `source` names it in messages.

        Raises ScenarioError with every mistake of the text.
        """
        parts, mistakes = toml.parse(text)
        mistakes += disagreements(parts)
        if mistakes:
            raise ScenarioError(mistakes, source)
        return cls(**parts)

    def to_toml(self) -> str:
        """Return the text of a scenario file that reads back as exactly this scenario, defaults written out."""
        return toml.text(vars(self))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a scenario file. Raises OutputError."""
        write_whole(path, self.to_toml().encode())

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical text: the same for files that differ in layout and comments only."""
        return digest(self.to_toml())

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape of the tables, (nx, ny, headings, 2); the last axis is bevel -1, bevel +1."""
        nx, ny = self.grid.points(self.workspace)
        return nx, ny, self.motion.headings, 2

    @property
    def states(self) -> int:
        """Number of states."""
        return math.prod(self.shape)

    @property
    def partitions(self) -> tuple[int, int]:
        """Number of partitions along x and y: those of the solver, or 12 x 8 as far as the grid has points."""
        nx, ny = self.grid.points(self.workspace)
        return self.solver.partitions or (min(12, nx), min(8, ny))

    @property
    def step_mm(self) -> float:
        """Length of one insertion step: 2 pi radius / headings."""
        return 2 * math.pi * self.needle.curvature_radius_mm / self.motion.headings

    @property
    def x_mm(self) -> NDArray[np.float64]:
        """Grid positions along x, [nx]."""
        import numpy as np

        return np.arange(self.shape[0], dtype=np.float64) * self.grid.spacing_mm[0]

    @property
    def y_mm(self) -> NDArray[np.float64]:
        """Grid positions along y, [ny]."""
        import numpy as np

        return np.arange(self.shape[1], dtype=np.float64) * self.grid.spacing_mm[1]

    @property
    def headings_rad(self) -> NDArray[np.float64]:
        """Headings in rad, [headings], from 0 to below 2 pi."""
        import numpy as np

        return np.arange(self.motion.headings, dtype=np.float64) * (2 * math.pi / self.motion.headings)
