"""Curvature and roll angles by depth for a planner in the plane, from a model of the path of the tip in 3D.

The planner uses arcs to the left and to the right. A `SteeredModel` gives the curvature of the path for any roll
angle. For each side this module finds the roll angle at which the path does not leave the plane, and the curvature at
that angle. The planner uses the mean of the two curvatures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.errors import Mistake, ModelError
from needleplan.models._base import Model
from needleplan.models.effects import AugmentedModel
from needleplan.models.path import SteeredModel
from needleplan.signals import Array, Motion

__all__ = ["InPlane", "in_plane"]

# Number of Newton steps for the roll angle.
_ROUNDS = 12
# Step of the difference quotient, and largest Newton step, rad.
_STEP_RAD, _FARTHEST_RAD = 1e-4, 0.5
# Derivative of the curvature with respect to the roll angle below which no Newton step is taken, 1/(mm rad).
_FLAT_PER_MM = 1e-9
# Rotation of the base that surely produces the full lag of the tip, rad.
_FAR_RAD = 100.0
# Smallest curvature that the planner gets, 1/mm; needed because the path of a beam begins with curvature 0.
_LEAST_PER_MM = 1e-5
# Spacing of the inserted lengths, mm.
_SPACING_MM = 0.5


@dataclass(frozen=True, eq=False)
class InPlane(CallRepr):
    """Path of the tip in the plane as a function of the inserted length.

    Parameters
    ----------
    depth_mm : Array
        Inserted length, shape (n,), as all arrays below.
    left_per_mm, right_per_mm : Array
        Curvature to the left and to the right; neither is negative.
    roll_left_rad, roll_right_rad : Array
        Roll angle of the base at which the path stays in the plane; 0 and pi for an ideal needle.
    lag_rad : Array
        Largest angle by which the tip lags behind the base while the base rotates.
    along_mm : Array
        Distance covered in x for each path length if the bevel is flipped halfway.
    heading_rad, elevation_rad : float
        Angles from the assumed to the modelled direction of the path at the entry, in the plane and out of the plane.

    Examples
    --------
    >>> import needleplan as npl
    >>> flat = npl.models.in_plane(npl.models.SpatialBicycle(curvature_per_mm=0.01), deepest_mm=50.0)
    >>> print(f"{flat.left_per_mm[0]:.3f} {flat.right_per_mm[0]:.3f}")
    0.010 0.010
    """

    depth_mm: Array
    left_per_mm: Array
    right_per_mm: Array
    roll_left_rad: Array
    roll_right_rad: Array
    lag_rad: Array
    along_mm: Array
    heading_rad: float
    elevation_rad: float

    @property
    def curvature_per_mm(self) -> Array:
        """Curvature that the planner uses: the mean of both sides, but at least 1e-5/mm; shape (n,)."""
        return np.maximum((self.left_per_mm + self.right_per_mm) / 2, _LEAST_PER_MM)

    def roll_rad(self, bevel: int, depth_mm: float) -> float:
        """Return the roll angle of the base for a bevel side of the plan at a depth.

        Parameters
        ----------
        bevel : int
            Side of the bevel, +1 (left) or -1 (right).
        depth_mm : float
            Depth (mm). The angle is interpolated, and constant beyond both ends.

        Returns
        -------
        float
            Roll angle (rad).
        """
        rolls = self.roll_left_rad if bevel > 0 else self.roll_right_rad
        return float(np.interp(depth_mm, self.depth_mm, rolls))


def in_plane(model: Model, deepest_mm: float, velocity_mm_s: float = 5.0) -> InPlane:
    """Return curvature and roll angles for a planner in the plane, from a model of the tip's 3D path.

    Effects of the sensor are left out.

    Parameters
    ----------
    model : Model
        A `SteeredModel`, with or without effects.
    deepest_mm : float
        Largest inserted length.
    velocity_mm_s : float
        Velocity of the insertion.

    Returns
    -------
    InPlane
        Curvature and roll angles by inserted length.

    Raises
    ------
    ModelError
        If the model is not a `SteeredModel`, or the curvature to one side is negative at a depth or zero everywhere.

    Examples
    --------
    >>> import needleplan as npl
    >>> flat = npl.models.in_plane(npl.models.SpatialBicycle(curvature_per_mm=0.01), deepest_mm=50.0)
    >>> print(f"{flat.curvature_per_mm[-1]:.3f} {flat.roll_rad(-1, 20.0):.4f}")
    0.010 3.1416
    """
    plant = model.plant if isinstance(model, AugmentedModel) else model
    whole = plant.whole if isinstance(plant, AugmentedModel) else plant
    if not isinstance(whole, SteeredModel):
        raise ModelError(
            Mistake("kind", model.name, "must be a model of the path of a tip in 3D, such as spatial_bicycle")
        )
    count = max(round(deepest_mm / _SPACING_MM), 2) + 1
    depth = np.linspace(0.0, deepest_mm, count)
    (left, roll_left), (right, roll_right) = (_rolled(whole, depth, velocity_mm_s, wanted) for wanted in (0.0, np.pi))
    least = min(left.min(), right.min())
    if least < 0 or min(left.max(), right.max()) == 0:
        rule = "must bend to both sides everywhere: no plan can steer it"
        raise ModelError(Mistake("curvature", f"{least:.3g} 1/mm", rule), model.name)
    turned = _motion(depth, velocity_mm_s, np.full(count, _FAR_RAD))
    lag = _FAR_RAD - whole.following(np.zeros(count), turned)
    halfway = _motion(depth, velocity_mm_s, np.where(depth > deepest_mm / 2, np.pi, 0.0))
    slopes = whole.entry(halfway)[1]
    return InPlane(
        depth, left, right, roll_left, roll_right, lag, _along(left, right, depth),
        float(np.arctan(slopes[0])), float(np.arctan(slopes[1])),
    )  # fmt: skip


def _rolled(model: SteeredModel, depth: Array, velocity_mm_s: float, wanted_rad: float) -> tuple[Array, Array]:
    """Find, for each depth, the roll angle at which the path bends to one side and stays in the plane.

    Return the curvature at that angle (1/mm) and the angle (rad), shape (n,) each. `wanted_rad` is the roll angle of an
    ideal needle for this side: 0 (left) or pi (right).
    """
    roll = np.full(depth.size, wanted_rad)

    def bend(roll: Array) -> Array:
        return np.asarray(model.bend_per_mm(_motion(depth, velocity_mm_s, roll), roll))

    for _ in range(_ROUNDS):  # Newton's method, from the direction of the side
        out = bend(roll)[1]
        slope = (bend(roll + _STEP_RAD)[1] - bend(roll - _STEP_RAD)[1]) / (2 * _STEP_RAD)
        steep = np.abs(slope) > _FLAT_PER_MM
        roll = roll - np.where(steep, np.clip(out / np.where(steep, slope, 1.0), -_FARTHEST_RAD, _FARTHEST_RAD), 0.0)
    return np.asarray(bend(roll)[0] * np.cos(wanted_rad)), roll


def _motion(depth: Array, velocity_mm_s: float, roll: Array) -> Motion:
    return Motion.sampled(depth / velocity_mm_s, depth, np.full(depth.size, velocity_mm_s), roll)


def _along(left: Array, right: Array, depth: Array) -> Array:
    """Return the distance covered in x (mm) for each path length in `depth`, with a bevel flip halfway; shape (n,)."""
    bend = (left + right) / 2
    turned = np.concatenate([[0.0], np.cumsum((bend[1:] + bend[:-1]) / 2 * np.diff(depth))])
    found = []
    for last, length in enumerate(depth):
        middle = np.interp(length / 2, depth, turned)
        heading = np.where(depth[: last + 1] <= length / 2, turned[: last + 1], 2 * middle - turned[: last + 1])
        found.append(float(np.trapezoid(np.cos(heading), depth[: last + 1])))
    return np.array(found)
