"""Poses of the tip, and the poses at which a needle can enter the workspace."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import numpy as np

from needleplan.artifacts import short_html
from needleplan.config import suggestion
from needleplan.errors import InputError, Mistake, PoseError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.scenario import Scenario

__all__ = [
    "FULL_TURN_RAD",
    "Edge",
    "Entry",
    "Pose",
    "PoseOf",
    "best_of",
    "edge_poses",
    "flag",
    "number_rows",
    "require_full_turn",
    "whole_number",
    "wrapped",
]

# Largest size (rad) of a heading, so large that 2 pi in single precision is accepted. Larger ones are likely degrees.
FULL_TURN_RAD = 2 * math.pi + 1e-6

# Distance (mm) beyond the border up to which a grid point counts as on the border, because of rounding.
_ROUNDING_MM = 1e-9
# Step to which success probabilities of entries are rounded; among equal ones, the lower cost decides.
_SUCCESS_STEP = 0.001

_POSE_RULE = "a pose is x_mm, y_mm, heading_rad and bevel (-1 or +1)"


# Kind of pose of an entry: `Pose` or `SpacePose`.
PoseOf = TypeVar("PoseOf")


class _PoseFields(NamedTuple):
    x_mm: float
    y_mm: float
    heading_rad: float
    bevel: int | Any


class Pose(_PoseFields):
    """Position, heading and bevel side of the needle's tip; a named tuple.

    Parameters
    ----------
    x_mm, y_mm : float
        Position in mm: x along the insertion, y lateral.
    heading_rad : float
        Tip tangent in rad from +x, counter-clockwise positive, at most a full turn in size.
    bevel : {-1, 1}, optional
        Sign of the arc's curvature. Without it, a table uses the bevel with the lower expected cost.

    Raises
    ------
    PoseError
        If a number is not finite, the heading is larger than 2 pi, or the bevel is neither -1 nor +1.

    See Also
    --------
    Pose.deg : the same with the heading in degrees.

    Examples
    --------
    >>> import needleplan as npl
    >>> pose = npl.Pose(0.0, 28.0, 0.314, -1)
    >>> pose.y_mm
    28.0
    >>> print(pose)
    x 0 mm, y 28 mm, heading 17.99 deg, bevel -1
    """

    __slots__ = ()
    _repr_html_ = short_html

    def __new__(cls, x_mm: float, y_mm: float, heading_rad: float, bevel: int | None = None) -> Pose:
        """Check the numbers and make the pose."""
        x, y = _finite("x_mm", x_mm, "mm"), _finite("y_mm", y_mm, "mm")
        heading = require_full_turn("heading_rad", _finite("heading_rad", heading_rad, "rad"))
        if bevel is None:
            return super().__new__(cls, x, y, heading, None)
        try:
            side = float(bevel)
        except (TypeError, ValueError):
            side = math.nan
        if abs(side) != 1:
            raise PoseError(Mistake("bevel", str(bevel), f"must be -1 or +1; {_POSE_RULE}"))
        return super().__new__(cls, x, y, heading, int(side))

    @classmethod
    def deg(cls, x_mm: float, y_mm: float, heading_deg: float, bevel: int | None = None) -> Pose:
        """Make a pose with the heading in degrees.

        Parameters
        ----------
        x_mm, y_mm : float
            Position in mm.
        heading_deg : float
            Tip tangent in degrees from +x, counter-clockwise positive, from -360 to 360.
        bevel : {-1, 1}, optional
            Sign of the arc's curvature. Without it, a table takes the bevel of the lower cost.

        Returns
        -------
        Pose
            The pose, with the heading in rad.

        Raises
        ------
        PoseError
            If a number is not finite, the heading is out of range, or the bevel is neither -1 nor +1.

        Examples
        --------
        >>> import needleplan as npl
        >>> npl.Pose.deg(0, 28, 90, -1)
        Pose(x_mm=0.0, y_mm=28.0, heading_rad=1.5707963267948966, bevel=-1)
        """
        degrees = _finite("heading_deg", heading_deg, "degrees")
        if abs(degrees) > 360:
            raise PoseError(Mistake("heading_deg", f"{degrees:g}", "must lie between -360 and 360 degrees"))
        return cls(x_mm, y_mm, math.radians(degrees), bevel)

    @classmethod
    def of(cls, pose: Entry[Pose] | Iterable[float]) -> Pose:
        """Make a pose from an entry, another pose, or a sequence of three or four numbers.

        Parameters
        ----------
        pose : Entry, Pose or sequence of float
            x_mm, y_mm, heading_rad and, if known, bevel.

        Returns
        -------
        Pose
            The checked pose. Its bevel is None if `pose` has none.

        Raises
        ------
        PoseError
            If `pose` does not hold three or four such numbers.

        Examples
        --------
        >>> import needleplan as npl
        >>> print(npl.Pose.of([10, 20, 0.0, 1]))
        x 10 mm, y 20 mm, heading 0 deg, bevel +1
        """
        if isinstance(pose, Pose):
            return pose
        if isinstance(pose, Entry):
            return cls.of(pose.pose)
        try:
            numbers: list[Any] = [] if isinstance(pose, str | bytes) else list(pose)
        except TypeError:
            numbers = []
        if len(numbers) not in (3, 4):
            shown = ", ".join(map(str, numbers)) or repr(pose)
            raise PoseError(Mistake("pose", shown, _POSE_RULE))
        return cls(*numbers)

    @classmethod
    def wound(cls, row: Iterable[float]) -> Pose:
        """Make a pose from a row of an execution, whose heading may exceed a full turn.

        Parameters
        ----------
        row : sequence of float
            x_mm, y_mm, heading_rad and bevel.

        Returns
        -------
        Pose
            The pose, with its heading reduced by whole turns to less than 2 pi.

        Examples
        --------
        >>> import needleplan as npl
        >>> print(npl.Pose.wound([1.0, 2.0, 7.0, 1.0]))
        x 1 mm, y 2 mm, heading 41.07 deg, bevel +1
        """
        x, y, heading, bevel = row
        return cls(x, y, math.fmod(heading, 2 * math.pi), int(bevel))

    def __str__(self) -> str:
        side = "either bevel" if self.bevel is None else f"bevel {self.bevel:+d}"
        return f"x {self.x_mm:g} mm, y {self.y_mm:g} mm, heading {math.degrees(self.heading_rad):.4g} deg, {side}"


class Edge(StrEnum):
    """An edge of the workspace: left is x = 0, bottom is y = 0.

    Examples
    --------
    >>> from needleplan.planning import Edge
    >>> Edge("top").inward_rad
    -1.5707963267948966
    """

    LEFT = "left"
    RIGHT = "right"
    BOTTOM = "bottom"
    TOP = "top"

    @property
    def inward_rad(self) -> float:
        """Heading in rad that leads straight into the workspace."""
        return {Edge.LEFT: 0.0, Edge.RIGHT: math.pi, Edge.BOTTOM: math.pi / 2, Edge.TOP: -math.pi / 2}[self]


@dataclass(frozen=True, repr=False)
class Entry(Generic[PoseOf]):
    """A pose at which the needle enters, with the predictions of the table for it.

    Attributes
    ----------
    pose : Pose or SpacePose
        The entry pose, in the plane or in 3D.
    success : float
        Probability of reaching the target, by the table.
    value : float
        Expected cost.

    Examples
    --------
    >>> import needleplan as npl
    >>> npl.plan("four_obstacles").best_entry()
    <Entry: x 0 mm, y 23 mm, heading 30 deg, bevel -1; success 0.951, cost 889.6>
    """

    pose: PoseOf
    success: float
    value: float

    _repr_html_ = short_html

    def __repr__(self) -> str:
        return f"<Entry: {self.pose}; success {self.success:.3f}, cost {self.value:.4g}>"


def best_of(
    edge: str, poses: NDArray[np.float64], success: NDArray[np.float32], value: NDArray[np.float32]
) -> Entry[Pose]:
    """Return the best of poses [n, 4] on an edge: highest success, then lowest cost, then straightest heading."""
    inclination = np.abs(poses[:, 2] - Edge(edge).inward_rad)
    best = np.lexsort((inclination, value, -np.round(success / _SUCCESS_STEP)))[0]
    x, y, heading, bevel = poses[best].tolist()
    return Entry(Pose(x, y, wrapped(heading), int(bevel)), float(success[best]), float(value[best]))


def edge_poses(scenario: Scenario, edge: str, x_mm: float | None, y_mm: float | None) -> NDArray[np.float64]:
    """Return the poses [n, 4] on an edge that lead into the workspace, at every grid point or at the given position.

    Grid points beyond the border are left out. Headings lie within less than a quarter turn of the inward normal.
    Raises PoseError.
    """
    if not isinstance(edge, str) or edge not in list(Edge):
        names = ", ".join(f'"{name}"' for name in Edge)
        raise PoseError(Mistake("edge", f'"{edge}"', f"must be one of {names}{suggestion(str(edge), list(Edge))}"))
    side = Edge(edge)
    vertical = side in (Edge.LEFT, Edge.RIGHT)
    workspace = scenario.workspace
    x = _along("x_mm", x_mm, workspace.width_mm, scenario.x_mm, "" if not vertical else edge)
    y = _along("y_mm", y_mm, workspace.height_mm, scenario.y_mm, "" if vertical else edge)
    if vertical:
        x = np.array([0.0 if side is Edge.LEFT else workspace.width_mm])
    else:
        y = np.array([0.0 if side is Edge.BOTTOM else workspace.height_mm])
    turned = np.remainder(scenario.headings_rad - side.inward_rad + math.pi, 2 * math.pi) - math.pi
    headings = side.inward_rad + turned[np.abs(turned) < math.pi / 2 - 1e-9]
    grid = np.meshgrid(x, y, headings, np.array([-1.0, 1.0]), indexing="ij")
    return np.stack([axis.ravel() for axis in grid], axis=1)


def _along(
    name: str, position: float | None, size_mm: float, points: NDArray[np.float64], across: str
) -> NDArray[np.float64]:
    """Return the positions to search along an axis; `across` names the edge if the axis is perpendicular to it."""
    if position is None:
        return points[points <= size_mm + _ROUNDING_MM]
    if across:
        raise PoseError(Mistake(name, str(position), f'must not be given for the edge "{across}"'))
    try:
        number = float(position)
    except (TypeError, ValueError):
        number = math.nan
    if not 0 <= number <= size_mm:
        raise PoseError(Mistake(name, str(position), f"must lie in the workspace, from 0 to {size_mm:g} mm"))
    return np.array([number])


def wrapped(heading_rad: float) -> float:
    """Return the same heading (rad) in the range (-pi, pi]."""
    turned = math.remainder(heading_rad, 2 * math.pi)
    return math.pi if turned == -math.pi else turned


def require_full_turn(key: str, heading_rad: float) -> float:
    """Return the heading. Raises PoseError if it is larger than a full turn; it was probably meant in degrees."""
    if abs(heading_rad) > FULL_TURN_RAD:
        degrees = f"{heading_rad:g} degrees are {math.radians(heading_rad):.4g} rad, or use Pose.deg"
        rule = f"must lie between -2 pi and 2 pi rad; degrees? ({degrees})"
        raise PoseError(Mistake(key, f"{heading_rad:g}", rule))
    return heading_rad


def flag(key: str, value: object) -> bool:
    """Return `value` as a bool. Raises PoseError unless it is True or False."""
    if not isinstance(value, bool | np.bool_):
        raise PoseError(Mistake(key, repr(value), "must be True or False"))
    return bool(value)


def number_rows(poses: Any, columns: Sequence[str]) -> NDArray[np.float64]:
    """Return poses as an array of numbers. A table with named columns, such as a DataFrame, must have `columns`.

    Raises PoseError for missing columns, and for values that are no real numbers.
    """
    named = getattr(poses, "columns", None)
    if named is not None:
        if missing := [name for name in columns if name not in list(named)]:
            rule = f"must have the columns {', '.join(columns)}; {', '.join(missing)}: missing"
            raise PoseError(Mistake("poses", f"columns {', '.join(map(str, named))}", rule))
        poses = [poses[name] for name in columns]
    try:
        rows = np.asarray(poses)
        if rows.dtype.kind == "c":
            raise ValueError("complex numbers")
        return np.ascontiguousarray(rows if named is None else rows.T, dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise PoseError(Mistake("poses", "", f"must be an array of numbers: {error}")) from None


def whole_number(key: str, value: Any, least: int, most: int, limits: str, kind: type[InputError] = PoseError) -> int:
    """Return `value` as an int. Raises the error `kind` unless it is a whole number from `least` to `most`.

    `limits` describes this range in the message.
    """
    try:
        number = int(value) if isinstance(value, int | np.integer | float) and value == int(value) else None
    except (ValueError, OverflowError):
        number = None
    if number is None or isinstance(value, bool) or not least <= number <= most:
        raise kind(Mistake(key, str(value), f"must be a whole number {limits}"))
    return number


def _finite(key: str, value: Any, unit: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise PoseError(Mistake(key, str(value), f"must be a finite number in {unit}; {_POSE_RULE}"))
    return number
