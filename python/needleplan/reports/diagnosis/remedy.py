"""What is to be done about what a diagnosis named: by the planner, by the robot, by the registration.

The remedy follows from the model as it is, not from the names of its effects: how the path bends, where it goes in and
how far the tip is behind the base (`needleplan.models.in_plane`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.models import InPlane, Model, Torsion, in_plane
from needleplan.scenario import Scenario, pieces_of, within
from needleplan.signals import Record

__all__ = ["Remedy", "along_mm", "remedy"]

_NOTHING_RAD = 1e-12
_TURNED_RAD = 1e-4
"""No robot turns to a finer angle."""


@dataclass(frozen=True, eq=False)
class Remedy:
    """A scenario as the tissue is, and what the plane of a plan does not hold.

    `torsion` compensates the lag of the tip's roll; `bends` says at which roll the needle bends to a side.
    """

    scenario: Scenario
    bends: InPlane
    torsion: Torsion | None = None

    @property
    def heading_rad(self) -> float:
        """How the path goes in beside the direction that the robot is told, in the plane, to the left."""
        return self.bends.heading_rad

    @property
    def turned_rad(self) -> float:
        """The roll at the entry by which left and right are both turned: the mean of the two."""
        return (self.bends.roll_rad(1, 0.0) + self.bends.roll_rad(-1, 0.0) - math.pi) / 2

    def options(self) -> dict[str, str]:
        """Return what `needleplan insert` is to be told, by option."""
        found = {}
        if self.torsion:
            found["--torsion"] = f"{self.torsion.stiffness_n_mm2:.6g},{self.torsion.torque_per_length_n:.6g}"
        if abs(self.turned_rad) > _TURNED_RAD:
            found["--roll-left-deg"] = f"{math.degrees(self.turned_rad):.2f}"
        return found


def remedy(
    model: Model,
    scenario: Scenario,
    *,
    velocity_mm_s: float = 5.0,
    stiffness_n_mm2: float = 1.5e4,
    shaft_mm: float = 200.0,
    places: tuple[np.ndarray, np.ndarray] | None = None,
) -> Remedy:
    """Return what follows from a model of a tip's path, with its effects, for insertions at a speed.

    `stiffness_n_mm2` and `shaft_mm` are those of the needle: torsional lag is that of a torque per length, for them.
    `places`, as from `along_mm`, say how far along x a tip is at a depth; without it, as far as one that is turned
    halfway. Raises ModelError for other models, ScenarioError where the scenario cannot take the curvature.
    """
    size = scenario.workspace
    deepest = math.ceil(1.1 * math.hypot(size.width_mm, size.height_mm))
    bends = in_plane(model, min(deepest, shaft_mm), velocity_mm_s)
    along = bends.along_mm
    if places is not None:
        depth, there = places
        beyond = np.interp(bends.depth_mm, depth, there) + np.maximum(bends.depth_mm - depth[-1], 0.0)
        along = np.maximum.accumulate(beyond)
    return Remedy(
        scenario.with_curvature(within(pieces_of(along, bends.curvature_per_mm), size.width_mm)),
        bends,
        _torsion(bends, stiffness_n_mm2, shaft_mm),
    )


def along_mm(records: tuple[Record, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return depths and how far along x the tip was there, shape (n,) each, the mean of recordings of tip paths."""
    deepest = min(float(np.nanmax(each["depth_mm"])) for each in records)
    if not deepest > 0:
        raise ModelError(Mistake("depth_mm", f"{deepest:g}", "must reach into the tissue"), "recordings")
    depth = np.arange(0.0, deepest, 0.5)
    rows = []
    for each in records:
        inserted, first = np.unique(np.maximum.accumulate(each["depth_mm"]), return_index=True)
        rows.append(np.interp(depth, inserted, each["x_mm"][first]))
    there = np.mean(rows, axis=0)
    return depth, np.maximum.accumulate(there - there[0])


def _torsion(bends: InPlane, stiffness_n_mm2: float, shaft_mm: float) -> Torsion | None:
    """Return the torque per length whose lag is nearest to that of the model, over the first half of the depth."""
    depth = bends.depth_mm
    shape = depth * (shaft_mm - depth / 2) / stiffness_n_mm2
    near = depth <= depth[-1] / 2
    size = float(shape[near] @ bends.lag_rad[near] / (shape[near] @ shape[near]))
    return Torsion(stiffness_n_mm2, size) if size > _NOTHING_RAD else None
