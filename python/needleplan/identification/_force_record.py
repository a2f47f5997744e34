"""Features of recorded axial forces: drops at punctures, retractions, and initial parameters of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.models.force import ForceModel1
from needleplan.signals import Record

__all__ = ["Drop", "force_drops", "has_retraction", "starting_force"]

# Initial value of beta, which is not fitted: it fixes the scale of the state z.
_BETA = 0.02

# Initial value of sigma0 / g, 1/(mm s); the thesis identified 0.04 to 0.14, and g is smaller near the surface.
_RATE = 0.15

# Lower bound (N/mm) of the initial sigma2, which must be positive.
_LEAST = 1e-6


@dataclass(frozen=True)
class Drop:
    """A drop of the axial force during insertion, from a peak to the following minimum."""

    peak_mm: float
    valley_mm: float
    peak_n: float
    valley_n: float

    @property
    def drop_n(self) -> float:
        """Amplitude of the drop (N)."""
        return self.peak_n - self.valley_n


def force_drops(record: Record, *, least_n: float, within_mm: float = 5.0) -> tuple[Drop, ...]:
    """Return the drops of the axial force during insertion, in the order of depth.

    A drop begins at a peak with a prominence of at least `least_n`. It ends at the smallest force before the next such
    peak, at most `within_mm` deeper than the peak. Samples are ignored if the needle is not deeper than in all samples
    before, or if depth or force is not finite.

    Parameters
    ----------
    record
        Record with depth_mm and force_n.
    least_n
        Smallest amplitude (N) of a drop. Use several standard deviations of the sensor noise.
    within_mm
        Largest increase of the depth (mm) from the peak to the end of the drop.

    Returns
    -------
    tuple of Drop

    Raises
    ------
    DataError
        `least_n` or `within_mm` is not above 0, or the record lacks depth_mm or force_n.
    """
    from scipy.signal import find_peaks

    if not (least_n > 0 and within_mm > 0):
        raise DataError(Mistake("least_n, within_mm", f"{least_n:g}, {within_mm:g}", "must be above 0"))
    depth, force = record["depth_mm"], record["force_n"]
    known = np.isfinite(depth) & np.isfinite(force)
    depth, force = depth[known], force[known]
    deepest = np.maximum.accumulate(depth)
    fresh = np.concatenate([[True], deepest[1:] > deepest[:-1]]) if depth.size else np.zeros(0, bool)
    depth, force = depth[fresh], force[fresh]
    peaks = find_peaks(force, prominence=least_n)[0]
    drops = []
    for number, peak in enumerate(peaks):
        end = peaks[number + 1] if number + 1 < len(peaks) else force.size
        behind = np.arange(peak, end)
        behind = behind[depth[behind] <= depth[peak] + within_mm]
        valley = int(behind[np.argmin(force[behind])])
        if force[peak] - force[valley] >= least_n:
            drops.append(Drop(float(depth[peak]), float(depth[valley]), float(force[peak]), float(force[valley])))
    return tuple(drops)


def has_retraction(records: Sequence[Record]) -> bool:
    """Return whether one of the records contains a retraction.

    A retraction counts if the depth decreases, in total, by more than a tenth of its total increase.
    """
    for record in records:
        motion = record.motion()
        change = np.diff(motion.depth_mm)
        if -change[change < 0].sum() > 0.1 * change[change > 0].sum():
            return True
    return False


def starting_force(records: Sequence[Record]) -> ForceModel1:
    """Return initial parameters of Model I, from closed forms of the force f over the depth l.

    At large depth, f / l is beta g + sigma2 during insertion and beta g - sigma2 during retraction; near the surface,
    f / l is sigma1 beta + sigma2. Without a retraction, f / l during retraction is assumed to be 0. If no sample has a
    force and a depth above 0, fixed values are returned. Raises DataError if a record lacks force or motion.
    """
    ratio, depth, inward = [], [], []
    for record in records:
        motion, force = record.motion(), record["force_n"]
        good = np.isfinite(force) & (motion.depth_mm > 0)
        ratio.append(force[good] / motion.depth_mm[good])
        depth.append(motion.depth_mm[good])
        inward.append(motion.direction[good] >= 0)
    slope, at, into = np.concatenate(ratio), np.concatenate(depth), np.concatenate(inward)
    if not slope.size:
        return ForceModel1(_BETA, 1.0, _BETA, _BETA, 0.0, 0.04)
    reach = float(at.max())
    deep, shallow = at > 0.6 * reach, (at < 0.08 * reach) & (at > 0.01 * reach)
    going_in = float(np.median(slope[deep & into])) if (deep & into).any() else float(np.median(slope))
    going_out = float(np.median(slope[deep & ~into])) if (deep & ~into).any() else 0.0
    sigma2 = max((going_in - going_out) / 2, _LEAST)
    f1 = max((going_in + going_out) / 2, 0.1 * sigma2) / _BETA
    first = float(np.median(slope[shallow & into])) if (shallow & into).any() else going_in
    return ForceModel1(
        sigma0=_RATE * f1, sigma1=max(first - sigma2, 0.1 * sigma2) / _BETA, sigma2=sigma2,
        f1=f1, f2=-0.3 * f1, alpha=3.0 / reach, beta=_BETA,
    )  # fmt: skip
