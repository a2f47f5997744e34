"""The best plane through an anatomy, as a scenario for the planner in the plane.

The planes contain the axis of the lattice through the centroid of the target. In a plane, x is along the axis, from the
deepest entry point of the plane on, and y across it. Obstacles and what is outside of the body become polygons, tissues
keep their radii, the target is the disc of the same area. The noise of a step has five values with the variance of the
noise in 3D. What the plane leaves out: the noise across it, and all paths that leave it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy import OBSTACLE, OUTSIDE, TARGET, SpaceScenario
from needleplan.artifacts import ShortRepr
from needleplan.errors import Mistake, ScenarioError
from needleplan.planning._planner import plan_plane
from needleplan.planning._space_pose import SpacePose
from needleplan.scenario import Grid, Needle, Objective, Obstacle, Scenario, Target, TipMotion, Tissue, Workspace

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.planning._poses import Pose
    from needleplan.planning._table import PolicyTable

__all__ = ["AnatomyPlane", "best_plane", "plane_scenario"]

# Number of planes that are tried, over half a turn; pixels of a plane for each grid point of the lattice.
_PLANES, _FINER = 12, 2
# Binomial weights with the variance 1, in steps of one standard deviation.
_NOISE = (0.375, 0.25, 0.0625)
_HEADINGS = 72
# Widening (mm) of polygons, which joins pixels that touch at a corner only.
_JOINED_MM = 0.05


@dataclass(frozen=True, eq=False)
class AnatomyPlane(ShortRepr):
    """A plane through an anatomy, its plan, and the best entry of this plan.

    `angle_rad` is the angle of the plane about the axis, from y to z. `origin_mm`, shape (3,), and `axes`, shape (2,
    3), are the origin and the axes of the plane in the frame of the lattice.
    """

    angle_rad: float
    origin_mm: NDArray[np.float64]
    axes: NDArray[np.float64]
    table: PolicyTable
    entry: Pose
    success: float
    seconds: float

    def pose(self, pose: Pose) -> SpacePose:
        """Convert a pose in the plane to a 3D pose in the frame of the lattice (mm)."""
        place = self.origin_mm + np.array([pose.x_mm, pose.y_mm]) @ self.axes
        tangent = np.array([math.cos(pose.heading_rad), math.sin(pose.heading_rad)]) @ self.axes
        return SpacePose(*place.tolist(), *tangent.tolist())


def best_plane(scenario: SpaceScenario) -> AnatomyPlane:
    """Return the plane with the highest success of its best entry.

    Parameters
    ----------
    scenario : SpaceScenario
        The anatomy.

    Returns
    -------
    AnatomyPlane

    Raises
    ------
    ScenarioError
        If no plane has an entry point in front of the target.
    """
    planes: list[AnatomyPlane] = []
    for number in range(_PLANES):
        angle = math.pi * number / _PLANES
        made = plane_scenario(scenario, angle)
        if made is None:
            continue
        planar, origin, axes, entries = made
        table = plan_plane(planar)
        ends = [table.best_entry("left", y_mm=float(y)) for y in entries]
        best = max(ends, key=lambda entry: entry.success)
        planes.append(AnatomyPlane(angle, origin, axes, table, best.pose, best.success, table.stats.seconds))
    if not planes:
        rule = "no plane through the axis has an entry point in front of the target"
        raise ScenarioError(Mistake("anatomy.entry", scenario.file.anatomy.entry_text, rule))
    return max(planes, key=lambda plane: plane.success)


def plane_scenario(
    scenario: SpaceScenario, angle_rad: float
) -> tuple[Scenario, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None:
    """Return the scenario of a plane, its origin and axes in the lattice, and y (mm) of the entries on its left edge.

    Returns None if the plane has no entry point in front of the target.
    """
    spacing, shape = scenario.grid.frame.spacing_mm, np.array(scenario.grid.frame.shape)
    pixel, across = spacing / _FINER, np.array([0.0, math.cos(angle_rad), math.sin(angle_rad)])
    center = np.array(scenario.target_mm)
    # Distances along `across` at which the line through the target is in the lattice.
    sides = [((each - center[axis]) / across[axis]) for axis in (1, 2) if abs(across[axis]) > 1e-9
             for each in (0.0, (shape[axis] - 1) * spacing)]  # fmt: skip
    low, high = max(side for side in sides if side <= 0), min(side for side in sides if side >= 0)
    rows = np.arange(math.ceil(low / pixel), math.floor(high / pixel) + 1) * pixel
    columns = np.arange((shape[0] - 1) * _FINER + 1) * pixel
    places = columns[:, None, None] * np.array([1.0, 0, 0]) + center * [0, 1, 1] + rows[:, None] * across
    index = tuple(np.moveaxis(np.floor(places / spacing + 0.5).astype(int), -1, 0))
    codes, tissues = scenario.grid.codes[index], scenario.grid.tissues[index]
    first = scenario.grid.entry[index] > 0
    enters = first.any(0)
    if not enters.any() or not (codes == TARGET).any():
        return None
    begin = int(first.argmax(0)[enters].max())
    if begin >= int(np.argwhere(codes == TARGET)[:, 0].min()):
        return None
    codes, tissues = codes[begin:], tissues[begin:]
    width, height = (codes.shape[0] - 1) * pixel, (codes.shape[1] - 1) * pixel
    target = np.argwhere(codes == TARGET)
    (x, y), radius = target.mean(0) * pixel, math.sqrt(len(target) * pixel**2 / math.pi)
    obstacles = _obstacles((codes == OBSTACLE) | (codes == OUTSIDE), pixel, (x, y, radius))
    planned = Scenario(
        Workspace(width, height), Target((float(x), float(y)), radius), Needle(scenario.needle.curvature_radius_mm),
        obstacles=obstacles, tissues=_tissues(scenario, tissues, pixel), title=f"{scenario.title}, best plane",
        motion=TipMotion(
            headings=_HEADINGS, step_mm=scenario.step_mm, tip_noise=_NOISE, arc_samples=8,
            tip_noise_step_deg=math.degrees(scenario.noise_rad_sqrt_mm * math.sqrt(scenario.step_mm)),
        ),
        grid=Grid((1.0, 1.0)),
        objective=Objective(
            insertion_per_mm=scenario.file.objective.insertion_per_mm, rotation=scenario.file.objective.rotation
        ),
    )  # fmt: skip
    free = enters & (codes[0] == 0)
    origin = np.array([begin * pixel, center[1], center[2]]) + rows[0] * across
    entries = (rows - rows[0])[free]
    return (planned, origin, np.array([[1.0, 0.0, 0.0], across]), entries) if len(entries) else None


def _pixels(mask: NDArray[np.bool_], pixel: float) -> Any:
    """Return the union of the pixels of a mask."""
    import shapely

    i, j = np.nonzero(mask)
    half = pixel / 2
    boxes = shapely.box(i * pixel - half, j * pixel - half, i * pixel + half, j * pixel + half)
    return shapely.union_all(boxes).buffer(_JOINED_MM, join_style="mitre").simplify(_JOINED_MM / 2)


def _obstacles(mask: NDArray[np.bool_], pixel: float, target: tuple[float, float, float]) -> tuple[Obstacle, ...]:
    """Return the obstacles of a mask, without the centre of the target."""
    import shapely

    if not mask.any():
        return ()
    x, y, radius = target
    closed = _pixels(mask, pixel).difference(shapely.Point(x, y).buffer(radius / 2))
    return Obstacle.from_shapely(closed, "anatomy")


def _tissues(scenario: SpaceScenario, numbers: NDArray[np.uint8], pixel: float) -> tuple[Tissue, ...]:
    """Return the regions of all tissues that have a radius of their own."""
    found = []
    for number, radius in enumerate(scenario.grid.radii_mm):
        if number and (numbers == number).any():
            region = _pixels(numbers == number, pixel)
            for part in getattr(region, "geoms", [region]):
                holes = tuple(tuple(ring.coords)[:-1] for ring in part.interiors)
                found.append(
                    Tissue(polygon_mm=tuple(part.exterior.coords)[:-1], holes_mm=holes or None,
                           curvature_radius_mm=radius, name=f"tissue {number}")
                )  # fmt: skip
    return tuple(found)
