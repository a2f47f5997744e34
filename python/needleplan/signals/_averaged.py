"""Motions whose samples are means over intervals.

A sensor, or a program that reduces the rate of a recording, returns means over sample intervals. The mean output of a
model is not the output at the mean motion where friction reverses within an interval, or a dwell begins in it. An
`AveragedMotion` therefore keeps several instants of such intervals; `needleplan.models.simulate` evaluates the model at
all instants and returns the means.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from needleplan.signals._record import Array, Motion, Record

__all__ = ["AveragedMotion", "AveragedRecord", "SpannedMotion", "averaged_motion", "averaged_record", "parts_of"]

# Distance of the instants in intervals with a reversal or a change of speed, s.
_FINE_S = 0.006
# Travel (mm) after a change of speed or direction in which the instants stay dense, and longest such time (s).
_TRAVEL_MM, _AFTER_S = 1.0, 0.4
# Change of the velocity within an interval, as a share of the largest speed, from which the interval is divided.
_CHANGE = 0.02
# Travel of a sample, mm, below which it counts as none: a mean over less would be a quotient of rounding errors.
_SPAN_MM = 1e-6
# Largest slope of a monotone cubic at its ends, in units of its mean slope (Fritsch and Carlson, 1980).
_STEEPEST = 3.0


@dataclass(frozen=True, repr=False)
class SpannedMotion(Motion):
    """Motion whose samples stand for the depths about them.

    A force with a kink in depth, such as that of a bursting membrane, is averaged over these depths by its own formula.

    Parameters
    ----------
    span_mm : Array
        Travel for which each sample stands, half of it before the sample, shape (samples,); 0 at rest.
    """

    span_mm: Array


@dataclass(frozen=True, repr=False)
class AveragedMotion(Motion):
    """Motion whose samples are means over intervals.

    Parameters
    ----------
    fine : Motion
        Instants at which models are evaluated, in order. An interval has one or more instants.
    first : Array
        Index in `fine` of the first instant of each sample, shape (samples,).
    sampled_s : float
        Sample interval before averaging, s.
    """

    fine: SpannedMotion
    first: NDArray[np.intp]
    sampled_s: float

    def __getitem__(self, index: object) -> Motion:
        """Return the plain motion at selected samples."""
        return self._plain[index]

    def between(self, fraction: float) -> Motion:
        """Return the motion at `fraction` of each interval between samples; see `Motion.between`."""
        return self._plain.between(fraction)

    @property
    def _plain(self) -> Motion:
        return Motion(*(getattr(self, column.name) for column in fields(Motion)))

    def mean(self, values: Array) -> Array:
        """Average values at the instants of `fine`, shape (..., instants), over the intervals; shape (..., samples)."""
        if not values.size:
            return np.zeros((*values.shape[:-1], len(self.first)))
        samples, instants, starts, counts = self._divided
        means: Array = np.take(np.asarray(values, float), self.first, axis=-1)
        if samples.size:
            means[..., samples] = np.add.reduceat(np.take(values, instants, axis=-1), starts, axis=-1) / counts
        return means

    @cached_property
    def _divided(self) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
        """Samples with several instants: sample indices, instants, start of each sample in the instants, and counts."""
        counts = np.diff(np.append(self.first, len(self.fine)))
        samples = np.flatnonzero(counts > 1)
        instants = np.flatnonzero(np.repeat(counts > 1, counts))
        return samples, instants, np.cumsum(np.append(0, counts[samples]))[:-1], counts[samples]


def averaged_motion(motion: Motion, block: int, *, instants: bool = False) -> AveragedMotion:
    """Return the means of a motion over blocks of `block` samples; a rest of fewer samples is left out.

    A sample stands for the interval about its time. In intervals with a reversal or a change of speed, and for a short
    travel after them, the motion is divided into instants of about 6 ms, with cubic interpolation. The other intervals
    keep one instant.

    Parameters
    ----------
    motion : Motion
        The sampled motion.
    block : int
        Number of samples of an average, at least 1.
    instants : bool
        Whether the samples are readings at instants; by default they are means over their intervals.

    Returns
    -------
    AveragedMotion
        Means over the blocks.
    """
    count = len(motion) // block
    whole = motion[: count * block]
    means = {field.name: getattr(whole, field.name).reshape(count, block).mean(axis=1) for field in fields(Motion)}
    interval = float(np.median(motion.interval_s))
    parts = 1 if instants else parts_of(motion)
    dense = _dense(whole, count, block)
    # Offsets of the instants within a sample interval, as shares of the interval.
    offsets = (np.arange(parts) + 0.5) / parts - 0.5
    fine = _interpolated(motion, (np.arange(count * block)[:, None] + offsets).ravel()) if parts > 1 else whole
    places = np.arange(count * block * parts).reshape(count, block * parts)
    counts = np.where(dense, block * parts, 1)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    columns = []
    for field in fields(Motion)[:3]:
        values = np.empty(int(counts.sum()))
        values[first[~dense]] = means[field.name][~dense]
        values[_ranges(first[dense], block * parts)] = getattr(fine, field.name)[places[dense].ravel()]
        columns.append(values)
    time, depth, velocity = columns
    angle = np.interp(time, motion.time_s, motion.angle_rad)
    lasts = block * interval / counts
    if instants:
        lasts[counts == block] = 0.0  # these are the readings themselves
    span = np.abs(velocity) * np.repeat(lasts, counts)
    span[span < _SPAN_MM] = 0.0
    plain = Motion.sampled(time, depth, velocity, angle)
    return AveragedMotion(
        means["time_s"], means["depth_mm"], means["velocity_mm_s"],
        _directions(means["velocity_mm_s"]), means["angle_rad"],
        SpannedMotion(plain.time_s, plain.depth_mm, plain.velocity_mm_s, plain.direction, plain.angle_rad, span),
        first, interval,
    )  # fmt: skip


@dataclass(frozen=True)
class AveragedRecord(Record):
    """A recording whose samples are means; its motion keeps several instants where the speed changes."""

    averaged: AveragedMotion | None = None

    def motion(self) -> Motion:
        """Return the motion of the means."""
        return super().motion() if self.averaged is None else self.averaged


def averaged_record(record: Record, rate_hz: float, *, instants: bool = False) -> Record:
    """Return a recording averaged over blocks of equal length, so that its rate is at most `rate_hz`.

    Models are integrated over the sample intervals of the result, even if the blocks hold one sample each.

    Parameters
    ----------
    record : Record
        Recording with the column `time_s`. Samples after the last whole block are dropped.
    rate_hz : float
        Upper limit of the rate of the result (Hz).
    instants : bool, default False
        Whether the readings are taken at instants. The prediction of a model is then averaged over these instants.

    Returns
    -------
    Record
        Means of all columns, with the trial, role, notes and frame of `record`.
    """
    interval = float(np.median(np.diff(record["time_s"])))
    block = max(math.ceil(1 / (interval * rate_hz) - 1e-6), 1) if interval > 0 else 1
    count = len(record) // block
    columns = {
        name: values[: count * block].reshape(count, block).mean(axis=1) for name, values in record.columns.items()
    }
    motion = (
        averaged_motion(record.motion(), block, instants=instants)
        if "depth_mm" in record.columns and count > 1
        else None
    )
    return AveragedRecord(
        columns,
        record.trial,
        record.role,
        record.phase[: count * block : block],
        record.digest,
        record.notes,
        record.frame,
        record.begun_s,
        motion,
    )


def parts_of(motion: Motion) -> int:
    """Return the number of instants, about 6 ms apart, into which `averaged_motion` divides a sample interval.

    It divides those intervals of the motion in which the speed changes. The number is 1 for short intervals.
    """
    return max(math.ceil(float(np.median(motion.interval_s)) / _FINE_S), 1)


def _directions(velocity: Array) -> Array:
    return Motion.sampled(np.arange(len(velocity), dtype=float), np.zeros_like(velocity), velocity).direction


def _ranges(first: NDArray[np.intp], length: int) -> NDArray[np.intp]:
    """Return the indices of ranges of one length, one after the other."""
    return (first[:, None] + np.arange(length)).ravel()


def _dense(motion: Motion, count: int, block: int) -> NDArray[np.bool_]:
    """Return for each block whether the speed changes in it, or has changed shortly before."""
    velocity, depth = motion.velocity_mm_s, motion.depth_mm
    least = _CHANGE * max(float(np.abs(velocity).max()), 1e-9)
    changes = np.zeros(len(motion), bool)
    # A change is a start, a stop or a reversal: accelerations at speed need no instants of their own.
    moving = np.where(np.abs(velocity) < least, 0.0, np.sign(velocity))
    at = np.flatnonzero(np.diff(moving)) + 1
    changes[at] = True
    changes[np.maximum(at - 1, 0)] = True
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(depth)))])
    last = np.maximum.accumulate(np.where(changes, np.arange(len(motion)), -1))
    after = (last >= 0) & (travel - travel[last] < _TRAVEL_MM) & (motion.time_s - motion.time_s[last] < _AFTER_S)
    found = (after | changes).reshape(count, block).any(axis=1)
    wider: NDArray[np.bool_] = found.copy()
    wider[:-1] |= found[1:]
    return wider


def _interpolated(motion: Motion, places: Array) -> Motion:
    """Return the motion at fractional sample indices by cubic Hermite interpolation.

    Between velocities of one sign the cubic is monotone, so that no reversal is added.
    """
    last = len(motion) - 1
    left = np.clip(np.floor(places).astype(np.intp), 0, last - 1)
    step = np.diff(motion.time_s)
    s = np.clip(places - left, -0.5, 1.5)
    rise = np.diff(motion.depth_mm) / step
    v0, v1 = motion.velocity_mm_s[:-1], motion.velocity_mm_s[1:]
    reverses = v0 * v1 < 0
    v0, v1 = (
        np.where(reverses, v, np.clip(v, np.minimum(0, _STEEPEST * rise), np.maximum(0, _STEEPEST * rise)))
        for v in (v0, v1)
    )
    h, a, b, d = step[left], v0[left], v1[left], rise[left]
    inside = np.clip(s, 0.0, 1.0)
    beyond = (s - inside) * h  # half an interval before the first and after the last sample: at constant velocity
    depth = motion.depth_mm[left] + h * (
        d * inside**2 * (3 - 2 * inside) + a * inside * (1 - inside) ** 2 - b * inside**2 * (1 - inside)
    )
    velocity = 6 * d * inside * (1 - inside) + a * (1 - inside) * (1 - 3 * inside) + b * inside * (3 * inside - 2)
    return Motion.sampled(
        motion.time_s[left] + s * h, depth + beyond * velocity, velocity,
        np.interp(places, np.arange(last + 1), motion.angle_rad),
    )  # fmt: skip
