"""The path of a needle's tip in space, by its parallel-transported frame.

The tip's tangent t and two normals e1, e2 that never twist about it turn by the curvature K = (K1, K2) per length:
dt/ds = K1 e1 + K2 e2, de_i/ds = -K_i t. K follows what bevel and tissue ask for over RELAXING_MM of new path. Each step
is the exact arc of its K.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tests.blind.motions import Array

CURVATURE_1_MM = 1.0 / 250.0
RELAXING_MM = 0.02
SCATTER = 0.03  # of the curvature, uniform, per trial
CORRELATION_MM = 5.0
GRID_MM = np.arange(0.0, 121.0)


@dataclass(frozen=True)
class Medium:
    """Tissue of R trials: curvature toward the bevel and across it, relative to the nominal one (R, grid)."""

    along: Array
    across: Array


@dataclass(frozen=True)
class Steered:
    """What an effect can see: time (T,); inserted length in mm, speed, angle of base and tip in rad (T, R)."""

    time_s: Array
    depth_mm: Array
    velocity_mm_s: Array
    base_rad: Array
    tip_rad: Array


@dataclass(frozen=True)
class Course:
    """Positions in mm, normals e1, e2 of the tip, each (T, R, 3); x along the insertion, e1 begins as y, e2 as z."""

    position_mm: Array
    first: Array
    second: Array


def _field(rng: np.random.Generator) -> Array:
    keep = np.exp(-(GRID_MM[1] - GRID_MM[0]) / CORRELATION_MM)
    values = rng.standard_normal(len(GRID_MM))
    for i in range(1, len(values)):
        values[i] = keep * values[i - 1] + np.sqrt(1.0 - keep**2) * values[i]
    return values


def medium(seeds: Sequence[np.random.SeedSequence], heterogeneity: float) -> Medium:
    """Tissue of as many trials as there are seeds; the bending wanders across the bevel half as much as along it."""
    along, across = [], []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        scale = 1.0 + SCATTER * rng.uniform(-1, 1)
        along.append(scale * (1.0 + heterogeneity * _field(rng)))
        across.append(0.5 * heterogeneity * _field(rng))
    return Medium(np.array(along), np.array(across))


def wanted_curvature(steered: Steered, tissue: Medium) -> tuple[Array, Array]:
    """What the bevel asks for toward itself and across, 1/mm, each (T, R)."""
    depths = steered.depth_mm.T
    along, across = (
        np.stack([np.interp(depth, GRID_MM, each) for depth, each in zip(depths, part, strict=True)], axis=1)
        for part in (tissue.along, tissue.across)
    )
    return CURVATURE_1_MM * along, CURVATURE_1_MM * across


def integrated(depth_mm: Array, curvature_1_mm: Array, tilt_rad: Array) -> Course:
    """The course for wanted curvatures (T, R, 2) in e1 and e2, entering with tilt_rad (2,) toward y and z."""
    steps, trials = depth_mm.shape
    angle = float(np.hypot(*tilt_rad))
    frame = np.broadcast_to(np.eye(3), (trials, 3, 3)).copy()
    if angle:
        frame = _turned(frame, np.broadcast_to(tilt_rad, (trials, 2)))[0]
    state = np.zeros((trials, 2))
    here = np.zeros((trials, 3))
    positions, frames = np.zeros((steps, trials, 3)), np.zeros((steps, trials, 3, 3))
    frames[0] = frame
    lengths = np.diff(depth_mm, axis=0)
    follow = -np.expm1(-lengths / RELAXING_MM)
    for k in range(1, steps):
        if lengths[k - 1].any():
            mean = 0.5 * (curvature_1_mm[k] + curvature_1_mm[k - 1])
            state = state + (mean - state) * follow[k - 1, :, None]
            frame, chord = _turned(frame, state * lengths[k - 1, :, None])
            here = here + chord * lengths[k - 1, :, None]
        positions[k], frames[k] = here, frame
    return Course(positions, frames[:, :, 1], frames[:, :, 2])


def _turned(frame: Array, bend_rad: Array) -> tuple[Array, Array]:
    """The frames (R, 3, 3; rows t, e1, e2) after a bend (R, 2), and the mean tangent of the arc (R, 3)."""
    angle = np.sqrt(np.sum(bend_rad**2, axis=1))
    share = bend_rad / np.maximum(angle, 1e-300)[:, None]
    tangent, normals = frame[:, 0], frame[:, 1:]
    toward = np.einsum("ri,rix->rx", share, normals)
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    ahead, aside = np.sinc(angle / np.pi), np.sin(angle / 2) * np.sinc(angle / 2 / np.pi)
    chord = ahead[:, None] * tangent + aside[:, None] * toward
    turned = np.empty_like(frame)
    turned[:, 0] = cosine * tangent + sine * toward
    change = (cosine - 1.0) * toward - sine * tangent
    turned[:, 1:] = normals + share[:, :, None] * change[:, None]
    return turned, chord
