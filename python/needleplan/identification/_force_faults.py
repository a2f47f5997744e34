"""Faults of a recorded force before a fit: spikes, a saturated sensor, a flipped sign.

- **Spike**: samples that leave the median of their surroundings by more than `_SPIKE` robust standard deviations of
  this distance, for at most `_SPIKE_SAMPLES` samples. They are left out. A puncture lasts: the force stays lower.
- **Saturation**: the largest or smallest force is repeated exactly, at least `_REPEATED` times in succession, and
  nothing lies beyond. A sensor with noise does not repeat a value; a sensor with coarse steps repeats other values as
  well, up to half as often. The samples are left out.
- **Flipped sign**: a force that resists the motion is positive on the way in and smaller on the way out. The sign is
  wrong if the median on the way in is negative and, if there is a way out, the median on the way out is larger. It is
  reported, not corrected, because the zero of the sensor could be wrong as well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from needleplan.signals import Array, Record

__all__ = ["without_faults"]

# Distance from the local median, in robust standard deviations, above which a sample is a spike.
_SPIKE = 12.0
# Largest number of samples of one spike. The window of the median is twice as long plus one.
_SPIKE_SAMPLES = 5
# Smallest distance of a spike from the local median, as a share of the range of the force.
_SPIKE_SHARE = 0.2
# Number of equal extreme samples in succession from which the sensor counts as saturated.
_REPEATED = 8
# Noise, as a share of the range, up to which the data count as computed.
_EXACT = 1e-6
# Standard deviation per median absolute deviation of normal noise.
_MAD = 1.4826


def without_faults(records: Sequence[Record]) -> tuple[tuple[Record, ...], list[str]]:
    """Return the records with spikes and saturated samples set to NaN, and remarks that name every fault."""
    kept, remarks = [], []
    for record in records:
        force = record["force_n"]
        spikes, limited = _spikes(force), _saturated(force)
        prefix = f"{record.trial}: " if record.trial else ""
        if spikes.any():
            at, most = float(record["time_s"][spikes][0]), float(np.max(np.abs(force[spikes])))
            remarks.append(
                f"{prefix}{int(spikes.sum())} samples are spikes of up to {most:.3g} N, the first at {at:.4g} s; they "
                "are left out"
            )
        if limited.any():
            ends = sorted({float(each) for each in force[limited]})
            named = " and ".join(f"{each:.4g} N" for each in ends)
            remarks.append(
                f"{prefix}the sensor is saturated at {named}: {int(limited.sum())} samples have exactly this value; "
                "they are left out, and the true force there is larger"
            )
        bad = spikes | limited
        sound = record.with_column("force_n", np.where(bad, np.nan, force)) if bool(bad.any()) else record
        if _flipped(sound):
            remarks.append(
                f"{prefix}the force is negative on the way in: its sign is flipped, or its zero is wrong; a force that "
                "resists the insertion is positive. Change the sign in the data and identify again"
            )
        kept.append(sound)
    return tuple(kept), remarks


def _spikes(force: Array) -> NDArray[np.bool_]:
    """Return a mask of the samples that are spikes, shape (samples,)."""
    found = np.zeros(force.size, bool)
    good = np.flatnonzero(np.isfinite(force))
    if good.size < 10 * _SPIKE_SAMPLES:
        return found
    values = force[good]
    away = np.abs(values - median_filter(values, 2 * _SPIKE_SAMPLES + 1, mode="nearest"))
    spread = _MAD * float(np.median(away))
    # The range without the outermost half percent: a spike must not raise its own threshold.
    extent = float(np.subtract(*np.percentile(values, (99.5, 0.5))))
    found[good] = away > max(_SPIKE * spread, _SPIKE_SHARE * extent)
    return found


def _saturated(force: Array) -> NDArray[np.bool_]:
    """Return a mask of the samples at a limit of the sensor, shape (samples,)."""
    found = np.zeros(force.size, bool)
    good = force[np.isfinite(force)]
    if good.size < 10 * _REPEATED or not np.ptp(good):
        return found
    noise = float(np.median(np.abs(np.diff(good, 2))))
    if noise <= _EXACT * float(np.ptp(good)):
        return found  # computed data without noise repeat values, too
    ends = (float(good.max()), float(good.min()))
    inner = force.copy()
    inner[np.isin(force, ends)] = np.nan
    usual = 1 + _run(np.concatenate([[False], np.diff(inner) == 0]))
    for value in ends:
        if _run(force == value) >= max(_REPEATED, 2 * usual):
            found |= force == value
    return found


def _run(mask: NDArray[np.bool_]) -> int:
    """Return the largest number of True in succession."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def _flipped(record: Record) -> bool:
    motion, force = record.motion(), record["force_n"]
    deep = motion.depth_mm > 0.25 * float(np.max(motion.depth_mm))
    inward, outward = (force[deep & (motion.direction * side > 0) & np.isfinite(force)] for side in (1, -1))
    if inward.size < 5 or float(np.median(inward)) >= 0:
        return False
    return outward.size < 5 or float(np.median(outward)) > float(np.median(inward))
