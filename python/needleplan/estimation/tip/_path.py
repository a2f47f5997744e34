"""The path of the needle: the channel that the tip has cut, and the prediction of state and covariance along it.

The state of a point of the path has the shape (11,): position (3), heading and elevation of the tangent, ratio f of the
curvature to the planned curvature, difference between the roll of the bevel and the roll of the base, drift of the
tracker (3), change r of the ratio per length. Along fresh path, f' = r + white noise, and r is a first-order
Gauss-Markov process with the length a, r' = -r/a + white noise. With the roll phi of the bevel, the tangent turns by k
cos(phi) to the left and by k sin(phi) upwards per length. Heading and elevation are angles to a fixed plane, whereas
the roll of a needle without twist is measured from a direction that is transported along the path (Bishop's frame). Per
change d(heading), the roll relative to the fixed plane changes by -sin(elevation) d(heading); the roll in the state
contains this change.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from needleplan import _ppvi
from needleplan.estimation.tip._estimate import TipSettings
from needleplan.signals import Array

__all__ = [
    "CHANGE",
    "ELEVATION",
    "FACTOR",
    "HEADING",
    "INTEGRATED",
    "ROLL",
    "SIZE",
    "WANDER",
    "ChannelPiece",
    "CutChannel",
    "StageTrack",
    "begun",
    "mean_gained",
    "moved",
    "tangent",
    "wandered",
]

# Columns of the state; 0 to 2 hold the position.
HEADING, ELEVATION, FACTOR, ROLL = 3, 4, 5, 6
WANDER = slice(7, 10)
CHANGE = 10
# Number of columns.
SIZE = 11

# Columns that are integrated over the path if the needle has curvature sensors.
INTEGRATED = (HEADING, ELEVATION, ROLL)

# Number of stored stage samples, for late measurements: four seconds at 1 kHz.
_KEPT = 4096

# Longest time (s) over which the depth is extrapolated for a measurement that is newer than the last stage sample.
_AHEAD_S = 0.05

# Length of path (mm) below which a new roll replaces the previous one.
_MERGED_MM = 0.02

# Length of path (mm) over which the direction of bending is averaged while the base turns during the insertion.
_PIECE_MM = 0.5

# Change of the roll (rad) below which the roll counts as constant.
_SAME_RAD = 1e-3

# Distance (mm) behind the end of the channel above which an advancing tip follows the existing channel.
_REJOIN_MM = 0.05

# Difference (rad) between the roll of the base and of the existing channel above which the tip cuts a new channel.
_REJOIN_RAD = 0.5


class ChannelPiece(NamedTuple):
    """A piece of the path: length, means of cos and sin of the roll, and the rotation of the base (rad) in the piece.

    `fresh` is False for the straight line in front of the surface, on which the path does not bend.
    """

    length_mm: float
    cos: float
    sin: float
    turned_rad: float
    fresh: bool


class CutChannel:
    """The channel that the tip has cut: the roll of the base as a function of the path length from the surface.

    `length_mm` is the path length at the tip, `cut_mm` the length of the channel.
    """

    def __init__(self, length_mm: float, roll_rad: float) -> None:
        self.length_mm = length_mm
        self.cut_mm: float = max(length_mm, 0.0)
        self._from = [0.0]
        self._rolls = [roll_rad]

    @property
    def last_roll_rad(self) -> float:
        """Roll at the end of the channel."""
        return self._rolls[-1]

    @property
    def settled_mm(self) -> float:
        """Path length up to which the roll of the channel changes only if the tip cuts a new channel."""
        return self.cut_mm - _MERGED_MM

    def move(self, length_mm: float, roll_rad: float) -> float | None:
        """Move the tip to a path length, with the base at a roll.

        Returns the path length at which the tip began to cut a new channel beside the old one, or None if it did not.
        """
        begin = self.length_mm
        left_at = None
        if length_mm > begin and 0 < begin < self.cut_mm - _REJOIN_MM:
            old = self._rolls[bisect_right(self._from, begin) - 1]
            if abs(math.remainder(roll_rad - old, 2 * math.pi)) > _REJOIN_RAD:
                keep = bisect_right(self._from, begin)
                del self._from[keep:], self._rolls[keep:]
                self.cut_mm = begin
                left_at = begin
        self.length_mm = length_mm
        if length_mm > self.cut_mm:
            if abs(roll_rad - self._rolls[-1]) > _SAME_RAD:
                self._turn(self.cut_mm, roll_rad)
            self.cut_mm = length_mm
        return left_at

    def pieces(self, begin_mm: float, end_mm: float) -> Iterator[ChannelPiece]:
        """Yield the pieces of the path between two path lengths. Beyond the channel, its last roll continues."""
        if begin_mm < 0:
            before = min(end_mm, 0.0) - begin_mm
            yield ChannelPiece(before, 0.0, 0.0, 0.0, fresh=False)
            begin_mm = 0.0
        if end_mm <= begin_mm:
            return
        number = bisect_right(self._from, begin_mm) - 1
        length = along = aside = turned = 0.0
        while begin_mm < end_mm:
            following = self._from[number + 1] if number + 1 < len(self._from) else math.inf
            part = min(following, end_mm) - begin_mm
            if length and length + part > _PIECE_MM:
                yield ChannelPiece(length, along / length, aside / length, turned, fresh=True)
                length = along = aside = turned = 0.0
            roll = self._rolls[number]
            length, along, aside = length + part, along + part * math.cos(roll), aside + part * math.sin(roll)
            if number and begin_mm == self._from[number]:
                turned += abs(roll - self._rolls[number - 1])
            begin_mm += part
            if following <= begin_mm:
                begin_mm = following
                number += 1
        yield ChannelPiece(length, along / length, aside / length, turned, fresh=True)

    def _turn(self, length_mm: float, roll_rad: float) -> None:
        if length_mm - self._from[-1] < _MERGED_MM:
            self._rolls[-1] = roll_rad
        else:
            self._from.append(length_mm)
            self._rolls.append(roll_rad)


def begun(entry: tuple[float, ...], at_mm: float, settings: TipSettings) -> tuple[Array, Array]:
    """Return state and covariance at a path length, from the entry pose and its standard deviations."""
    x, y, heading = entry[:3]
    state = np.zeros(SIZE)
    state[[0, 1, HEADING, FACTOR]] = x, y, heading, 1.0
    if len(entry) == 5:
        state[[2, ELEVATION]] = entry[3:]
    state[:3] += at_mm * tangent(state)
    sd = np.array([settings.entry_sd_mm] * 3 + [settings.entry_sd_rad] * 2)
    wander, change = [settings.wander_sd_mm] * 3, settings.change_sd_per_mm
    return state, np.diag(np.array([*sd, settings.factor_sd, settings.roll_sd_rad, *wander, change]) ** 2)


def wandered(state: Array, covariance: Array, passed_s: float, settings: TipSettings) -> tuple[Array, Array]:
    """Return state and covariance after a time (s), with the drift of the tracker as a Gauss-Markov process."""
    keep = math.exp(-passed_s / settings.wander_s)
    state, covariance = state.copy(), covariance.copy()
    state[WANDER] *= keep
    covariance[WANDER, :] *= keep
    covariance[:, WANDER] *= keep
    rows = range(SIZE)[WANDER]
    covariance[rows, rows] += (1 - keep**2) * settings.wander_sd_mm**2
    return state, covariance


def tangent(state: Array) -> Array:
    """Return the unit tangent of the path at a state, shape (3,)."""
    heading, elevation = float(state[HEADING]), float(state[ELEVATION])
    level = math.cos(elevation)
    return np.array([level * math.cos(heading), level * math.sin(heading), math.sin(elevation)])


def _gained(length_mm: float, change_mm: float) -> float:
    """Return the length by which a change of the ratio counts: the integral of exp(-s/a) over a length (mm)."""
    return change_mm * -math.expm1(-length_mm / change_mm)


def mean_gained(length_mm: float, change_mm: float) -> float:
    """Return the mean of `_gained` over a length (mm)."""
    if length_mm < 1e-6 * change_mm:
        return length_mm / 2
    return change_mm * (1 - _gained(length_mm, change_mm) / length_mm)


def moved(
    state: Array, covariance: Array, piece: ChannelPiece, planned_per_mm: float, settings: TipSettings
) -> tuple[Array, Array]:
    """Return state and covariance at the end of a piece of the path.

    The first eleven entries of the state describe the path. With curvature sensors, the running integrals of heading,
    elevation and roll follow, which this function advances. All later entries do not change. The piece counts with its
    mean curvature: for a constant roll and a constant ratio of the curvature, the mean is exact for any length.
    """
    noise = (
        settings.slip_sd_mm_sqrt_mm, settings.heading_sd_rad_sqrt_mm, settings.factor_sd_sqrt_mm,
        settings.change_sd_per_mm, settings.change_mm, settings.roll_sd_sqrt_rad,
    )  # fmt: skip
    return _ppvi.path_moved(state, covariance, piece, planned_per_mm, noise)


class StageTrack:
    """The last stage samples, for measurements that arrive late."""

    def __init__(self) -> None:
        self._samples: deque[tuple[int, float, float]] = deque(maxlen=_KEPT)

    def is_newer(self, time_ns: int) -> bool:
        """Return whether a time is after the newest sample, or there is no sample."""
        return not self._samples or time_ns > self._samples[-1][0]

    def add(self, time_ns: int, depth_mm: float, velocity_mm_s: float) -> None:
        """Append a sample."""
        self._samples.append((time_ns, depth_mm, velocity_mm_s))

    @property
    def newest(self) -> tuple[int, float]:
        """Time (ns) and depth (mm) of the newest sample."""
        return self._samples[-1][:2]

    def depth_at(self, time_ns: int) -> float:
        """Return the stage depth (mm) at a time, interpolated between stage samples.

        After the last sample, the depth is extrapolated for at most `_AHEAD_S`; before the oldest stored sample, its
        depth is returned.
        """
        last_ns, last_mm, velocity = self._samples[-1]
        if time_ns >= last_ns:
            return last_mm + velocity * min((time_ns - last_ns) * 1e-9, _AHEAD_S)
        after_ns, after_mm = last_ns, last_mm
        for before_ns, before_mm, _ in reversed(self._samples):
            if before_ns <= time_ns:
                share = (time_ns - before_ns) / max(after_ns - before_ns, 1)
                return before_mm + share * (after_mm - before_mm)
            after_ns, after_mm = before_ns, before_mm
        return after_mm
