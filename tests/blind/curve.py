"""The path of a needle's tip in 3D, by its parallel-transported frame.

The tip's tangent t and two normals e1, e2 that never twist about it turn by the curvature K = (K1, K2) per length:
dt/ds = K1 e1 + K2 e2, de_i/ds = -K_i t. Each step is the exact arc of its K.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tests.blind.motions import Array

CURVATURE_1_MM = 1.0 / 250.0
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
    """The course for wanted curvatures (T, R, 2) in e1 and e2, entering with tilt_rad (2,) toward y and z.

    The frame after k steps is the product of k bends, each given in the frame before it; all products are made together
    by doubling the number of factors.
    """
    lengths = np.diff(depth_mm, axis=0)[..., None]
    bends = 0.5 * (curvature_1_mm[1:] + curvature_1_mm[:-1]) * lengths
    entry = np.broadcast_to(tilt_rad, (1, *bends.shape[1:]))
    turns, chords = _arcs(np.concatenate([entry, bends]))
    done = 1
    while done < len(turns):
        turns[done:] = turns[done:] @ turns[:-done]
        done *= 2
    steps = np.einsum("tri,trix->trx", chords[1:], turns[:-1]) * lengths
    position = np.concatenate([np.zeros_like(steps[:1]), np.cumsum(steps, axis=0)])
    return Course(position, turns[..., 1, :], turns[..., 2, :])


def _arcs(bend_rad: Array) -> tuple[Array, Array]:
    """Of bends (..., 2): the frame after (..., 3, 3; rows t, e1, e2) and the mean tangent, both in the frame before."""
    angle = np.sqrt(np.sum(bend_rad**2, axis=-1))
    toward = bend_rad / np.maximum(angle, 1e-300)[..., None]
    cosine, sine = np.cos(angle)[..., None], np.sin(angle)[..., None]
    frame = np.zeros((*angle.shape, 3, 3))
    frame[..., 0, :1], frame[..., 0, 1:] = cosine, sine * toward
    frame[..., 1:, 0] = -sine * toward
    frame[..., 1:, 1:] = np.eye(2) + (cosine[..., None] - 1.0) * toward[..., :, None] * toward[..., None, :]
    ahead, aside = np.sinc(angle / np.pi), np.sin(angle / 2) * np.sinc(angle / 2 / np.pi)
    return frame, np.concatenate([ahead[..., None], aside[..., None] * toward], axis=-1)
