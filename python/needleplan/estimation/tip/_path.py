"""Which way the bevel looked along the channel that the tip has cut."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from needleplan.estimation.tip._estimate import TipSettings
from needleplan.signals import Array

__all__ = [
    "ELEVATION",
    "FACTOR",
    "HEADING",
    "ROLL",
    "SIZE",
    "WANDER",
    "ChannelPiece",
    "CutChannel",
    "along",
    "moved",
    "tangent",
]

_MERGED_MM = 0.02
"""Rolls that are closer along the path are one."""

_PIECE_MM = 0.5
"""While the bevel turns during the insertion, the direction in which it bends is averaged over so much."""

_SAME_RAD = 1e-3
_REJOIN_MM = 0.05
_REJOIN_RAD = 0.5
"""A needle drawn back by more than the one follows its channel again, unless it is turned by more than the other."""


class ChannelPiece(NamedTuple):
    """A part of the path: its length, the mean of (cos, sin) of the roll, how far it was turned where it begins.

    On the straight line before the surface `fresh` is false, and nothing bends.
    """

    length_mm: float
    cos: float
    sin: float
    turned_rad: float
    fresh: bool


class CutChannel:
    """The rolls at which the tip has cut its way, by the length of the path from the surface on."""

    def __init__(self, length_mm: float, roll_rad: float) -> None:
        self.length_mm = length_mm
        self.cut_mm = max(length_mm, 0.0)
        self._from = [0.0]
        self._rolls = [roll_rad]

    @property
    def last_roll_rad(self) -> float:
        """The roll at which the end of the channel was cut."""
        return self._rolls[-1]

    def move(self, length_mm: float, roll_rad: float) -> float | None:
        """Move the tip to a length, its bevel at a roll; return where it left the channel for a new one, if it did."""
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
        """Yield the path from one length to another, in its order; beyond its end as if it went on."""
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


HEADING, ELEVATION, FACTOR, ROLL = 3, 4, 5, 6
WANDER = slice(7, 10)
SIZE = 10

_VARIED = (HEADING, ELEVATION, FACTOR, ROLL)
_STEP = np.array([1e-5, 1e-5, 1e-4, 1e-5])
_SHIFTS = np.zeros((2 * len(_VARIED) + 1, SIZE))
for _row, (_column, _size) in enumerate(zip(_VARIED, _STEP, strict=True)):
    _SHIFTS[1 + _row, _column], _SHIFTS[1 + len(_VARIED) + _row, _column] = _size, -_size


def tangent(state: Array) -> Array:
    """Return the direction of the path, shape (3,)."""
    heading, elevation = float(state[HEADING]), float(state[ELEVATION])
    level = math.cos(elevation)
    return np.array([level * math.cos(heading), level * math.sin(heading), math.sin(elevation)])


def along(states: Array, piece: ChannelPiece, planned_per_mm: float) -> Array:
    """Return states (n, 10) after a piece of the path; exact for a constant roll, of any length."""
    heading, elevation, factor, roll = (states[:, column] for column in _VARIED)
    bend = factor * planned_per_mm if piece.fresh else np.zeros(len(states))
    cos_r, sin_r = np.cos(roll), np.sin(roll)
    left, up = piece.cos * cos_r - piece.sin * sin_r, piece.sin * cos_r + piece.cos * sin_r
    size = np.hypot(left, up)
    scale = np.where(size > 0, size, 1.0)
    left, up = left / scale, up / scale
    turn = bend * size * piece.length_mm
    chord = piece.length_mm * np.sinc(turn / (2 * np.pi))
    forward, aside = chord * np.cos(turn / 2), chord * np.sin(turn / 2)
    cos_h, sin_h, cos_e, sin_e = np.cos(heading), np.sin(heading), np.cos(elevation), np.sin(elevation)
    cos_t, sin_t = np.cos(turn), np.sin(turn)
    level = forward * cos_e - aside * up * sin_e
    after = states.copy()
    after[:, 0] += level * cos_h - aside * left * sin_h
    after[:, 1] += level * sin_h + aside * left * cos_h
    after[:, 2] += forward * sin_e + aside * up * cos_e
    turned = np.arctan2(sin_t * left, cos_t * cos_e - sin_t * up * sin_e)
    after[:, HEADING] += turned
    after[:, ELEVATION] = np.arcsin(np.clip(cos_t * sin_e + sin_t * up * cos_e, -1.0, 1.0))
    after[:, ROLL] -= turned * np.sin((elevation + after[:, ELEVATION]) / 2)
    return after


def moved(
    state: Array, covariance: Array, piece: ChannelPiece, planned_per_mm: float, settings: TipSettings
) -> tuple[Array, Array]:
    """Return state and covariance after a piece of the path."""
    if piece.turned_rad:
        covariance = covariance.copy()
        covariance[ROLL, ROLL] += settings.roll_sd_sqrt_rad**2 * piece.turned_rad
    rows = along(state + _SHIFTS, piece, planned_per_mm)
    count = len(_VARIED)
    change = np.eye(SIZE)
    change[:, _VARIED] = ((rows[1 : count + 1] - rows[count + 1 :]) / (2 * _STEP[:, None])).T
    after = rows[0]
    return after, change @ covariance @ change.T + _noise(state, after, piece, settings)


def _noise(before: Array, after: Array, piece: ChannelPiece, settings: TipSettings) -> Array:
    """Return the covariance that a piece adds: the tangent's random walk, integrated over its length, and the slip."""
    length = piece.length_mm
    middle = (before + after) / 2
    cos_h, sin_h = math.cos(middle[HEADING]), math.sin(middle[HEADING])
    cos_e, sin_e = math.cos(middle[ELEVATION]), math.sin(middle[ELEVATION])
    forward = np.array([cos_e * cos_h, cos_e * sin_h, sin_e])
    noise = np.zeros((SIZE, SIZE))
    noise[:3, :3] = settings.slip_sd_mm_sqrt_mm**2 * length * np.outer(forward, forward)
    if not piece.fresh:
        return noise
    variance = settings.heading_sd_rad_sqrt_mm**2
    for across, angle, scale in (
        (np.array([-sin_h, cos_h, 0.0]), HEADING, 1 / cos_e),
        (np.array([-sin_e * cos_h, -sin_e * sin_h, cos_e]), ELEVATION, 1.0),
    ):
        noise[:3, :3] += variance * length**3 / 3 * np.outer(across, across)
        noise[:3, angle] = noise[angle, :3] = variance * length**2 / 2 * scale * across
        noise[angle, angle] = variance * length * scale**2
    # An elevation that wanders takes the roll along where the heading turns.
    upwards = np.array([-sin_e * cos_h, -sin_e * sin_h, cos_e])
    turn = float(before[HEADING] - after[HEADING])
    noise[:3, ROLL] = noise[ROLL, :3] = variance * turn * length**2 / 3 * upwards
    noise[ELEVATION, ROLL] = noise[ROLL, ELEVATION] = variance * turn * length / 2
    noise[ROLL, ROLL] = variance * turn**2 * length / 3
    noise[FACTOR, FACTOR] = settings.factor_sd_sqrt_mm**2 * length
    return noise
