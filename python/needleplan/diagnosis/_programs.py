"""Candidate motions, and simulated trials of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np

from needleplan.diagnosis.calibration import CalibratedTrial, Calibration, calibrate_trial
from needleplan.models import Channel, Model, simulate
from needleplan.signals import LEAST_ROOM_MM, Dwell, Insert, Limits, Motion, Program, Record, Rotate, lagged

__all__ = ["predicted_trial", "programs", "recorded_limits"]

# Least depth (mm) at which a motion may start; negative depths are in the air.
_FLOOR_MM = -10.0
# Largest number of insertions and retractions of a pecking motion.
_MOST_PECKS = 40
# A leg: depth as a share of the deepest, speed as a share of the fastest, and the dwell (s) after it.
_Stop = tuple[float, float, float]


def recorded_limits(calibration: Calibration) -> Limits | None:
    """Return limits that span the recorded depths, from -10 mm at the least; None if they leave no room for a motion.

    The largest speed is the largest recorded speed, but at least 15 mm/s.
    """
    motions = [trial.motion for trial in (*calibration.training, *calibration.held_out)]
    top = min(float(motion.depth_mm.min()) for motion in motions)
    deepest = max(float(motion.depth_mm.max()) for motion in motions)
    fastest = max(float(np.abs(motion.velocity_mm_s).max()) for motion in motions)
    if deepest < max(top, _FLOOR_MM) + LEAST_ROOM_MM + 0.01:
        return None
    return Limits(round(deepest, 2), max(fastest, Limits.fastest_mm_s), round(max(top, _FLOOR_MM), 2))


_Moves = Sequence[Insert | Rotate | Dwell]


def programs(channel: Channel, limits: Limits) -> tuple[Program, ...]:
    """Return the candidate motions for a channel.

    The motions for the tip are insertions, most of them with rotations. The motions for the force insert and retract
    the needle without rotation.

    Parameters
    ----------
    channel
        Measured quantity.
    limits
        Largest depths (mm) and speeds (mm/s, rad/s) of the robot.

    Returns
    -------
    tuple of Program
        Motions with name and description.

    Examples
    --------
    >>> from needleplan.diagnosis import programs
    >>> from needleplan.models import Channel
    >>> from needleplan.signals import Limits
    >>> programs(Channel.FORCE, Limits(60.0))[0].name
    'constant_slow'
    """
    made = _steered(limits) if channel is Channel.TIP else _axial(limits)
    return tuple(Program(name, about, tuple(moves), limits) for name, about, moves in made)


def _axial(limits: Limits) -> Sequence[tuple[str, str, _Moves]]:
    legs = partial(_legs, limits)
    return (
        ("constant_slow", "in and out at one low speed", legs((0.5, 0.2, 0.5), (0, 0.35, 1))),
        ("constant_fast", "in and out at one high speed", legs((1, 0.7, 0.5), (0, 0.7, 1))),
        ("speeds", "in and out at several speeds",
         legs((0.2, 0.17, 0), (0.5, 0.7, 0), (0.7, 0.25, 0), (0.97, 0.85, 0), (0.65, 0.4, 0), (0.3, 0.8, 0),
              (0, 0.33, 1))),
        ("holds", "dwells at several depths, and one in the air at the end",
         legs((0.2, 0.35, 3), (0.5, 0.55, 3), (0.85, 0.55, 4), (0, 0.7, 5))),
        ("reversals", "an insertion with long retractions",
         legs((0.28, 0.55, 0), (0.1, 0.4, 0), (0.57, 0.55, 0), (0.35, 0.55, 0), (0.93, 0.7, 0), (0.6, 0.55, 0),
              (0, 0.8, 1))),
        ("pecking", "an insertion with many short retractions",
         [*_pecks(limits, 5.0, 2.0, 0.35, 0.4), *legs((0.8, 0.6, 1), (0, 0.6, 1))]),
        ("dither", "an insertion with many very short retractions",
         [*_pecks(limits, 1.6, 0.8, 0.35, 0.3), *legs((0.7, 0.55, 1), (0, 0.6, 1))]),
        ("twice", "two insertions along the same path", legs((0.6, 0.5, 0), (0, 0.8, 1), (0.9, 0.5, 0.5), (0, 0.8, 1))),
        ("patient", "half a minute of rest in the air before and after the insertion, to show slow changes",
         [Dwell(30), *legs((0.9, 0.55, 1), (0, 0.7, 30))]),
        ("rich", "several speeds, dwells and retractions",
         legs((0.28, 0.55, 2), (0.2, 0.33, 0), (0.63, 0.27, 1.5), (0.85, 0.65, 0), (0.7, 0.33, 0), (0.95, 0.4, 1),
              (0, 0.9, 1))),
        ("rich_back", "several speeds, dwells and a long retraction",
         legs((0.4, 0.8, 1), (0.25, 0.4, 0), (0.75, 0.4, 2), (0.1, 0.9, 0), (0.57, 0.8, 1), (0.92, 0.5, 0),
              (0, 0.9, 1))),
    )  # fmt: skip


def _steered(limits: Limits) -> Sequence[tuple[str, str, _Moves]]:
    legs = partial(_legs, limits)
    back, quarter, half = (Rotate(angle, limits.velocity_rad_s) for angle in (0.0, math.pi / 2, math.pi))
    return (
        ("slow", "in at one low speed", legs((1, 0.3, 1))),
        ("fast", "in at one high speed", legs((1, 0.8, 1))),
        ("speeds", "in at several speeds", legs((0.3, 0.2, 0), (0.6, 0.8, 0), (0.8, 0.2, 0), (1, 0.8, 1))),
        ("half_turn", "half a turn during the insertion, and another speed after it",
         [*legs((0.4, 0.3, 0)), half, *legs((1, 0.7, 1))]),
        ("turned_first", "half a turn before the entry", [half, *legs((0.5, 0.7, 0), (1, 0.3, 1))]),
        ("turned_and_back", "half a turn before the entry, and back during the insertion, with several speeds",
         [half, *legs((0.25, 0.7, 0), (0.5, 0.25, 1)), back, *legs((0.75, 0.7, 0), (1, 0.3, 1))]),
        ("turned_early", "half a turn just after the entry, to separate effects of the entry from those along the path",
         [*legs((0.06, 0.2, 0)), half, *legs((0.5, 0.7, 0), (1, 0.3, 1))]),
        ("patient", "half a turn during the insertion, and half a minute of rest at the end, to show motion at rest",
         [*legs((0.5, 0.5, 0)), half, *legs((1, 0.5, 30))]),
        ("half_turns", "half a turn and back, with several speeds and a dwell",
         [*legs((0.3, 0.7, 0)), half, *legs((0.65, 0.25, 2)), back, *legs((1, 0.7, 1))]),
        ("quarter_turn", "a quarter turn, then on to half a turn",
         [*legs((0.35, 0.5, 1)), quarter, *legs((0.7, 0.25, 0)), half, *legs((1, 0.7, 1))]),
    )  # fmt: skip


def _legs(limits: Limits, *stops: _Stop) -> list[Insert | Rotate | Dwell]:
    found: list[Insert | Rotate | Dwell] = []
    for part, speed, rest in stops:
        to_mm = limits.shallowest_mm if part == 0 else _at(limits, part)
        found.append(Insert(to_mm, round(speed * limits.fastest_mm_s, 3)))
        if rest:
            found.append(Dwell(rest))
    return found


def _pecks(limits: Limits, in_mm: float, out_mm: float, speed: float, part: float) -> list[Insert | Rotate | Dwell]:
    """Return insertions by `in_mm` and retractions by `out_mm` in turn, up to a share `part` of the largest depth.

    There are at most 40 moves. `speed` is the share of the largest speed.
    """
    depth = max(limits.shallowest_mm, 0.0)
    found: list[Insert | Rotate | Dwell] = []
    velocity = round(speed * limits.fastest_mm_s, 3)
    while depth + in_mm < _at(limits, part) and len(found) < _MOST_PECKS:
        depth += in_mm
        found.append(Insert(round(depth, 3), velocity))
        depth -= out_mm
        found.append(Insert(round(depth, 3), velocity))
    return found


def _at(limits: Limits, part: float) -> float:
    top = max(limits.shallowest_mm, 0.0)
    return round(top + part * (limits.deepest_mm - top), 2)


def predicted_trial(base: Model, calibration: Calibration, motion: Motion) -> CalibratedTrial:
    """Return a trial of a motion that is simulated without noise and calibrated like a recorded trial."""
    lag_s = float(np.mean([trial.lag_s for trial in calibration.training]))
    output = lagged(simulate(base, motion).output.ravel(), motion, lag_s)
    columns = dict(zip(base.channel.columns, np.split(output, len(base.channel.columns)), strict=True))
    record = Record(
        {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s,
         "angle_rad": motion.angle_rad, **columns}, "next",
    )  # fmt: skip
    return calibrate_trial(base, record, calibration.noise, calibration.free, start_lag_s=lag_s, about=base)
