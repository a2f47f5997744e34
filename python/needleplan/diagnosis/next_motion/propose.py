"""Which motion to make next, by what the diagnosis could not say."""

from __future__ import annotations

import numpy as np

from needleplan.diagnosis.check import Lack
from needleplan.diagnosis.diagnosis import Diagnosis
from needleplan.diagnosis.next_motion.explore import exploring
from needleplan.diagnosis.next_motion.proposal import NextMotion
from needleplan.diagnosis.next_motion.reveal import revealing
from needleplan.diagnosis.next_motion.separate import Separation, rivals_of, separating, separations_by
from needleplan.diagnosis.program import LEAST_ROOM_MM, Limits, programs
from needleplan.diagnosis.verdict import Verdict
from needleplan.signals import Motion, Role

__all__ = ["limits_of", "next_motion", "separations"]

_FLOOR_MM = -10.0


def limits_of(found: Diagnosis, *, fastest_mm_s: float = 0.0) -> Limits | None:
    """Return limits within what the recordings have shown to be possible: their depths, and 15 mm/s at least.

    None where they hardly moved, so that there is nothing to move in.
    """
    motions = [case.motion for case in (*found.calibration.training, *found.calibration.held_out)]
    top = min(float(each.depth_mm.min()) for each in motions)
    deepest = max(float(each.depth_mm.max()) for each in motions)
    fastest = max(float(np.abs(each.velocity_mm_s).max()) for each in motions)
    if deepest < max(top, _FLOOR_MM) + LEAST_ROOM_MM + 0.01:
        return None
    return Limits(round(deepest, 2), fastest_mm_s or max(fastest, Limits.fastest_mm_s), round(max(top, _FLOOR_MM), 2))


def next_motion(found: Diagnosis, limits: Limits | None = None) -> NextMotion | None:
    """Return the motion that says most of what a diagnosis could not; None where nothing is open, or hardly moved.

    Between effects that explain the data alike it is the one that tells them apart; of a gap without a name, the one
    that shows most of it along its axis; where nothing was seen that could hide, the one after which the smallest
    effects can be seen. Candidates are `programs` within `limits`, by default those of the recordings. Raises DataError
    for limits that leave no room to move.
    """
    rivals = rivals_of(found)
    axis = found.decision.axis
    hidden = found.verdict is Verdict.UNDERPOWERED
    open_ = len(rivals) >= 2 or hidden or (axis is not None and found.verdict in (Verdict.UNKNOWN, Verdict.INCOMPLETE))
    limits = limits or limits_of(found)
    if not open_ or limits is None:
        return None
    rate_hz = 1 / float(np.median(found.calibration.training[-1].motion.interval_s))
    made = programs(found.given.channel, limits)
    tried = [(program, program.motion(rate_hz)) for program in made]
    role = _role(found)
    if len(rivals) >= 2:
        return separating(found, rivals, tried, role)
    if hidden:
        return revealing(found, tried, role)
    assert axis is not None
    return exploring(found, axis, tried, role)


def separations(found: Diagnosis, motion: Motion) -> tuple[Separation, ...]:
    """Return how far one more trial of a motion would tell the rivals of a diagnosis apart, every pair both ways."""
    return separations_by(found, rivals_of(found), motion)


def _role(found: Diagnosis) -> Role:
    """Return what one more trial is for: where only a trial of another motion lacks, it is the held-out one."""
    lacks = found.checked.lacks
    waits = found.lacks_data and Lack.TRIALS not in lacks
    return Role.HOLDOUT if waits and (Lack.HELD_OUT in lacks or Lack.OTHER_MOTION in lacks) else Role.TRAIN
