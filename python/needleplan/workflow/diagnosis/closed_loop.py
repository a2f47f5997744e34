"""To the planner and back: plan, insert, diagnose from recordings, plan again with what was named, insert again.

The lab twin hides something. The plan does not know it, and its insertions miss. Recordings of a few insertions into
the same tissue are diagnosed; what is named goes where it can be used: curvature by depth to the planner, torsion to
the compensation of the roll, a tilted base to the direction that the robot is told. Insertions follow the moves of
their plan without feedback, which would hide what the plan does not know.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needleplan.control.scene import Scene
from needleplan.diagnosis import Diagnosis, Library, diagnose
from needleplan.models import Channel, SpatialBicycle, Torsion, simulate
from needleplan.models.effects import AddedEffect, effects_of
from needleplan.planning import PolicyTable, Pose, plan
from needleplan.scenario import Scenario
from needleplan.signals import Motion, Record, Role
from needleplan.simulation import Entry, Experiment, Move, Plant, Setup, run_experiment
from needleplan.workflow.diagnosis.hidden import Hidden, laboratory
from needleplan.workflow.steering.unguided import carried_out, planned_moves

__all__ = ["Inserted", "Outcome", "Piece", "Recognised", "close_the_loop", "recognised", "recordings"]

_NOISE_S = 20.0
_SERVO_HZ = 400
_TURN_RAD_S = 3.0
_EVERY_MM = 4.0
_USEFUL = ("curvature_layer", "entry_rupture", "torsional_lag", "misalignment")

_PROGRAMS: tuple[tuple[Role, float, tuple[tuple[float, float], ...]], ...] = (
    (Role.TRAIN, 0.0, ((35, 4), (70, 10))),
    (Role.TRAIN, math.pi, ((25, 10), (70, 4))),
    (Role.TRAIN, 0.0, ((45, 10), (70, 4))),
    (Role.HOLDOUT, 0.0, ((52, 8), (70, 3))),
    (Role.HOLDOUT, math.pi, ((30, 6), (70, 8))),
)
"""Role, roll at the begin, and places with speeds, half a turn between: two speeds and one rotation."""


@dataclass(frozen=True)
class Piece:
    """A piece of the path with a curvature of its own, as a scenario takes it."""

    low_mm: float
    curvature_per_mm: float


@dataclass(frozen=True)
class Recognised:
    """What a diagnosis says to those who insert: to the planner, to the compensation of the roll, to the robot."""

    scenario: Scenario
    torsion: Torsion | None
    tilt_rad: float
    """In the plane, of the path against what the robot is told."""


@dataclass(frozen=True)
class Inserted:
    """Insertions by one plan: success promised and realised, and distances from the centre of the target (mm)."""

    predicted: float
    errors_mm: tuple[float, ...]
    successes: int

    @property
    def success(self) -> float:
        """Share that ended in the target."""
        return self.successes / len(self.errors_mm)

    @property
    def gap(self) -> float:
        """Between the success that was planned and the one that was realised."""
        return abs(self.predicted - self.success)

    @property
    def error_mm(self) -> float:
        """Median."""
        return float(np.median(self.errors_mm))


@dataclass(frozen=True)
class Outcome:
    """What came of one hidden effect."""

    hidden: Hidden
    found: Diagnosis
    before: Inserted
    after: Inserted
    known: Inserted
    """By the same plan in a lab that hides nothing: what scatter alone leaves."""


def close_the_loop(hidden: Hidden, scenario: Scenario, seeds: Sequence[int]) -> Outcome:
    """Plan, insert, diagnose, plan again and insert again."""
    bend = 1 / scenario.needle.curvature_radius_mm
    base = SpatialBicycle(curvature_per_mm=bend)
    found = diagnose(base, recordings(hidden.hide(laboratory(bend))), library=Library(effects_of(Channel.TIP), base))
    wrong = Recognised(scenario, None, 0.0)
    right = recognised(found, scenario)
    as_planned = Hidden("nothing", "as planned", lambda setup: setup)
    return Outcome(
        hidden, found, _inserted(hidden, wrong, bend, seeds), _inserted(hidden, right, bend, seeds),
        _inserted(as_planned, wrong, bend, seeds),
    )  # fmt: skip


def recordings(setup: Setup, seed: int = 1000) -> list[Record]:
    """Return insertions into the lab at the origin, at two speeds with one rotation, and a noise record."""
    setup = replace(setup, robot=replace(setup.robot, servo_hz=_SERVO_HZ))
    found = []
    for number, (role, roll, legs) in enumerate(_PROGRAMS):
        entry = replace(setup.entry, roll_rad=roll)
        moves: list[Move] = []
        for index, (place, speed) in enumerate(legs):
            moves.append(Move(insert_to_mm=float(place), velocity_mm_s=float(speed)))
            if index + 1 < len(legs):
                moves.append(Move(dwell_s=0.3))
                moves.append(Move(rotate_to_rad=math.pi - roll, velocity_rad_s=_TURN_RAD_S))
        found.append(_recorded(replace(setup, entry=entry), (*moves, Move(dwell_s=1.0)), seed + number, role))
    found.append(_recorded(setup, (Move(dwell_s=_NOISE_S),), seed + len(_PROGRAMS), Role.NOISE))
    return found


def _recorded(setup: Setup, moves: tuple[Move, ...], seed: int, role: Role) -> Record:
    whole = run_experiment(Experiment(setup, moves, seed)).record(f"{role} {seed}")
    seen = whole.select(np.isfinite(whole["x_mm"]))
    names = ("time_s", "depth_mm", "angle_rad", "x_mm", "y_mm", "z_mm")
    return Record({name: seen[name] for name in names}, seen.trial, role)


def recognised(found: Diagnosis, scenario: Scenario) -> Recognised:
    """Return what is to be done about what was named; without a name the curvature alone is taken from the data.

    Effects of the tracker belong to registration and estimator, and change no plan.
    """
    bend = found.base.values()["curvature_per_mm"]
    effects = [each.added for each in found.effects if each.added.name in _USEFUL]
    bends = [each for each in effects if each.name in ("curvature_layer", "entry_rupture")]
    twist = next((each for each in effects if each.name == "torsional_lag"), None)
    tilted = next((each for each in effects if each.name == "misalignment"), None)
    deepest = max(scenario.workspace.width_mm, scenario.workspace.height_mm)
    places = np.arange(0.0, deepest, _EVERY_MM).tolist()
    places += [each.values["depth_mm"] for each in bends if each.name == "curvature_layer"]
    pieces: list[Piece] = []
    for place in sorted(places):
        curvature = bend * math.prod(_share(each, place + _EVERY_MM / 4) for each in bends)
        if not pieces or abs(curvature / pieces[-1].curvature_per_mm - 1) > 0.01:
            pieces.append(Piece(_along_mm(bend, place), max(curvature, 1e-5)))
    stiffness = laboratory(bend).shaft.torsional_stiffness_n_mm2
    shaft_mm = laboratory(bend).shaft.length_mm
    torsion = None
    if twist is not None:
        middle = max(place for _, _, legs in _PROGRAMS for place, _ in legs) / 2
        torsion = Torsion(stiffness, twist.values["size"] * stiffness / (shaft_mm - middle / 2))
    tilt = tilted.values["size"] * math.cos(tilted.values["direction_rad"]) if tilted else 0.0
    return Recognised(scenario.with_curvature(pieces), torsion, tilt)


def _share(effect: AddedEffect, depth_mm: float) -> float:
    values = effect.values
    if effect.name == "curvature_layer":
        return 1 + values["size"] * (depth_mm >= values["depth_mm"])
    return max(1 + values["size"] * math.exp(-depth_mm / values["length_mm"]), 0.0)


def _along_mm(bend_per_mm: float, depth_mm: float) -> float:
    """Return how far along x a path of that length gets, turned halfway so that it stays near the line."""
    if depth_mm <= 0:
        return 0.0
    depth = np.linspace(0.0, depth_mm, 60)
    motion = Motion.sampled(depth, depth, np.ones(60), np.where(depth > 0.5 * depth_mm, math.pi, 0.0))
    return float(simulate(SpatialBicycle(curvature_per_mm=bend_per_mm), motion).output[0, -1])


def _inserted(hidden: Hidden, known: Recognised, bend: float, seeds: Sequence[int]) -> Inserted:
    table = plan(known.scenario)
    start = table.best_entry().pose
    moves = planned_moves(table, start)
    entry = Entry(start.x_mm, start.y_mm, start.heading_rad - known.tilt_rad)
    setup = hidden.hide(laboratory(bend, entry))
    setup = replace(setup, robot=replace(setup.robot, servo_hz=_SERVO_HZ))
    errors, successes = [], 0
    for seed in seeds:
        path = carried_out(Plant(setup, seed), moves, 10.0, 10.0, known.torsion)
        error, success = _judged(table, path)
        errors.append(error)
        successes += success
    return Inserted(_promised(table, start), tuple(errors), successes)


def _promised(table: PolicyTable, start: Pose) -> float:
    return float(table.lookup(*start).success)


def _judged(table: PolicyTable, path: np.ndarray) -> tuple[float, bool]:
    scene = Scene(table.scenario)
    places = path[:, :2].tolist()
    aside = float(path[-1, 2])
    error = math.hypot(scene.target_distance_mm(*places[-1]), aside)
    clear = not any(scene.touches(*place) or scene.outside(*place) for place in places)
    return error, clear and error <= table.scenario.target.radius_mm
