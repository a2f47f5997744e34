"""Lab twins with a hidden effect, and the recordings that a diagnosis gets from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from needleplan.errors import InputError, Mistake
from needleplan.scenario import CurvaturePiece, Scenario
from needleplan.signals import Record, Role
from needleplan.simulation import Effects, Move, Robot, Setup, Shaft, SimulatedEntry, Simulation, run_simulation

__all__ = [
    "HIDDEN", "NOTHING", "SHAFT", "HiddenEffect", "hidden_named", "laboratory", "next_record", "recorded_moves",
    "recordings",
]  # fmt: skip

# Random walk of the heading (rad per root mm), and noise of the tracker (mm).
_HEADING_NOISE = 5e-4
_TRACKER_MM = 0.1

# Rate of the servo (Hz), below the twin's default because the servo samples dominate the computing time.
_SERVO_HZ = 400

# Shaft of the needle in all labs of the study.
SHAFT = Shaft(torsional_stiffness_n_mm2=1.5e4)


@dataclass(frozen=True)
class HiddenEffect:
    """An effect that the plan does not contain. `hide(setup)` returns the setup of a lab with this effect."""

    name: str
    title: str
    truth: str
    """The true parameters as text, in the terms of the diagnosis if its library contains the effect."""

    hide: Callable[[Setup], Setup]


def laboratory(scenario: Scenario, entry: SimulatedEntry | None = None) -> Setup:
    """Return the setup of a lab in which the needle bends as planned.

    The tracker has noise of 0.1 mm, and the heading a small random walk.
    """
    return Setup(
        plan_curvature_per_mm=1 / scenario.needle.curvature_radius_mm, scenario=scenario,
        entry=entry or SimulatedEntry(),
        effects=Effects(heading_noise_rad_sqrt_mm=_HEADING_NOISE, tracker_noise_mm=_TRACKER_MM), shaft=SHAFT,
        robot=Robot(servo_hz=_SERVO_HZ),
    )  # fmt: skip


def _layers(pieces: Sequence[tuple[float, float]]) -> Callable[[Setup], Setup]:
    """Return a `hide` that changes the curvature along the path.

    `pieces` are pairs: x at which the piece starts (mm), and the ratio of true to planned curvature.
    """

    def hide(setup: Setup) -> Setup:
        assert isinstance(setup.scenario, Scenario)
        bend = setup.plan_curvature_per_mm
        changed = setup.scenario.with_curvature([CurvaturePiece(begin, share * bend) for begin, share in pieces])
        return replace(setup, scenario=changed)

    return hide


def _effect(**amplitudes: Any) -> Callable[[Setup], Setup]:
    return lambda setup: replace(setup, effects=replace(setup.effects, **amplitudes))


def _tilted(setup: Setup) -> Setup:
    return replace(setup, entry=replace(setup.entry, heading_rad=setup.entry.heading_rad + 0.04))


# Pieces of the hidden effect `guiding_skin`: x (mm), and true / planned curvature.
_SKIN = [(float(x), 0.4 + 0.6 * x / 20) for x in np.arange(0.0, 20.0, 2.0)] + [(20.0, 1.0)]

NOTHING = HiddenEffect("nothing", "no hidden effect", "", lambda setup: setup)
HIDDEN: tuple[HiddenEffect, ...] = (
    HiddenEffect(
        "soft_layer", "from 25 mm on the curvature is 25 % smaller", "amplitude -0.25 from 26 mm of path on",
        _layers([(0.0, 1.0), (25.0, 0.75)]),
    ),
    HiddenEffect(
        "stiff_layer", "from 35 mm on the curvature is 35 % larger", "amplitude 0.35 from 36 mm of path on",
        _layers([(0.0, 1.0), (35.0, 1.35)]),
    ),
    HiddenEffect(
        "guiding_skin", "the curvature is 60 % smaller at the entry, and as planned from 20 mm on",
        "amplitude -0.6 at the entry, falling linearly to 0 over 20 mm", _layers(_SKIN),
    ),
    HiddenEffect(
        "speed", "the curvature falls with the fourth root of the speed", "amplitude -0.16 from 5 to 10 mm/s",
        _effect(curvature_speed_power=-0.25),
    ),
    HiddenEffect(
        "torsion", "friction twists the shaft: at 60 mm the tip lags the base by 12 degrees",
        "lag of 0.0040 rad/mm at first, 0.0033 at 70 mm", _effect(torsional_friction_n=0.3),
    ),
    HiddenEffect(
        "bent_needle", "the needle is bent at a right angle to its bevel, by a fifth of its steering curvature",
        "amplitude 0.002 1/mm at a right angle to the bevel", _effect(pre_bend_per_mm=0.002),
    ),
    HiddenEffect(
        "sagging_needle", "the weight of the needle bends the path downwards",
        "amplitude 0.0015 1/mm, downwards, fading over 160 mm", _effect(sag_per_mm=0.0015, sag_fading_mm=160.0),
    ),
    HiddenEffect(
        "misaligned_base", "the needle enters 2.3 degrees beside the planned direction",
        "amplitude 0.04 rad, in the plane to the left", _tilted,
    ),
)  # fmt: skip
"""Amplitudes are relative to a plan with a radius of 100 mm."""


def hidden_named(name: str) -> HiddenEffect:
    """Return a hidden effect by its name. Raises InputError if the name is unknown."""
    for each in (NOTHING, *HIDDEN):
        if each.name == name:
            return each
    raise InputError(Mistake("hidden effect", name, f"must be one of {', '.join(each.name for each in HIDDEN)}"))


# Duration of the noise record (s), and speed of rotations (rad/s).
_NOISE_S = 20.0
_TURN_RAD_S = 3.0
_COLUMNS = ("time_s", "depth_mm", "angle_rad", "x_mm", "y_mm", "z_mm")

_PROGRAMS: tuple[tuple[Role, float, tuple[tuple[float, float], ...]], ...] = (
    (Role.TRAIN, 0.0, ((35, 4), (70, 10))),
    (Role.TRAIN, math.pi, ((25, 10), (70, 4))),
    (Role.TRAIN, 0.0, ((45, 10), (70, 4))),
    (Role.HOLDOUT, 0.0, ((52, 8), (70, 3))),
    (Role.HOLDOUT, math.pi, ((30, 6), (70, 8))),
)
"""Role, first roll (rad), and legs of insertion: depth (mm) and speed (mm/s), with half a turn between the legs."""


def recorded_moves() -> list[tuple[float, tuple[Move, ...]]]:
    """Return the first roll and the moves of each insertion of `recordings`."""
    found = []
    for _, roll, legs in _PROGRAMS:
        moves: list[Move] = []
        for index, (depth, speed) in enumerate(legs):
            moves.append(Move(insert_to_mm=float(depth), velocity_mm_s=float(speed)))
            if index + 1 < len(legs):
                moves.append(Move(dwell_s=0.3))
                moves.append(Move(rotate_to_rad=math.pi - roll, velocity_rad_s=_TURN_RAD_S))
        found.append((roll, tuple(moves)))
    return found


def recordings(setup: Setup, seed: int) -> list[Record]:
    """Return six records: five insertions from the entry of `setup`, and a noise record.

    Each insertion has two speeds and one rotation in between. Three have the role train, two the role holdout.
    """
    found = [
        next_record(setup, roll, moves, seed + number, role)
        for number, ((role, _, _), (roll, moves)) in enumerate(zip(_PROGRAMS, recorded_moves(), strict=True))
    ]
    found.append(_recorded(setup, (Move(dwell_s=_NOISE_S),), seed + len(_PROGRAMS), Role.NOISE))
    return found


def next_record(setup: Setup, roll: float, moves: Sequence[Move], seed: int, role: Role = Role.TRAIN) -> Record:
    """Simulate moves that begin at a roll (rad), with a pause at the end, and return the record."""
    entry = replace(setup.entry, roll_rad=roll)
    return _recorded(replace(setup, entry=entry), (*moves, Move(dwell_s=1.0)), seed, role)


def _recorded(setup: Setup, moves: tuple[Move, ...], seed: int, role: Role) -> Record:
    whole = run_simulation(Simulation(setup, moves, seed)).record(f"{role} {seed}")
    seen = whole.select(np.isfinite(whole["x_mm"]))
    return Record({name: seen[name] for name in _COLUMNS}, seen.trial, role, frame=seen.frame)
