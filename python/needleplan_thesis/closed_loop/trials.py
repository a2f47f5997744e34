"""Recordings in a lab that hides something: those that a diagnosis needs, and the motion that it asks for."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needleplan.signals import Record, Role
from needleplan.simulation import Experiment, Move, Setup, run_experiment

__all__ = ["another", "recordings"]

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
"""Role, roll at the begin, and places with speeds, half a turn between: two speeds and one rotation."""


def recordings(setup: Setup, seed: int) -> list[Record]:
    """Return insertions into the lab at the origin, at two speeds with one rotation, and a noise record."""
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


def another(setup: Setup, moves: Sequence[Move], seed: int) -> Record:
    """Return one more trial for the training, of the moves that were asked for."""
    return _recorded(setup, (*moves, Move(dwell_s=1.0)), seed, Role.TRAIN)


def _recorded(setup: Setup, moves: tuple[Move, ...], seed: int, role: Role) -> Record:
    whole = run_experiment(Experiment(setup, moves, seed)).record(f"{role} {seed}")
    seen = whole.select(np.isfinite(whole["x_mm"]))
    return Record({name: seen[name] for name in _COLUMNS}, seen.trial, role)
