"""The corrected plan: a scenario for the planner and options for the robot, computed from a diagnosed model."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from needleplan.artifacts import CallRepr, write_whole
from needleplan.diagnosis import Diagnosis, Verdict
from needleplan.errors import InputError, Mistake, ModelError
from needleplan.models import Channel, InPlane, Model, Torsion, in_plane
from needleplan.scenario import Identified, Scenario, identified, pieces_of, within
from needleplan.signals import Record, Role

__all__ = [
    "CorrectedPlan",
    "RobotCorrection",
    "along_mm",
    "corrected_plan",
    "corrected_plan_lines",
    "identified_path",
    "require_path",
    "said_of",
    "torsion_of",
    "write_scenario",
]

# Torque per length (N) below which the torsional lag of the needle is ignored.
_NOTHING_N = 1e-12
# Torsional stiffness (N mm^2) and length (mm) of the needle if nobody says them: an 18 gauge cannula, as in the lab.
_STIFFNESS_N_MM2, _SHAFT_MM = 1.5e4, 200.0
# Angle (rad) up to which a correction is not reported, because robots do not resolve it.
_TURNED_RAD = 1e-4
# Roll angle (rad) up to which an insertion counts as one without rotation, in the plane.
_UNTURNED_RAD = 0.02


@dataclass(frozen=True, eq=False, kw_only=True)
class RobotCorrection(CallRepr):
    """What the robot needs for a diagnosed needle, in the plane and in 3D.

    `bends` holds, by inserted length, the roll angles at which the needle bends to the left and right. `torsion` is the
    torsion that makes the tip's roll lag behind the base, to be compensated; None if the lag is negligible.
    """

    bends: InPlane
    torsion: Torsion | None = None

    @property
    def turned_rad(self) -> float:
        """Mean deviation (rad) of the roll angles at the entry from their nominal values, 0 (left) and pi (right)."""
        return (self.bends.roll_rad(1, 0.0) + self.bends.roll_rad(-1, 0.0) - math.pi) / 2

    def options(self) -> dict[str, str]:
        """Return the command-line options that `needleplan insert` needs: option name to value, as text.

        `--torsion` is left out if the lag is negligible, `--roll-left-deg` if `turned_rad` is at most 1e-4 rad.
        """
        found = {}
        if self.torsion:
            found["--torsion"] = f"{self.torsion.stiffness_n_mm2:.6g},{self.torsion.torque_per_length_n:.6g}"
        if abs(self.turned_rad) > _TURNED_RAD:
            found["--roll-left-deg"] = f"{math.degrees(self.turned_rad):.3f}"
        return found

    def lines(self) -> Iterator[str]:
        """Yield lines of text for the user."""
        for option, value in self.options().items():
            yield f"  robot: insert {option} {value}"
        left, right = self.bends.roll_rad(1, 0.0), self.bends.roll_rad(-1, 0.0) - math.pi
        # An option of the command rotates both sides; different rotations of the two sides are only reported.
        if max(abs(left - self.turned_rad), abs(right - self.turned_rad)) > _TURNED_RAD:
            yield f"  robot: at the entry, bevel left is a roll of {left:.4f} rad, right {right + math.pi:.4f} rad"


@dataclass(frozen=True, eq=False, kw_only=True)
class CorrectedPlan(RobotCorrection):
    """A scenario for the diagnosed tissue, and the corrections that the robot needs.

    `path` is the path of `identify curvature` from the same records, if the scenario has its curvature; else None.
    """

    scenario: Scenario
    path: Identified | None = None

    @property
    def heading_rad(self) -> float:
        """Initial heading (rad) of the path relative to the commanded direction, in the plane, positive to the left."""
        if self.path is not None:
            return self.path.entry.heading_rad if self.path.entry else 0.0
        return self.bends.heading_rad


def corrected_plan(
    model: Model,
    scenario: Scenario,
    *,
    velocity_mm_s: float = 5.0,
    stiffness_n_mm2: float = _STIFFNESS_N_MM2,
    shaft_mm: float = _SHAFT_MM,
    places: tuple[np.ndarray, np.ndarray] | None = None,
) -> CorrectedPlan:
    """Return the corrected plan for a model of the tip's path with its effects.

    Parameters
    ----------
    model
        Model of the tip's 3D path.
    scenario
        Scenario of the present plan.
    velocity_mm_s
        Speed of the insertions (mm/s).
    stiffness_n_mm2, shaft_mm
        Torsional stiffness (N mm^2) and length (mm) of the needle, which convert a lag of the tip's roll into a torque
        per length.
    places
        Depths and positions along x (mm), as returned by `along_mm`. None: computed for a needle whose bevel is flipped
        halfway.

    Returns
    -------
    CorrectedPlan
        The scenario with the diagnosed curvature, and the options for the robot.

    Raises
    ------
    ModelError
        If the model does not describe the path of the tip in 3D, or its path cannot bend to both sides.
    ScenarioError
        If the scenario does not permit the curvature, for example because of too many layers with different radii.
    """
    size = scenario.workspace
    deepest = math.ceil(1.1 * math.hypot(size.width_mm, size.height_mm))
    bends = in_plane(model, min(deepest, shaft_mm), velocity_mm_s)
    along = bends.along_mm
    if places is not None:
        depth, there = places
        beyond = np.interp(bends.depth_mm, depth, there) + np.maximum(bends.depth_mm - depth[-1], 0.0)
        along = np.maximum.accumulate(beyond)
    return CorrectedPlan(
        scenario=scenario.with_curvature(within(pieces_of(along, bends.curvature_per_mm), size.width_mm)),
        bends=bends,
        torsion=torsion_of(bends, stiffness_n_mm2, shaft_mm),
    )


def along_mm(records: tuple[Record, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return depths (mm) and, for each depth, the mean distance (mm) that the tip has advanced along x since depth 0.

    The mean is over the recordings. The depths end where the shallowest recording ends. Both arrays have shape (n,).
    Raises ModelError if a recording does not reach into the tissue.
    """
    deepest = min(float(np.nanmax(record["depth_mm"])) for record in records)
    if not deepest > 0:
        raise ModelError(Mistake("depth_mm", f"{deepest:g}", "must reach into the tissue"), "recordings")
    depth = np.arange(0.0, deepest, 0.5)
    rows = []
    for record in records:
        inserted, first = np.unique(np.maximum.accumulate(record["depth_mm"]), return_index=True)
        rows.append(np.interp(depth, inserted, record["x_mm"][first]))
    there = np.mean(rows, axis=0)
    return depth, np.maximum.accumulate(there - there[0])


def torsion_of(
    bends: InPlane, stiffness_n_mm2: float = _STIFFNESS_N_MM2, shaft_mm: float = _SHAFT_MM
) -> Torsion | None:
    """Return the torsion whose lag fits the lag of the model in the shallower half of the depths.

    Returns None if the fitted torque per length is negative or negligible.
    """
    depth = bends.depth_mm
    shape = depth * (shaft_mm - depth / 2) / stiffness_n_mm2
    near = depth <= depth[-1] / 2
    size = float(shape[near] @ bends.lag_rad[near] / (shape[near] @ shape[near]))
    return Torsion(stiffness_n_mm2, size) if size > _NOTHING_N else None


def identified_path(records: Sequence[Record]) -> Identified | None:
    """Return the path that `identify curvature` finds in the records.

    None if a needle was rotated or bends out of the plane, or if the records do not determine a path that bends.
    """
    from needleplan.identification import curvature  # imports half a second of scipy

    for record in records:
        rolls = record.columns.get("angle_rad", np.zeros(1))
        if np.nanmax(np.abs(np.sin(rolls))) > _UNTURNED_RAD or np.ptp(np.sign(np.cos(rolls))):
            return None
    try:
        file = curvature.identify(records, segments=1).model_file(records)
        return identified(file) if file else None
    except InputError:
        return None


def require_path(channel: Channel) -> None:
    """Raise ModelError if the channel is not the position of the tip."""
    if channel is not Channel.TIP:
        rule = "needs a model of the tip's 3D path (spatial_bicycle or spatial_beam)"
        raise ModelError(Mistake("--scenario", "", rule))


def write_scenario(
    found: Diagnosis, scenario: Scenario, folder: str, velocity_mm_s: float
) -> tuple[str, CorrectedPlan]:
    """Write `scenario.toml` into a folder, and return the path of the file and the corrected plan.

    The corrected plan is computed from `Diagnosis.model`: the base model with the named effects, or a base model if no
    effect is named, calibrated unless the given one predicts the held-out trials better. Without a named effect,
    curvature and entry pose are those that `identify curvature` finds in the same records, if these are insertions
    without rotation (`identified_path`). The first line of the file states where the curvature comes from.
    Raises ModelError and ScenarioError as `corrected_plan` and `along_mm`, and OutputError if the file cannot be
    written.
    """
    require_path(found.given.channel)
    training = tuple(recording for recording in found.recordings if recording.role is Role.TRAIN)  # not averaged
    what = corrected_plan(found.model, scenario, velocity_mm_s=velocity_mm_s, places=along_mm(training))
    path = None if found.verdict is Verdict.NAMED else identified_path(training)
    if path is not None:
        needle = scenario.with_curvature(within(path.pieces, scenario.workspace.width_mm) or path.curvature_per_mm)
        what = replace(what, scenario=needle, path=path)
    place = Path(folder) / "scenario.toml"
    first = f"# {said_of(found, is_path=path is not None)} Diagnosis {found.digest}."
    write_whole(place, f"{first}\n{what.scenario.to_toml()}".encode())
    return str(place), what


def said_of(found: Diagnosis, *, is_path: bool = False) -> str:
    """Return a sentence for the file and for the user: where the curvature of the plan comes from.

    `is_path`: it is that of `identified_path`.
    """
    if found.verdict is Verdict.NAMED:
        return f"Curvature with the named effects: {', '.join(found.names)}."
    kept = not is_path and found.keeps_given
    how = "of the given model, which predicts better than one of" if kept else "calibrated to"
    return f"Curvature {how} these recordings, without effects (verdict: {found.verdict})."


def corrected_plan_lines(found: Diagnosis, what: CorrectedPlan) -> Iterator[str]:
    """Yield lines of text about the scenario and the corrections that the robot needs."""
    yield f"  plan: {said_of(found, is_path=what.path is not None)}"
    layers = len(what.scenario.needle.layers)
    yield f"  plan: radius {what.scenario.needle.curvature_radius_mm:.4g} mm" + f", layers behind it: {layers}" * bool(
        layers
    )
    if abs(what.heading_rad) > _TURNED_RAD:
        yield f"  robot: the path starts {math.degrees(what.heading_rad):+.2f} deg from the commanded heading (+ left)"
    yield from what.lines()
