"""Where the axial force drops: membranes and capsules that give way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals import Record

__all__ = ["Drop", "force_drops"]


@dataclass(frozen=True)
class Drop:
    """A drop of the axial force during insertion, from a peak to the valley behind it."""

    peak_mm: float
    valley_mm: float
    peak_n: float
    valley_n: float

    @property
    def drop_n(self) -> float:
        """How much the force drops by."""
        return self.peak_n - self.valley_n


def force_drops(record: Record, *, least_n: float, within_mm: float = 5.0) -> tuple[Drop, ...]:
    """Return the drops of at least `least_n` within `within_mm` of depth during insertion, in the order of depth.

    Columns: depth_mm and force_n. A drop goes from a peak whose prominence is `least_n` or more to the least force
    before the next such peak. Take several standard deviations of the sensor's noise for `least_n`: below it, noise is
    what is found. Samples while the needle does not go deeper than before do not count. Raises DataError for
    thresholds that are not above 0.
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
    found = []
    for number, peak in enumerate(peaks):
        end = peaks[number + 1] if number + 1 < len(peaks) else force.size
        behind = np.arange(peak, end)
        behind = behind[depth[behind] <= depth[peak] + within_mm]
        valley = int(behind[np.argmin(force[behind])])
        if force[peak] - force[valley] >= least_n:
            found.append(Drop(float(depth[peak]), float(depth[valley]), float(force[peak]), float(force[valley])))
    return tuple(found)
