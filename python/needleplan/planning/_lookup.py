"""Lookups in a policy table: decisions at exact poses or at the nearest states, for one pose or for many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, overload

import numpy as np

from needleplan import _ppvi
from needleplan.artifacts import short_html, short_repr
from needleplan.errors import Mistake, PoseError, TableError
from needleplan.planning._coded import Action
from needleplan.planning._lattice import Stats, compiled_call, lattice_of
from needleplan.planning._poses import FULL_TURN_RAD, Entry, Pose, flag, number_rows, require_full_turn
from needleplan.scenario import Scenario

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["Decision", "Decisions", "Expectations", "Lookups"]


@dataclass(frozen=True, repr=False)
class Decision:
    """Decision of the policy at one pose.

    Attributes
    ----------
    action : Action
        Insert, rotate and then insert, or insert straight.
    value : float
        Expected cost of the remaining insertion.
    success : float
        Probability of reaching the target.

    Examples
    --------
    >>> import needleplan as npl
    >>> print(npl.plan("four_obstacles").lookup(40.0, 36.0, 0.1, -1).action)
    rotate, then insert
    """

    action: Action
    value: float
    success: float

    _repr_html_ = short_html

    def __repr__(self) -> str:
        return f"<Decision: {self.action}; success {self.success:.3f}, cost {self.value:.4g}>"


class Decisions(NamedTuple):
    """Decisions of the policy at many poses.

    Attributes
    ----------
    action : ndarray of uint8, shape (n,)
        0 insert, 1 rotate, then insert, 2 insert straight.
    value : ndarray of float32, shape (n,)
        Expected costs.
    success : ndarray of float32, shape (n,)
        Probabilities of reaching the target.

    Examples
    --------
    >>> import needleplan as npl
    >>> npl.plan("four_obstacles").lookup_many([(0, 28, 0.3, -1), (0, 28, 0.3, 1)]).action
    array([0, 1], dtype=uint8)
    """

    action: NDArray[np.uint8]
    value: NDArray[np.float32]
    success: NDArray[np.float32]

    def _repr_html_(self) -> str:
        return short_html(self)

    def __repr__(self) -> str:
        return short_repr(self)


class Expectations(NamedTuple):
    """Expected length and number of rotations of an execution from each state; inf if it may never end.

    Attributes
    ----------
    length_mm : ndarray of float32, shape (nx, ny, headings, 2)
        Expected insertion length in mm, failures included.
    turns : ndarray of float32, shape (nx, ny, headings, 2)
        Expected number of rotations, failures included.

    Examples
    --------
    >>> import needleplan as npl
    >>> npl.plan("four_obstacles").expectations().turns.shape
    (121, 81, 60, 2)
    """

    length_mm: NDArray[np.float32]
    turns: NDArray[np.float32]

    def _repr_html_(self) -> str:
        return short_html(self)

    def __repr__(self) -> str:
        return short_repr(self)


@dataclass(frozen=True, eq=False, repr=False)
class Lookups:
    """The arrays of a policy table and the lookups in them; base class of `PolicyTable`."""

    values: NDArray[np.float32]
    policy: NDArray[np.uint8]
    success: NDArray[np.float32]
    stats: Stats
    scenario: Scenario

    def __post_init__(self) -> None:
        for name, kind in (("stats", Stats), ("scenario", Scenario)):
            if not isinstance(getattr(self, name), kind):
                raise TableError(Mistake(name, repr(getattr(self, name)), f"must be a {kind.__name__}"))
        for name, dtype in (("values", np.float32), ("policy", np.uint8), ("success", np.float32)):
            array = getattr(self, name)
            if not isinstance(array, np.ndarray) or array.shape != self.scenario.shape or array.dtype != dtype:
                given = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else repr(array)
                rule = f"must be {np.dtype(dtype).name} of the shape {self.scenario.shape} of the scenario"
                raise TableError(Mistake(name, given, rule))
            array.flags.writeable = False
        self._require_numbers()

    def _require_numbers(self) -> None:
        """Raise TableError if a cost is NaN, an action is unknown, or a success is not a probability."""
        if np.isnan(self.values.min()):
            raise TableError(Mistake("values", "nan", "must be costs"))
        has_straight = self.scenario.motion.straight_curvature_share is not None
        if (most := int(self.policy.max())) > (Action.STRAIGHT if has_straight else Action.ROTATE).code:
            last = ", 1 (rotate, then insert) or 2 (insert straight)" if has_straight else " or 1 (rotate, then insert)"
            raise TableError(Mistake("policy", f"{most}", f"must be 0 (insert){last}"))
        low, high = float(self.success.min()), float(self.success.max())
        if not (low >= 0 and high <= 1):
            raise TableError(Mistake("success", f"{low:g} to {high:g}", "must be probabilities, from 0 to 1"))

    @cached_property
    def lattice(self) -> _ppvi.Lattice:
        """The compiled lattice of the scenario."""
        return lattice_of(self.scenario)

    @overload
    def lookup(self, x_mm: Pose | Entry[Pose] | Sequence[float], *, nearest: bool = ...) -> Decision: ...

    @overload
    def lookup(self, x_mm: float, y_mm: float, heading_rad: float, bevel: int, *, nearest: bool = ...) -> Decision: ...

    def lookup(
        self,
        x_mm: float | Pose | Entry[Pose] | Sequence[float],
        y_mm: float | None = None,
        heading_rad: float | None = None,
        bevel: int | None = None,
        *,
        nearest: bool = False,
    ) -> Decision:
        """Return the decision at a pose.

        Every action is executed from the exact pose for one step in the continuous model. Where the step does not end
        the insertion, the table is read at its end: where the tangent crosses the columns of the grid (or the rows, if
        the heading is nearer to y), and linearly between them and in the heading.

        Parameters
        ----------
        x_mm : float, or Pose, Entry or sequence of float
            Position along the insertion in mm, or a whole pose instead of the four numbers.
        y_mm : float
            Lateral position in mm.
        heading_rad : float
            Heading in rad, at most a full turn in size.
        bevel : {-1, 1}
            Bevel side.
        nearest : bool, default False
            Return the entry of the table at the state nearest to the pose instead, as in the thesis.

        Returns
        -------
        Decision
            Action, expected cost and success probability.

        Raises
        ------
        PoseError
            If the pose lies outside the workspace or is not made of such numbers.

        Examples
        --------
        >>> import needleplan as npl
        >>> table = npl.plan("four_obstacles")
        >>> table.lookup(40.0, 36.0, 0.1, -1) == table.lookup(npl.Pose(40.0, 36.0, 0.1, -1))
        True
        """
        if y_mm is None and heading_rad is None and bevel is None and not isinstance(x_mm, int | float):
            x_mm, y_mm, heading_rad, bevel = self.start(x_mm, nearest=nearest)
        try:
            row = (float(x_mm), float(y_mm), float(heading_rad), float(bevel))  # type: ignore[arg-type]
        except (TypeError, ValueError):
            Pose(x_mm, y_mm, heading_rad, bevel)  # type: ignore[arg-type]  # raises for all but a missing bevel
            raise PoseError(Mistake("bevel", str(bevel), "must be -1 or +1")) from None
        require_full_turn("heading_rad", row[2])
        action, value, success = self._answers(np.array([row]), nearest)
        return Decision(Action(action[0]), float(value[0]), float(success[0]))

    def lookup_many(self, poses: ArrayLike, *, nearest: bool = False) -> Decisions:
        """Return the decisions at many poses, each as `lookup` does.

        Parameters
        ----------
        poses : array_like of float, shape (n, 4)
            Rows of x_mm, y_mm, heading_rad and bevel, or a DataFrame with columns of these names, in any order.
        nearest : bool, default False
            Return the entries of the table at the nearest states instead; this takes about 50 ns for a pose.

        Returns
        -------
        Decisions
            Arrays of actions, expected costs and success probabilities, one entry a row.

        Raises
        ------
        PoseError
            If the array has another shape, or a row lies outside the workspace, is no number, or has a heading beyond
            2 pi; the message names the first such row.

        Examples
        --------
        >>> import numpy as np
        >>> import needleplan as npl
        >>> table = npl.plan("four_obstacles")
        >>> poses = np.array([[0.0, y, 0.0, 1.0] for y in (20.0, 30.0, 40.0)])
        >>> table.lookup_many(poses).success.shape
        (3,)
        """
        rows = number_rows(poses, Pose._fields)
        if rows.ndim != 2 or rows.shape[1] != 4:
            rule = "must have the shape (n, 4): rows of x_mm, y_mm, heading_rad and bevel"
            raise PoseError(Mistake("poses", f"shape {rows.shape}", rule))
        headings = rows[:, 2]
        if len(rows) and (headings.max() > FULL_TURN_RAD or headings.min() < -FULL_TURN_RAD):
            row = int(np.argmax(np.abs(headings) > FULL_TURN_RAD))
            require_full_turn(f"poses[{row}].heading_rad", float(headings[row]))
        return Decisions(*self._answers(rows, nearest))

    def _answers(
        self, rows: NDArray[np.float64], nearest: bool
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32]]:
        """Return action, value and success at rows [n, 4], or at the nearest states. Raises PoseError."""
        if not flag("nearest", nearest):
            return compiled_call(
                PoseError,
                self.lattice.predict,
                policy=self.policy,
                values=self.values,
                success=self.success,
                poses=rows,
            )
        return compiled_call(
            PoseError,
            _ppvi.lookup_many,
            values=self.values,
            policy=self.policy,
            success=self.success,
            spacing_mm=self.scenario.grid.spacing_mm,
            size_mm=(self.scenario.workspace.width_mm, self.scenario.workspace.height_mm),
            poses=rows,
        )

    def expectations(self) -> Expectations:
        """Evaluate the expected insertion length and number of rotations of the policy from every state.

        Returns
        -------
        Expectations
            Two arrays of the shape of the table.

        Notes
        -----
        The evaluation takes about as long as a solve. With `grid.refinement` the policy is evaluated on the grid of
        the table, not on the finer one.

        Examples
        --------
        >>> import needleplan as npl
        >>> expected = npl.plan("four_obstacles").expectations()
        >>> bool(expected.length_mm[0, 28, 3, 0] > 100)
        True
        """
        expected = self.lattice.expectations(self.policy, threads=self.scenario.solver.threads)
        return Expectations(expected["length_mm"], expected["turns"])

    def start(self, pose: Entry[Pose] | Pose | Sequence[float], *, nearest: bool = False) -> Pose:
        """Return the pose at which an execution begins.

        Parameters
        ----------
        pose : Entry, Pose or sequence of float
            x_mm, y_mm, heading_rad and, if known, bevel.
        nearest : bool, default False
            Compare the bevels at the nearest states instead of at the pose.

        Returns
        -------
        Pose
            The pose. If `pose` has no bevel, the result has the bevel with the lower expected cost.

        Raises
        ------
        PoseError
            If the pose lies outside the workspace or is not made of such numbers.

        Examples
        --------
        >>> import needleplan as npl
        >>> table = npl.plan("four_obstacles")
        >>> table.start(npl.Pose.deg(0, 28, 18)).bevel
        -1
        """
        start = Pose.of(pose)
        try:
            if start.bevel is not None:
                self.lookup(*start, nearest=nearest)
                return start
            pair = start._replace(bevel=1), start._replace(bevel=-1)
            return min(pair, key=lambda sided: self.lookup(*sided, nearest=nearest).value)
        except PoseError:
            workspace = self.scenario.workspace
            rule = f"must lie in the workspace, [0, {workspace.width_mm:g}] x [0, {workspace.height_mm:g}] mm"
            raise PoseError(Mistake("pose", str(start), rule)) from None
