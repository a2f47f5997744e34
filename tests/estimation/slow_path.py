"""The slow twin of `needleplan._ppvi.path_moved`: one prediction step of the tip filter in NumPy."""

import math

import numpy as np

from needleplan.estimation import TipSettings
from needleplan.estimation.tip._path import (
    CHANGE,
    ELEVATION,
    FACTOR,
    HEADING,
    INTEGRATED,
    ROLL,
    SIZE,
    ChannelPiece,
    mean_gained,
)
from needleplan.signals import Array

# Columns on which the next state depends nonlinearly, and the steps of their central differences.
_VARIED = (
    HEADING,
    ELEVATION,
    FACTOR,
    ROLL,
    CHANGE,
)
_STEP = np.array([1e-5, 1e-5, 1e-4, 1e-5, 1e-5])
_SHIFTS = np.zeros((2 * len(_VARIED) + 1, SIZE))
for _row, (_column, _size) in enumerate(zip(_VARIED, _STEP, strict=True)):
    _SHIFTS[1 + _row, _column], _SHIFTS[1 + len(_VARIED) + _row, _column] = _size, -_size


def gained(length_mm: float, change_mm: float) -> float:
    """The integral of exp(-s/a) over a length (mm)."""
    return change_mm * -math.expm1(-length_mm / change_mm)


def along(states: Array, piece: ChannelPiece, planned_per_mm: float, change_mm: float) -> Array:
    """Return the states, shape (n, 11), at the end of a piece of the path that begins at `states`.

    The piece counts with its mean curvature. For a constant roll and a constant ratio of the curvature, the result is
    exact for any length.
    """
    heading, elevation, factor, roll, change = (states[:, column] for column in _VARIED)
    mean = factor + change * mean_gained(piece.length_mm, change_mm)
    bend = mean * planned_per_mm if piece.fresh else np.zeros(len(states))
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
    if piece.fresh:
        after[:, FACTOR] += change * gained(piece.length_mm, change_mm)
        after[:, CHANGE] *= math.exp(-piece.length_mm / change_mm)
    return after


def moved(
    state: Array, covariance: Array, piece: ChannelPiece, planned_per_mm: float, settings: TipSettings
) -> tuple[Array, Array]:
    """Return state and covariance at the end of a piece of the path.

    The first eleven entries of the state describe the path. With curvature sensors, the running integrals of heading,
    elevation and roll follow, which this function advances. All later entries do not change.
    """
    if piece.turned_rad:
        covariance = covariance.copy()
        covariance[ROLL, ROLL] += settings.roll_sd_sqrt_rad**2 * piece.turned_rad
    path = state[:SIZE]
    rows = along(path + _SHIFTS, piece, planned_per_mm, settings.change_mm)
    count = len(_VARIED)
    change = np.eye(SIZE)
    change[:, _VARIED] = ((rows[1 : count + 1] - rows[count + 1 :]) / (2 * _STEP[:, None])).T
    after = rows[0]
    if state.size == SIZE:
        return after, change @ covariance @ change.T + _noise(path, after, piece, settings)
    # With curvature sensors, the next columns integrate heading, elevation and roll over the path.
    length, angles, sums = piece.length_mm, list(INTEGRATED), list(range(SIZE, SIZE + len(INTEGRATED)))
    transition = np.eye(state.size)
    transition[:SIZE, :SIZE] = change
    # Trapezoidal rule: length times the mean of the angle before and after the piece.
    transition[sums, :SIZE] = length / 2 * (np.eye(SIZE)[angles] + change[angles])
    result = transition @ covariance @ transition.T
    noise = _noise(path, after, piece, settings)
    result[:SIZE, :SIZE] += noise
    if piece.fresh:
        # An angle w is a random walk with the variance v over the length L. Its integral I over the piece has
        # cov(w, I) = v L / 2 and var(I) = v L^2 / 3. The position y across the path is the same integral, so that
        # cov(y, I) = v L^2 / 3; `noise` has cov(y, w) = v L / 2, and 2/3 L = 4/3 of L / 2 is the factor between them.
        cross = length / 2 * noise[:SIZE, angles]
        cross[:3] *= 4 / 3
        result[:SIZE, sums] += cross
        result[sums, :SIZE] += cross.T
        result[np.ix_(sums, sums)] += length**2 / 3 * noise[np.ix_(angles, angles)]
    advanced = np.concatenate([after, state[SIZE:]])
    advanced[sums] += length / 2 * (path[angles] + after[angles])
    return advanced, result


def _noise(before: Array, after: Array, piece: ChannelPiece, settings: TipSettings) -> Array:
    """Return the process noise of a piece: slip, random walks of the tangent and the curvature factor, and its change.

    A piece that is not `fresh` has only slip.
    """
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
    # A random walk of the heading turns the fixed plane below the transported roll, at every elevation.
    level, aside = -sin_e / cos_e, np.array([-sin_h, cos_h, 0.0])
    noise[:3, ROLL] = variance * length**2 / 2 * level * aside
    noise[HEADING, ROLL] = noise[ROLL, HEADING] = variance * length * level / cos_e
    noise[ROLL, ROLL] = variance * length * level**2
    # A random walk of the elevation is coupled to the roll while the heading turns.
    upwards = np.array([-sin_e * cos_h, -sin_e * sin_h, cos_e])
    turn = float(before[HEADING] - after[HEADING])
    noise[:3, ROLL] += variance * turn * length**2 / 3 * upwards
    noise[ROLL, :3] = noise[:3, ROLL]
    noise[ELEVATION, ROLL] = noise[ROLL, ELEVATION] = variance * turn * length / 2
    noise[ROLL, ROLL] += variance * turn**2 * length / 3
    noise[FACTOR, FACTOR] = settings.factor_sd_sqrt_mm**2 * length
    # The noise of the change within a piece hardly moves the ratio in the same piece, so only its own variance counts.
    noise[CHANGE, CHANGE] = settings.change_sd_per_mm**2 * -math.expm1(-2 * length / settings.change_mm)
    return noise
