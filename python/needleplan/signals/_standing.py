"""Parts of a motion in which the needle stands, and the velocity that follows from a measured depth.

A needle stands in a window of time if the n depths in the window have the range of noise, at most 2 sqrt(2 log n) +
`_RANGE_SDS` standard deviations, and the slope of a regression line through them is below `_SLOPE_SDS` of its standard
deviations. The noise is estimated from second differences of the depth, which remove the motion. A velocity computed by
differences changes its sign with the noise of the depth, and every change of sign reverses the friction of a model. The
velocity of a standing needle is therefore exactly zero, and that of a moving needle is the slope of a regression line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from needleplan.artifacts import ShortRepr
from needleplan.signals._record import Array, Record

__all__ = ["MeasuredMotion", "rest_before_entry"]

# Duration (s) of the window, the shortest dwell that is found. A longer window finds slower motions.
_WINDOW_S = 0.5
# Least number of samples in a window.
_FEWEST = 3
# Standard deviations of the noise by which the range of the depth of a standing needle may exceed its usual value.
_RANGE_SDS = 2.0
# Slope of the depth of a standing needle, in standard deviations of the slope.
_SLOPE_SDS = 3.0
# Standard deviation of the velocity that the regression window aims at, as a share of the median speed in motion.
_VELOCITY_NOISE = 0.05
# Factor by which the velocity of a movement is at most scaled to its change of depth.
_MOST_SCALED = 2.0


@dataclass(frozen=True)
class MeasuredMotion(ShortRepr):
    """A motion whose depth was measured, divided into standing and moving parts. All arrays have the shape (samples,).

    Attributes
    ----------
    depth_mm
        Measured depth; in a standing part, its median over this part.
    velocity_mm_s
        Slope of regression lines through the depth; 0 in a standing part, except for its first and last sample.
    standing
        Whether the needle stands at a sample.
    noise_mm
        Standard deviation of the noise of the depth.
    window_s
        Duration of the regression window of the velocity.
    """

    depth_mm: Array
    velocity_mm_s: Array
    standing: NDArray[np.bool_]
    noise_mm: float
    window_s: float

    @classmethod
    def of(cls, time_s: Array, depth_mm: Array) -> MeasuredMotion:
        """Return the motion in a measured depth: parts at rest, and the velocity of the other parts.

        Parameters
        ----------
        time_s : numpy.ndarray
            Increasing times (s), shape (samples,), at least two.
        depth_mm : numpy.ndarray
            Finite depths (mm), shape (samples,).

        Returns
        -------
        MeasuredMotion
        """
        time, depth = np.asarray(time_s, float) - time_s[0], np.asarray(depth_mm, float)
        step = float(np.median(np.diff(time)))
        noise = _noise(depth)
        still = _standing(time, depth, noise, max(_FEWEST, round(_WINDOW_S / step)))
        speeds = np.abs(np.diff(depth) / np.diff(time))[~(still[1:] & still[:-1])]
        usual = float(np.median(speeds)) if speeds.size else 0.0
        half = _half_window(noise, step, usual)
        held = depth.copy()
        for part, stands in _parts(still):
            if stands:
                held[part] = np.median(depth[part])
        velocity = np.zeros_like(depth)
        for part, stands in _parts(still):
            if not stands:
                velocity += _velocity(time, held, part, half)
        return cls(held, velocity, still, noise, (2 * half + 1) * step)

    def parts(self) -> list[tuple[slice, bool]]:
        """Return the standing and moving parts in their order; the second entry is whether the needle stands."""
        return _parts(self.standing)

    @property
    def steps_mm(self) -> Array:
        """Change of the depth from each standing part to the next, shape (standing parts - 1,)."""
        places = [float(self.depth_mm[part.start]) for part, stands in self.parts() if stands]
        return np.diff(places) if places else np.zeros(0)


def rest_before_entry(records: Sequence[Record], columns: Sequence[str], fewest: int) -> tuple[Record, ...]:
    """Return the parts of records in which the needle is at rest before it has entered the tissue, at depths up to 0.

    Parameters
    ----------
    records : sequence of Record
        Records with the columns `time_s` and `depth_mm`.
    columns : sequence of str
        Columns that must be finite throughout a part.
    fewest : int
        Smallest number of samples of a part.

    Returns
    -------
    tuple of Record
    """
    found = []
    for record in records:
        depth = record["depth_mm"]
        outside = int(np.argmax(depth > 0)) if (depth > 0).any() else depth.size
        if outside >= max(fewest, _FEWEST):
            motion = MeasuredMotion.of(record["time_s"][:outside], depth[:outside])
            found += [record.select(part) for part, stands in motion.parts() if stands]
    return tuple(
        each for each in found if len(each) >= fewest and all(np.isfinite(each[name]).all() for name in columns)
    )


def _parts(still: NDArray[np.bool_]) -> list[tuple[slice, bool]]:
    """Return the longest parts of equal value, each with its value."""
    ends = [0, *(np.flatnonzero(np.diff(still)) + 1).tolist(), still.size]
    return [(slice(a, b), bool(still[a])) for a, b in pairwise(ends)]


def _noise(depth: Array) -> float:
    """Return the standard deviation of the noise of the depth; 0 for too few samples.

    It follows from the lower quartile of the second differences, which half of the samples may exceed by movements.
    """
    if depth.size < _FEWEST:
        return 0.0
    return float(np.quantile(np.abs(np.diff(depth, n=2)), 0.25) / 0.3186 / np.sqrt(6))


def _standing(time: Array, depth: Array, noise: float, window: int) -> NDArray[np.bool_]:
    """Return whether the needle stands at each sample, shape (samples,).

    The needle stands in a window of `window` samples if the range of the depth (mm) and the slope of its regression
    line (mm/s) are within the noise (mm) and the resolution. A movement between two standing windows that share no
    step is not a standstill: both samples of the movement count as moving.
    """
    standing = np.zeros(depth.size, bool)
    if depth.size < window:
        return standing
    depths, times = sliding_window_view(depth, window), sliding_window_view(time, window)
    changes = np.abs(np.diff(depth))
    quantum = float(changes[changes > 0].min(initial=np.inf)) if (changes > 0).any() else 0.0  # resolution of the depth
    widest = (2 * np.sqrt(2 * np.log(window)) + _RANGE_SDS) * noise
    narrow = np.flatnonzero(np.ptp(depths, axis=1) <= max(widest, 1.5 * quantum))
    if not narrow.size:
        return standing
    centred = times[narrow] - times[narrow].mean(axis=1, keepdims=True)
    power = (centred**2).sum(axis=1)
    slope = (centred * depths[narrow]).sum(axis=1) / power
    limit = _SLOPE_SDS * max(noise, quantum / np.sqrt(12)) / np.sqrt(power) + 1e-12
    joined = np.zeros(depth.size - 1, bool)  # whether samples i and i + 1 are in one standing window
    for first in narrow[np.abs(slope) <= limit]:
        standing[first : first + window] = True
        joined[first : first + window - 1] = True
    moved = np.flatnonzero(standing[1:] & standing[:-1] & ~joined)  # a movement between two samples
    standing[moved] = standing[moved + 1] = False
    return standing


def _velocity(time: Array, held: Array, part: slice, half: int) -> Array:
    """Return the velocity of one moving part, shape (samples,): 0 elsewhere, except for one sample beside the part.

    The velocity is scaled to the change of the depth if the needle stands before and after the part.
    """
    found = np.zeros_like(held)
    inner = slice(max(part.start - 1, 0), min(part.stop + 1, held.size))
    wide = slice(max(inner.start - half, 0), min(inner.stop + half, held.size))
    found[inner] = _slopes(time[wide], held[wide], half)[inner.start - wide.start :][: inner.stop - inner.start]
    if inner.stop - inner.start == part.stop - part.start + 2:
        ends = slice(max(inner.start - 1, 0), min(inner.stop + 1, held.size))
        way = float(np.sum((found[ends][1:] + found[ends][:-1]) / 2 * np.diff(time[ends])))
        moved = float(held[inner.stop - 1] - held[inner.start])
        if way * moved > 0 and 1 / _MOST_SCALED <= moved / way <= _MOST_SCALED:
            found *= moved / way
    return found


def _half_window(noise: float, step_s: float, speed_mm_s: float) -> int:
    """Return how many samples on each side a regression line uses, so that its slope is precise enough."""
    most = max(1, round(_WINDOW_S / 2 / step_s))
    for half in range(1, most):
        sd = noise / (step_s * np.sqrt(half * (half + 1) * (2 * half + 1) / 3))
        if sd <= _VELOCITY_NOISE * speed_mm_s:
            return half
    return most


def _slopes(time: Array, depth: Array, half: int) -> Array:
    """Return the slope of the regression line around each sample; at the ends the line has fewer samples."""
    n = depth.size
    found = np.zeros(n)
    width = 2 * half + 1
    if n >= width:
        times, depths = sliding_window_view(time, width), sliding_window_view(depth, width)
        found[half : n - half] = _slope(times, depths)
    for at in [*range(min(half, n)), *range(max(n - half, half), n)]:
        rows = slice(min(max(at - half, 0), max(n - 2, 0)), max(min(at + half + 1, n), 2))
        found[at] = _slope(time[rows], depth[rows]) if n > 1 else 0.0
    return found


def _slope(time: Array, depth: Array) -> Array:
    """Return the slope of regression lines through the last axis."""
    centred = time - time.mean(axis=-1, keepdims=True)
    return np.asarray((centred * depth).sum(axis=-1) / (centred**2).sum(axis=-1))
