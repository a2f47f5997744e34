"""Faults of a recorded force, torque or curvature: spikes, a saturated sensor, a reading that stands still.

- **Spike**: samples that leave the median of their surroundings by more than `_SPIKE` robust standard deviations of
  this distance, for at most `_SPIKE_SAMPLES` samples. A puncture lasts: the force stays lower.
- **Saturation**: the largest or smallest value is repeated exactly, at least `_REPEATED` times in succession, and
  nothing lies beyond. A sensor with noise does not repeat a value; a sensor with coarse steps repeats other values as
  well, up to half as often.
- **Standstill**: a value is repeated exactly at least `_STILL` times in succession, and `_STILL_RATIO` times as often
  as usual in the record. A sensor whose steps are not much finer than its noise repeats values for a long time too, but
  its reading goes on in single steps: there, the reading must also jump at an end of the repetition while the needle
  moves, or at both ends.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from needleplan.signals._record import FIBRE_COLUMNS, Array, Record

__all__ = ["fault_notes", "saturated_samples", "spike_samples", "still_parts"]

# Distance from the local median, in robust standard deviations, above which a sample is a spike.
_SPIKE = 12.0
# Largest number of samples of one spike. The window of the median is twice as long plus one.
_SPIKE_SAMPLES = 5
# Smallest distance of a spike from the local median, as a share of the range of the force.
_SPIKE_SHARE = 0.2
# Number of equal extreme samples in succession from which the sensor counts as saturated.
_REPEATED = 8
# Number of equal samples in succession from which the sensor may stand still, and their ratio to the usual number.
_STILL, _STILL_RATIO = 20, 10
# Jump at the end of a standstill, in robust standard deviations of a step from sample to sample, and in smallest steps.
_JUMP, _JUMP_STEPS = 12.0, 3.0
# Usual change from sample to sample, in smallest steps, above which noise does not repeat a value.
_FINE_STEPS = 10.0
# Ratio of usual second to first differences above which they are noise; those of a smooth output are far smaller.
_NOISY = 0.5
# Travel (mm) from which the needle counts as moving during a standstill of the sensor.
_MOVES_MM = 0.5
# Noise, as a share of the range, up to which the data count as computed.
_EXACT = 1e-6
# Standard deviation per median absolute deviation of normal noise.
_MAD = 1.4826

_Mask = NDArray[np.bool_]


def spike_samples(values: Array) -> _Mask:
    """Return a mask of the samples that are spikes, shape (samples,)."""
    from scipy.ndimage import median_filter

    spikes = np.zeros(values.size, bool)
    finite = np.flatnonzero(np.isfinite(values))
    if finite.size < 10 * _SPIKE_SAMPLES:
        return spikes
    good = values[finite]
    away = np.abs(good - median_filter(good, 2 * _SPIKE_SAMPLES + 1, mode="nearest"))
    free = ~saturated_samples(good)
    spread = _MAD * float(np.median(away[free]))
    # The range without the outermost half percent: a spike must not raise its own threshold.
    extent = float(np.subtract(*np.percentile(good, (99.5, 0.5))))
    spikes[finite] = free & (away > max(_SPIKE * spread, _SPIKE_SHARE * extent))
    return spikes


def saturated_samples(values: Array) -> _Mask:
    """Return a mask of the samples at a limit of the sensor, shape (samples,).

    The largest or smallest value is a limit if its longest run of equal samples has at least `_REPEATED` samples, and
    at least twice as many as the longest run of any other value. Short, constant and computed signals have no limits.
    """
    saturated = np.zeros(values.size, bool)
    good = values[np.isfinite(values)]
    if good.size < 10 * _REPEATED or not np.ptp(good):
        return saturated
    extremes = (float(good.max()), float(good.min()))
    if _computed(good[~np.isin(good, extremes)]):
        return saturated
    inner = values.copy()
    inner[np.isin(values, extremes)] = np.nan
    longest_inner_run = 1 + _longest(np.concatenate([[False], np.diff(inner) == 0]))
    for extreme in extremes:
        if _longest(values == extreme) >= max(_REPEATED, 2 * longest_inner_run):
            saturated |= values == extreme
    return saturated


def still_parts(values: Array, depth_mm: Array | None = None) -> list[tuple[int, int]]:
    """Return the parts of a signal in which the sensor repeats one value although it should not.

    Saturated samples do not count. A signal with fewer than 100 finite samples, or one that looks computed, has no
    parts.

    Parameters
    ----------
    values : numpy.ndarray
        Readings, shape (samples,), in any unit.
    depth_mm : numpy.ndarray, optional
        Depth of the needle (mm), shape (samples,). Without it, the needle is assumed to be at rest.

    Returns
    -------
    list of (int, int)
        First index, and last index + 1, of each part.
    """
    good = values[np.isfinite(values)]
    if good.size < 10 * _STILL or _computed(good):
        return []
    edges = np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1, [values.size]])
    lengths = np.diff(edges)
    ordered = np.sort(lengths)
    usual = ordered[int(np.searchsorted(np.cumsum(ordered), values.size / 2))]  # half of the samples are in longer ones
    steps = np.abs(np.diff(good))
    middle, finest = float(np.median(steps[steps > 0])), float(steps[steps > 0].min())
    noisy = float(np.median(np.abs(np.diff(good, 2)))) > _NOISY * float(np.median(steps)) > 0
    fine, jump = noisy and middle > _FINE_STEPS * finest, max(_JUMP * _MAD * middle, _JUMP_STEPS * finest)
    parts, limited = [], saturated_samples(values)
    for index in np.flatnonzero(lengths >= max(_STILL, _STILL_RATIO * usual)):
        first, last = int(edges[index]), int(edges[index + 1])
        ends = [abs(values[a] - values[b]) > jump for a, b in ((first - 1, first), (last - 1, last))
                if a >= 0 and b < values.size]  # fmt: skip
        moves = depth_mm is not None and np.ptp(depth_mm[first:last]) > _MOVES_MM
        if limited[first]:
            continue
        if fine or sum(ends) == 2 or (moves and any(ends)):
            parts.append((first, last))
    return parts


def fault_notes(record: Record) -> list[str]:
    """Return a note for each kind of fault of the force, torque and curvatures of a record; nothing is changed."""
    notes = []
    for name, unit in (("force_n", "N"), ("torque_n_mm", "N mm"), *((each, "1/mm") for each in FIBRE_COLUMNS)):
        if name not in record.columns:
            continue
        values, time = record[name].copy(), record["time_s"]
        parts = still_parts(values, record.columns.get("depth_mm"))
        if parts:
            first, last = max(parts, key=lambda each: each[1] - each[0])
            notes.append(
                f"{name} stands still at {values[first]:.4g} {unit} for {time[last - 1] - time[first]:.3g} s from "
                f"{time[first]:.4g} s on{f', and in {len(parts) - 1} more parts' if len(parts) > 1 else ''}: did the "
                "sensor drop out?"
            )
        for first, last in parts:
            values[first:last] = np.nan
        limited = saturated_samples(values)
        if limited.any():
            ends = " and ".join(f"{each:.4g} {unit}" for each in np.unique(values[limited]))
            notes.append(f"{name} is saturated at {ends}: {int(limited.sum())} samples have exactly this value")
        spikes = spike_samples(values)
        if spikes.any():
            most = float(np.max(np.abs(values[spikes])))
            notes.append(
                f"{name} has {int(spikes.sum())} samples that are spikes of up to {most:.3g} {unit}, the first at "
                f"{time[spikes][0]:.4g} s"
            )
    return notes


def _computed(good: Array) -> bool:
    """Return whether finite values are constant or have no noise: computed data repeat values, too."""
    if good.size < 10 or not np.ptp(good):
        return True
    return float(np.median(np.abs(np.diff(good, 2)))) <= _EXACT * float(np.ptp(good))


def _longest(mask: _Mask) -> int:
    """Return the largest number of True in succession."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return int((edges[1::2] - edges[::2]).max(initial=0))
