"""The path as the filter sees it: a state that moves along arcs, and what becomes of its covariance.

The state is that of a point of the path, shape (10,): position (3), heading and elevation of the tangent, the curvature
over that of the plan, the roll of the bevel beyond that of the base, and the slow error of the tracker (3). With the
roll phi of the bevel the tangent turns by k cos(phi) to the left and by k sin(phi) upwards, per length. Heading and
elevation are angles to a fixed plane, whereas the roll of a needle that does not twist is counted from a direction that
is carried along its path: the two part by -sin(elevation) d(heading), which the roll of the state takes up.
"""

from __future__ import annotations

import math

import numpy as np

from needleplan.estimation.tip.channel import Piece
from needleplan.estimation.tip.settings import TipSettings
from needleplan.signals import Array

__all__ = ["ELEVATION", "FACTOR", "HEADING", "ROLL", "SIZE", "WANDER", "along", "moved", "tangent"]

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


def along(states: Array, piece: Piece, planned_per_mm: float) -> Array:
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
    state: Array, covariance: Array, piece: Piece, planned_per_mm: float, settings: TipSettings
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


def _noise(before: Array, after: Array, piece: Piece, settings: TipSettings) -> Array:
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
