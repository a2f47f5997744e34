"""The policy table: action, expected cost and success probability for every pose of the tip."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.planning._coded import Outcome
from needleplan.planning._contract import Table
from needleplan.planning._drawing import draw_partition_order, draw_success
from needleplan.planning._edge_entries import EdgeEntries
from needleplan.planning._execution import Execution, Path, Rollouts
from needleplan.planning._labelled import labelled_dataset
from needleplan.planning._plane_file import TABLES, PlaneContent, write_plane
from needleplan.planning._plane_truth import plane_truths, scattered_poses
from needleplan.planning._poses import Entry, Pose, flag, whole_number
from needleplan.planning._promise import share_of
from needleplan.planning._resolution import Resolution, resolution
from needleplan.planning._table_file import TABLE_NAMES, array_digests, table_digest
from needleplan.plotting import axes_or_new, picture_html

if TYPE_CHECKING:
    from typing import Self

    import xarray
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from needleplan.planning._promise import Truths
    from needleplan.planning._space_file import SpaceContent
    from needleplan.planning._success import Success
    from needleplan.planning._uncertainty import Uncertainty

__all__ = ["PolicyTable"]

# Largest number of runs of one rollout, limited by memory.
_MOST_RUNS = 50_000_000


@dataclass(frozen=True, eq=False, repr=False)
class PolicyTable(EdgeEntries, Table):
    """Optimal cost-to-go, policy and success probability of every state of a scenario.

    Parameters
    ----------
    values : ndarray of float32, shape (nx, ny, headings, 2)
        Expected costs under the optimal policy. The last axis is bevel -1, bevel +1.
    policy : ndarray of uint8, shape (nx, ny, headings, 2)
        0 insert, 1 rotate, then insert, 2 insert straight.
    success : ndarray of float32, shape (nx, ny, headings, 2)
        Probabilities of reaching the target under the policy.
    stats : Stats
        How the solve went.
    scenario : Scenario
        The scenario that was solved; it holds the axes `x_mm`, `y_mm` and `headings_rad`.

    Raises
    ------
    TableError
        If an array does not have the type or the shape that the scenario requires, or holds a number that is no cost,
        action or probability.

    Notes
    -----
    The arrays become read-only. A table can be pickled and copied; the copy compiles its lattice when it needs it.

    Examples
    --------
    >>> import needleplan as npl
    >>> table = npl.plan("four_obstacles")
    >>> table.values.shape, table.policy.dtype
    ((121, 81, 60, 2), dtype('uint8'))
    """

    def __reduce__(self) -> tuple[type[PolicyTable], tuple[object, ...]]:
        return PolicyTable, (self.values, self.policy, self.success, self.stats, self.scenario)

    def __repr__(self) -> str:
        shape = " x ".join(map(str, self.scenario.shape))
        name = f' "{self.scenario.title}"' if self.scenario.title else ""
        return f"<PolicyTable{name}: {shape} = {self.scenario.states:,} states, {self.stats.status.replace('_', ' ')}>"

    def _repr_html_(self) -> str:
        return picture_html(self.scenario.workspace, self.plot, repr(self))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the scenario's digest and the three arrays; other files refer to the table by this digest."""
        return table_digest(self.scenario.digest, array_digests({name: getattr(self, name) for name in TABLE_NAMES}))

    @cached_property
    def resolution(self) -> Resolution:
        """The check of the plan from its best entry on the left edge: resolution of the grid, promise and executions.

        For other entries, call `needleplan.planning.resolution`.

        Examples
        --------
        >>> import needleplan as npl
        >>> npl.plan("four_obstacles").resolution.warnings
        ()
        """
        return resolution(self, self.best_entry())

    def path(
        self, start: Entry[Pose] | Pose | Sequence[float], *, nearest: bool = False, noise_seed: int | None = None
    ) -> Path:
        """Execute the policy once in the continuous bicycle model.

        Parameters
        ----------
        start : Entry, Pose or sequence of float
            Where the needle begins: x_mm, y_mm, heading_rad and, if known, bevel.
        nearest : bool, default False
            Decide by the policy at the nearest state, as in the thesis, instead of looking one step ahead.
        noise_seed : int, optional
            Seed of the tip noise. Without it, the execution has no noise.

        Returns
        -------
        Path
            Poses, actions, length, cost and outcome.

        Raises
        ------
        PoseError
            If `start` is outside the workspace or not a pose, or `noise_seed` is not a whole number from 0 to 2^64 - 1.

        Examples
        --------
        >>> import needleplan as npl
        >>> table = npl.plan("four_obstacles")
        >>> print(table.path(table.best_entry()).outcome)
        target
        """
        seed = 0 if noise_seed is None else _seed("noise_seed", noise_seed)
        execution = self._execution(nearest=flag("nearest", nearest))
        return execution.path(self.start(start, nearest=nearest), None if noise_seed is None else seed)

    def rollout(
        self, start: Entry[Pose] | Pose | Sequence[float], runs: int = 10_000, seed: int = 0, *, nearest: bool = False
    ) -> Rollouts[Pose]:
        """Execute the policy many times with tip noise in the continuous bicycle model.

        Parameters
        ----------
        start : Entry, Pose or sequence of float
            Where the needle begins: x_mm, y_mm, heading_rad and, if known, bevel.
        runs : int, default 10_000
            Number of executions, at most 50,000,000.
        seed : int, default 0
            Seed of the tip noise. The same seed gives the same runs on any number of threads.
        nearest : bool, default False
            Decide by the policy at the nearest state, as in the thesis, instead of looking one step ahead.

        Returns
        -------
        Rollouts
            Success with its confidence interval, outcomes and means, and the predictions of the table.

        Raises
        ------
        PoseError
            If `start` lies outside the workspace or is no pose, or `runs` or `seed` is not such a whole number.

        Examples
        --------
        >>> import needleplan as npl
        >>> table = npl.plan("four_obstacles")
        >>> rollouts = table.rollout(table.best_entry(), runs=2000, seed=1)
        >>> abs(rollouts.success - rollouts.predicted_success) < 0.05
        True
        """
        runs = whole_number("runs", runs, 1, _MOST_RUNS, f"from 1 to {_MOST_RUNS:,}")
        seed = _seed("seed", seed)
        pose = self.start(start, nearest=nearest)
        predicted = self.lookup(*pose, nearest=nearest)
        execution = self._execution(nearest=flag("nearest", nearest))
        return execution.rollouts(pose, runs, seed, predicted.success, predicted.value)

    def _exact_success(self, pose: Any, executions: int, seed: int) -> Success:
        rollouts = self.rollout(pose, executions, seed)
        return share_of(np.arange(executions) < rollouts.outcomes[Outcome.TARGET])

    def _scattered(self, pose: Any, uncertainty: Uncertainty, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        shift, turn = uncertainty.entry_sd_mm * numbers[:, 0], math.radians(uncertainty.heading_sd_deg) * numbers[:, 2]
        return scattered_poses(self.scenario.workspace, self.start(pose), shift, turn)

    def _reached(self, starts: NDArray[np.float64], truths: Truths, seed: int) -> NDArray[np.bool_]:
        rows = plane_truths(truths, self.scenario.target_mm)
        return self._execution(nearest=False).reached(starts, rows, seed)

    def _execution(self, *, nearest: bool) -> Execution:
        return Execution(self.lattice, self.policy, self.values, self.scenario, nearest)

    def plot(self, ax: Axes | None = None, *, heading_rad: float | None = None) -> Axes:
        """Draw the success probability over the workspace, with the better bevel at every position.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            The axes to draw on. Without them a new pyplot figure is made.
        heading_rad : float, optional
            Heading to show, in rad. Without it, the best heading at every position.

        Returns
        -------
        matplotlib.axes.Axes
            The axes, in mm.

        Raises
        ------
        PoseError
            If the heading is not a number or larger than 2 pi.

        Examples
        --------
        >>> import needleplan as npl
        >>> from matplotlib.figure import Figure
        >>> axes = npl.plan("four_obstacles").plot(Figure().subplots())
        >>> axes.get_title(loc="left")
        'Success probability at the best heading'
        """
        if heading_rad is not None:
            heading_rad = Pose(0, 0, heading_rad).heading_rad
        axes = axes_or_new(ax, self.scenario.workspace)
        self.scenario.plot(axes, on_map=True)
        draw_success(axes, self.scenario, self.success, self.lattice.outcomes(), heading_rad)
        return axes

    def plot_order(self, ax: Axes | None = None) -> Axes:
        """Draw the order in which the partitions were processed, for a table solved by the method "ppvi".

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            The axes to draw on. Without them a new pyplot figure is made.

        Returns
        -------
        matplotlib.axes.Axes
            The axes, in mm. Partitions that were never processed are grey.

        Raises
        ------
        InputError
            If the table was solved by a method without partitions.

        Examples
        --------
        >>> from dataclasses import replace
        >>> import needleplan as npl
        >>> from matplotlib.figure import Figure
        >>> scenario = npl.Scenario.read("four_obstacles")
        >>> coarse = replace(scenario.grid, spacing_mm=(4.0, 4.0))
        >>> solver = replace(scenario.solver, method="ppvi")
        >>> axes = npl.plan(replace(scenario, grid=coarse, solver=solver)).plot_order(Figure().subplots())
        >>> axes.get_title(loc="left").startswith("Order of processing")
        True
        """
        axes = axes_or_new(ax, self.scenario.workspace)
        self.scenario.plot(axes)
        draw_partition_order(axes, self.scenario, self.stats.order)
        return axes

    def to_xarray(self) -> xarray.Dataset:
        """Return the table as a labelled xarray dataset that shares the arrays.

        Returns
        -------
        xarray.Dataset
            The variables `values`, `policy` and `success` over the dimensions x, y, heading and bevel. Every coordinate
            has its unit in `attrs["units"]`: mm, mm, rad, 1.

        Raises
        ------
        InputError
            If xarray is not installed.

        Examples
        --------
        >>> import needleplan as npl
        >>> data = npl.plan("four_obstacles").to_xarray()
        >>> dict(data.sizes)
        {'x': 121, 'y': 81, 'heading': 60, 'bevel': 2}
        >>> data.success.sel(x=40, y=36, bevel=-1).max("heading").item() > 0.5
        True
        """
        axes: dict[str, tuple[Any, str]] = {
            "x": (self.scenario.x_mm, "mm"),
            "y": (self.scenario.y_mm, "mm"),
            "heading": (self.scenario.headings_rad, "rad"),
            "bevel": (np.array([-1, 1]), "1"),
        }
        arrays = {name: (getattr(self, name), *known) for name, known in TABLES.items()}
        return labelled_dataset(arrays, axes, self.scenario, self.digest)

    def _write(self, path: str | os.PathLike[str], key: bytes | None, compressed: bool) -> None:
        content = PlaneContent(self.values, self.policy, self.success, self.stats, self.scenario)
        write_plane(path, content, key, compressed=compressed)

    @classmethod
    def _of(cls, content: PlaneContent | SpaceContent) -> Self | None:
        if not isinstance(content, PlaneContent):
            return None
        return cls(content.values, content.policy, content.success, content.stats, content.scenario)


def _seed(key: str, value: Any) -> int:
    return whole_number(key, value, 0, 2**64 - 1, "from 0 to 2^64 - 1")
