"""What poses of any tracker have in common."""

from __future__ import annotations

import math
from dataclasses import replace

from needleplan.devices.base import Health, PoseSample, Stamp

__all__ = ["FARTHEST_MM", "continuous", "unseen"]

FARTHEST_MM = 1e5
"""No coil is farther away than this."""

_NAN = math.nan


def unseen(stamp: Stamp, *notes: str) -> PoseSample:
    """Return the sample of a coil of which nothing is known."""
    return PoseSample(stamp, (_NAN,) * 3, (_NAN,) * 4, _NAN, Health.MISSING, notes)


def continuous(sample: PoseSample, last: PoseSample | None) -> PoseSample:
    """Choose of q and -q, which are the same rotation, the one nearer to the last."""
    if last is None or last.health is Health.MISSING:
        return sample
    if math.fsum(map(float.__mul__, sample.quaternion, last.quaternion)) >= 0:
        return sample
    w, x, y, z = (-each for each in sample.quaternion)
    return replace(sample, quaternion=(w, x, y, z))
