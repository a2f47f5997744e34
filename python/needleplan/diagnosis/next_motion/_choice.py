"""Choice of the next motion, depending on the question that the diagnosis left open."""

from __future__ import annotations

import numpy as np

from needleplan.diagnosis._diagnosis import Diagnosis
from needleplan.diagnosis._verdict import Verdict
from needleplan.diagnosis.data import Lack
from needleplan.diagnosis.next_motion._explore import exploring
from needleplan.diagnosis.next_motion._programs import Limits, NextMotion, programs, recorded_limits
from needleplan.diagnosis.next_motion._reveal import revealing
from needleplan.diagnosis.next_motion._separate import Separation, alternatives_of, separating, separations_by
from needleplan.signals import Motion, Role

__all__ = ["limits_of", "next_motion", "separations"]


def limits_of(found: Diagnosis, *, fastest_mm_s: float = 0.0) -> Limits | None:
    """Return limits that span the recorded depths, from -10 mm at the least; None if they leave no room for a motion.

    The largest speed is `fastest_mm_s`. If `fastest_mm_s` is 0, it is the largest recorded speed, but at least 15 mm/s.
    """
    return recorded_limits(found.calibration, fastest_mm_s=fastest_mm_s)


def next_motion(found: Diagnosis, limits: Limits | None = None) -> NextMotion | None:
    """Return the motion to measure next.

    For tied effects, the motion separates them. If effects may be hidden, the motion lowers the detection limits. For
    an unexplained gap, the motion gives most information on the gap along its axis. Candidates are `programs` within
    `limits`, by default those of `limits_of`. Returns None if no question is open, the depth range is too small, or no
    motion helps.
    """
    alternatives = alternatives_of(found)
    axis = found.decision.axis
    hidden = found.verdict is Verdict.UNDERPOWERED
    open_ = (
        len(alternatives) >= 2
        or hidden
        or (axis is not None and found.verdict in (Verdict.UNKNOWN, Verdict.INCOMPLETE))
    )
    limits = limits or limits_of(found)
    if not open_ or limits is None:
        return None
    rate_hz = 1 / float(np.median(found.calibration.training[-1].motion.interval_s))
    made = programs(found.given.channel, limits)
    tried = [(program, program.motion(rate_hz)) for program in made]
    role = _role(found)
    if len(alternatives) >= 2:
        return separating(found, alternatives, tried, role)
    if hidden:
        return revealing(found, tried, role)
    assert axis is not None
    return exploring(found, axis, tried, role)


def separations(found: Diagnosis, motion: Motion) -> tuple[Separation, ...]:
    """Return how well one more trial of a motion would separate the possible effects, for each ordered pair."""
    return separations_by(found, alternatives_of(found), motion)


def _role(found: Diagnosis) -> Role:
    """Return the role of the next trial: holdout if a name waits for a held-out trial but not for a training trial."""
    lacks = found.checked.lacks
    waits = found.lacks_data and Lack.TRIALS not in lacks
    return Role.HOLDOUT if waits and (Lack.HELD_OUT in lacks or Lack.OTHER_MOTION in lacks) else Role.TRAIN
