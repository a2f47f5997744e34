"""The scenario: everything that a plan depends on."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from needleplan.artifacts import digest, write_whole
from needleplan.config import (
    ConfigTable,
    Subtable,
    TableList,
    Text,
    parse_toml,
    raw_of,
    ruled,
    text_of,
    toml_text,
)
from needleplan.errors import ScenarioError
from needleplan.plotting import axes_or_new, picture_html, title
from needleplan.scenario._agreement import BETWEEN
from needleplan.scenario._drawing import draw_scene
from needleplan.scenario._frame import PlaneFrame
from needleplan.scenario._identified import needle_with, tissues_with
from needleplan.scenario._obstacle import Obstacle
from needleplan.scenario._parts import (
    Grid,
    Needle,
    Objective,
    Solver,
    Target,
    TipMotion,
    Tissue,
    Workspace,
)
from needleplan.scenario._shape import TOLERANCE_MM
from needleplan.scenario._shipped import FOLDER, ShippedScenario

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike, NDArray

    from needleplan.scenario._identified import HasCurvature

__all__ = ["ORDER", "Scenario"]

ORDER = (
    "schema", "title", "workspace", "obstacle", "target", "needle", "tissue", "motion", "grid", "objective", "solver",
)  # fmt: skip
"""Order of the keys in a written file. The digest of a scenario depends on this order."""


@dataclass(frozen=True, repr=False)
class Scenario(PlaneFrame, ConfigTable, error=ScenarioError, schema="needleplan.scenario/1", between=BETWEEN):
    """Anatomy, target, needle, tip noise, grid, objective and solver: everything that a plan depends on.

    A position has one radius. If tissues contain the position, the last of them in `tissues` gives the radius;
    otherwise the last layer of the needle that begins at or before the position; otherwise the needle. The plane has x
    along the insertion and y lateral, in mm. Headings are in rad from +x, counter-clockwise positive.

    Parameters
    ----------
    workspace : Workspace
        The rectangle that the tip must not leave.
    target : Target
        The disc that the tip must reach.
    needle : Needle
        Radius of the needle's arc, and layers with other radii.
    obstacles : sequence of Obstacle, optional
        Regions that the tip must not touch. Default: none.
    motion : TipMotion, optional
        Number of headings, tip noise, and points of an arc that are tested. Default: `TipMotion()`.
    grid : Grid, optional
        Grid of positions. Default: `Grid()`.
    objective : Objective, optional
        Costs whose expected sum is minimised. Default: `Objective()`.
    solver : Solver, optional
        Algorithm and its stopping rules. Default: `Solver()`.
    title : str, optional
        Title for figures and summaries. Default: no title.
    tissues : sequence of Tissue, optional
        Regions in which the needle's arc has another radius. Default: none.

    Raises
    ------
    ScenarioError
        If a part has the wrong type, or parts contradict each other. The exception names all mistakes.

    Examples
    --------
    >>> from needleplan.scenario import Needle, Scenario, Target, Workspace
    >>> scenario = Scenario(Workspace(60, 40), Target((50, 25), 2), Needle(40))
    >>> scenario.shape
    (61, 41, 60, 2)
    >>> Scenario(Workspace(60, 40), Target((70, 25), 2), Needle(40))
    Traceback (most recent call last):
    needleplan.errors.ScenarioError: target.center_mm = [70.0, 25.0]: must lie in the workspace, [0, 60] x [0, 40]
    """

    workspace: Workspace = ruled(Subtable(Workspace))
    target: Target = ruled(Subtable(Target))
    needle: Needle = ruled(Subtable(Needle))
    obstacles: tuple[Obstacle, ...] = ruled(TableList(Obstacle), (), key="obstacle")
    motion: TipMotion = ruled(Subtable(TipMotion), TipMotion())
    grid: Grid = ruled(Subtable(Grid), Grid())
    objective: Objective = ruled(Subtable(Objective), Objective())
    solver: Solver = ruled(Subtable(Solver), Solver())
    title: str = ruled(Text(), "")
    tissues: tuple[Tissue, ...] = ruled(TableList(Tissue), (), key="tissue")

    @classmethod
    def read(cls, path: ShippedScenario | str | os.PathLike[str]) -> Scenario:
        """Read a scenario file or a shipped scenario.

        Parameters
        ----------
        path : str or path
            A TOML file, or the name of a shipped scenario. An existing file takes precedence over the name.

        Returns
        -------
        Scenario

        Raises
        ------
        ScenarioError
            If the file cannot be read, or with every mistake of the file: key, value and rule.

        Examples
        --------
        >>> from needleplan.scenario import Scenario
        >>> Scenario.read("four_obstacles").title
        'Four obstacles'
        """
        return cls.from_toml(text_of(path, ScenarioError, FOLDER, "scenario"), os.fspath(path))

    @classmethod
    def from_toml(cls, text: str, source: str = "") -> Scenario:
        """Return the scenario that the text of a scenario file describes.

        Parameters
        ----------
        text : str
            The text, in TOML.
        source : str, optional
            Name of the text in messages. Default: no name.

        Returns
        -------
        Scenario

        Raises
        ------
        ScenarioError
            If the text is not TOML, or with every mistake of the text: key, value and rule.

        Examples
        --------
        >>> from needleplan.scenario import Scenario
        >>> text = Scenario.read("four_obstacles").to_toml()
        >>> Scenario.from_toml(text.replace("headings = 60", "headings = 3"), "mine.toml")
        Traceback (most recent call last):
        needleplan.errors.ScenarioError: mine.toml: motion.headings = 3: must be a whole number from 4 to 100000
        """
        return parse_toml(text, cls, source)

    def to_toml(self, *, commented: bool = False) -> str:
        """Return the canonical text of the scenario: a scenario file that reads back as exactly this scenario.

        Parameters
        ----------
        commented : bool, default False
            Add a comment to every value.

        Returns
        -------
        str
            TOML. Default values are written out; settings without a value, such as a time limit, are left out.

        Examples
        --------
        >>> from needleplan.scenario import Scenario
        >>> print(Scenario.read("four_obstacles").to_toml().splitlines()[1])
        title = "Four obstacles"
        """
        raw = raw_of(self, commented=commented)
        return toml_text({key: raw[key] for key in ORDER if key in raw})

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a scenario file.

        Parameters
        ----------
        path : str or path
            The file. An existing file is replaced.

        Raises
        ------
        OutputError
            If the file cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> from pathlib import Path
        >>> from needleplan.scenario import Scenario
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     Scenario.read("four_obstacles").write(Path(folder) / "mine.toml")
        """
        write_whole(path, self.to_toml().encode())

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical text. Files that differ only in layout and comments have the same digest."""
        return digest(self.to_toml())

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """Shape of the arrays of a policy table: (nx, ny, headings, 2). The last axis is bevel -1, bevel +1."""
        nx, ny = self.grid.points(self.workspace)
        return nx, ny, self.motion.headings, 2

    @property
    def states(self) -> int:
        """Number of states: the product of `shape`."""
        return math.prod(self.shape)

    @property
    def partitions(self) -> tuple[int, int]:
        """Number of partitions along x and y: `solver.partitions`; if None, 12 x 8, or fewer on a smaller grid."""
        nx, ny = self.grid.points(self.workspace)
        return self.solver.partitions or (min(12, nx), min(8, ny))

    @property
    def step_mm(self) -> float:
        """Length of one insertion step outside of layers and tissues (mm)."""
        return self.motion.step_length_mm(self.needle.curvature_radius_mm)

    @property
    def uniform(self) -> bool:
        """Whether the radius is the same everywhere: there are neither layers nor tissues."""
        return not (self.needle.layers or self.tissues)

    def radius_mm(self, x_mm: ArrayLike, y_mm: ArrayLike) -> NDArray[np.float64]:
        """Return the radii of arcs that start at given positions.

        Parameters
        ----------
        x_mm, y_mm : array_like
            Coordinates in mm; they broadcast against each other.

        Returns
        -------
        numpy.ndarray
            Radii in mm, with the broadcast shape of `x_mm` and `y_mm`.

        Examples
        --------
        >>> from needleplan.scenario import Scenario
        >>> Scenario.read("four_obstacles").radius_mm([10.0, 20.0], 5.0).tolist()
        [40.0, 40.0]
        """
        import numpy as np

        x, y = np.broadcast_arrays(np.asarray(x_mm, np.float64), np.asarray(y_mm, np.float64))
        radius = np.full(x.shape, self.needle.curvature_radius_mm)
        for layer in self.needle.layers:
            radius[x >= layer.from_mm - TOLERANCE_MM] = layer.curvature_radius_mm
        for tissue in self.tissues:
            radius[tissue.covers(x, y)] = tissue.curvature_radius_mm
        return radius

    def with_curvature(
        self, curvature_per_mm: float | Sequence[HasCurvature], *, entry_mm: float = 0.0, tissue: str = ""
    ) -> Scenario:
        """Return a copy of the scenario in which radii are set from an identified curvature.

        Parameters
        ----------
        curvature_per_mm : float or sequence
            A number is the curvature of the whole path in 1/mm, of either sign; it replaces needle radius and layers. A
            sequence of pieces, as from `needleplan.identification.path_curvature`: the first piece gives the radius of
            the needle, each other piece a layer.
        entry_mm : float, default 0
            x of the entry in mm: a layer begins at `entry_mm` + `low_mm` of its piece. Used with a sequence only.
        tissue : str, optional
            Name of the tissues whose radius is set; `curvature_per_mm` must then be a number, and needle and layers
            stay. Default: needle and layers are set, and the tissues stay.

        Returns
        -------
        Scenario

        Raises
        ------
        ScenarioError
            If the curvature is 0 or not finite, the sequence is empty or given for a tissue, no tissue has this name,
            or the layers violate a rule.

        Examples
        --------
        >>> from needleplan.scenario import Scenario
        >>> Scenario.read("four_obstacles").with_curvature(-0.02).needle.curvature_radius_mm
        50.0
        """
        if tissue:
            return replace(self, tissues=tissues_with(self.tissues, curvature_per_mm, tissue))
        return replace(self, needle=needle_with(curvature_per_mm, entry_mm))

    def with_tip_noise(self, probabilities: Sequence[float]) -> Scenario:
        """Return a copy of the scenario with other tip noise.

        Parameters
        ----------
        probabilities : sequence of float
            P(0), P(+-1) ...: probabilities that the noise of an insertion step changes the heading by so many noise
            steps. `needleplan.identification.tip_noise` identifies them for the steps of a scenario.

        Returns
        -------
        Scenario

        Raises
        ------
        ScenarioError
            If the probabilities violate a rule.

        Examples
        --------
        >>> from needleplan.scenario import Scenario
        >>> Scenario.read("four_obstacles").with_tip_noise([0.5, 0.25]).motion.tip_noise
        (0.5, 0.25)
        """
        return replace(self, motion=replace(self.motion, tip_noise=tuple(probabilities)))

    def plot(self, ax: Axes | None = None, *, on_map: bool = False) -> Axes:
        """Draw workspace, obstacles, target, layers and tissues.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            The axes to draw on. Default: the axes of a new pyplot figure.
        on_map : bool, default False
            Draw layers and tissues as white outlines without fill and labels, for axes that show a colour map.

        Returns
        -------
        matplotlib.axes.Axes
            `ax` or the new axes, with limits in mm.

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
            title(axes, self.title.replace("$", r"\$"))  # no mathematics
        return axes

    def __repr__(self) -> str:
        name = f' "{self.title}"' if self.title else ""
        counts = f"{len(self.obstacles)} obstacle{'s' * (len(self.obstacles) != 1)}, {self.states:,} states"
        return f"<Scenario{name}: {self.workspace.width_mm:g} x {self.workspace.height_mm:g} mm, {counts}>"

    def _repr_html_(self) -> str:
        return picture_html(self.workspace, self.plot, repr(self))

    @property
    def x_mm(self) -> NDArray[np.float64]:
        """Grid positions along x in mm, shape (nx,)."""
        import numpy as np

        return np.arange(self.shape[0], dtype=np.float64) * self.grid.spacing_mm[0]

    @property
    def y_mm(self) -> NDArray[np.float64]:
        """Grid positions along y in mm, shape (ny,)."""
        import numpy as np

        return np.arange(self.shape[1], dtype=np.float64) * self.grid.spacing_mm[1]

    @property
    def headings_rad(self) -> NDArray[np.float64]:
        """Headings in rad, shape (headings,), from 0 to below 2 pi."""
        import numpy as np

        return np.arange(self.motion.headings, dtype=np.float64) * (2 * math.pi / self.motion.headings)
