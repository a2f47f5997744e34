"""The scenario: all that a plan depends on."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from needleplan.artifacts import digest, write_whole
from needleplan.errors import Mistake, ScenarioError
from needleplan.plotting import axes_or_new, picture_html, title
from needleplan.scenario import toml
from needleplan.scenario._drawing import draw_scene
from needleplan.scenario.agreement import disagreements
from needleplan.scenario.identified import Bend
from needleplan.scenario.parts import (
    Grid,
    Layer,
    Motion,
    Needle,
    Objective,
    Obstacle,
    Solver,
    Target,
    Tissue,
    Workspace,
)
from needleplan.scenario.polygon import TOLERANCE_MM, covered
from needleplan.scenario.rules import Refused, Text, suggestion
from needleplan.scenario.shipped import text_of

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

__all__ = ["Scenario"]


@dataclass(frozen=True, repr=False)
class Scenario:
    """Anatomy, target, needle, tip noise, grid, objective and solver.

    The radius of an arc is that of the place where the step starts, `radius_mm`: of the last of the `tissues` that
    holds it, boundary included, else of the last layer of the needle that begins at or before it, else of the needle.
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
    tissues: tuple[Tissue, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "obstacles", tuple(self.obstacles))
        object.__setattr__(self, "tissues", tuple(self.tissues))
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
        """Length of one insertion step where neither layers nor tissues are: 2 pi radius / headings."""
        return 2 * math.pi * self.needle.curvature_radius_mm / self.motion.headings

    @property
    def uniform(self) -> bool:
        """Whether there is one radius everywhere: neither layers nor tissues."""
        return not (self.needle.layers or self.tissues)

    def radius_mm(self, x_mm: ArrayLike, y_mm: ArrayLike) -> NDArray[np.float64]:
        """Return the radius of an arc that starts at a place; x and y broadcast, the result has the shape of both."""
        import numpy as np

        x, y = np.broadcast_arrays(np.asarray(x_mm, np.float64), np.asarray(y_mm, np.float64))
        radius = np.full(x.shape, self.needle.curvature_radius_mm)
        for layer in self.needle.layers:
            radius[x >= layer.from_mm - TOLERANCE_MM] = layer.curvature_radius_mm
        for tissue in self.tissues:
            radius[covered(tissue.polygon_mm, x, y)] = tissue.curvature_radius_mm
        return radius

    def with_curvature(
        self, curvature_per_mm: float | Sequence[Bend], *, entry_mm: float = 0.0, tissue: str = ""
    ) -> Scenario:
        """Return the scenario with an identified curvature.

        A number, 1/mm, of either sign, is that of the whole path and replaces the layers. A sequence, as from
        `needleplan.estimation.path_curvature`, becomes the layers: each begins at x = entry_mm + its `low_mm`, the
        first one at the entry. The radii of `tissues` stay, unless `tissue` names some: then a number is theirs, and
        all else stays. Raises ScenarioError for a straight path, an unknown name, or layers that cannot be.
        """
        if tissue:
            return self._with_tissue(curvature_per_mm, tissue)
        if not isinstance(curvature_per_mm, Sequence):
            return replace(self, needle=Needle(_radius_mm(curvature_per_mm)))
        if not curvature_per_mm:
            raise ScenarioError(Mistake("curvature_per_mm", "[]", "must be a number or at least one piece of a path"))
        first, *others = curvature_per_mm
        layers = tuple(Layer(entry_mm + each.low_mm, _radius_mm(each.curvature_per_mm)) for each in others)
        return replace(self, needle=Needle(_radius_mm(first.curvature_per_mm), layers))

    def with_tip_noise(self, probabilities: Sequence[float]) -> Scenario:
        """Return the scenario with identified P(0), P(+-1) ..., as from `needleplan.estimation.tip_noise`.

        They are per step: identify them with the headings and the radius of this very scenario. Raises ScenarioError.
        """
        return replace(self, motion=replace(self.motion, tip_noise=tuple(probabilities)))

    def _with_tissue(self, curvature_per_mm: float | Sequence[Bend], name: str) -> Scenario:
        if isinstance(curvature_per_mm, Sequence):
            raise ScenarioError(Mistake("curvature_per_mm", "", f'must be one number for the tissue "{name}"'))
        names = [each.name for each in self.tissues]
        if name not in names:
            rule = "there is no [[tissue]] of that name" + suggestion(name, filter(None, names))
            raise ScenarioError(Mistake("tissue", f'"{name}"', rule))
        radius = _radius_mm(curvature_per_mm)
        changed = (replace(each, curvature_radius_mm=radius) if each.name == name else each for each in self.tissues)
        return replace(self, tissues=tuple(changed))

    def plot(self, ax: Axes | None = None, *, on_map: bool = False) -> Axes:
        """Draw workspace, obstacles, target and tissues.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            The axes to draw on. Without them a new pyplot figure is made.
        on_map : bool, default False
            Draw outlines that stand out on a colour map, without the tints of the tissues.

        Returns
        -------
        matplotlib.axes.Axes
            The axes, in mm.

        Examples
        --------
        >>> import needleplan as npl
        >>> from matplotlib.figure import Figure
        >>> axes = npl.Scenario.read("four_obstacles").plot(Figure().subplots())
        >>> axes.get_xlabel(), len(axes.patches)
        ('x (mm)', 5)
        """
        axes = axes_or_new(ax, self.workspace)
        draw_scene(axes, self, on_map=on_map)
        if self.title:
            title(axes, self.title)
        return axes

    def __repr__(self) -> str:
        name = f' "{self.title}"' if self.title else ""
        counts = f"{len(self.obstacles)} obstacle{'s' * (len(self.obstacles) != 1)}, {self.states:,} states"
        return f"<Scenario{name}: {self.workspace.width_mm:g} x {self.workspace.height_mm:g} mm, {counts}>"

    def _repr_html_(self) -> str:
        return picture_html(self.workspace, self.plot, repr(self))

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


def _radius_mm(curvature_per_mm: float) -> float:
    if not curvature_per_mm or not math.isfinite(curvature_per_mm):
        rule = "must be a finite number other than 0: a plan needs a needle that bends"
        raise ScenarioError(Mistake("curvature_per_mm", f"{curvature_per_mm:g}", rule))
    return abs(1 / curvature_per_mm)
