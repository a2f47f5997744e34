"""Where the data of chapter 3 come from: stated models with the printed parameters, and white noise."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from needleplan.models import simulate
from needleplan.models.friction import Beta, Profile, distributed
from needleplan.signals import Array, Motion, Record
from needleplan_thesis.chapter3.published import model_ii, model_iii_b, passing_through

__all__ = ["NOISE_N", "Generator", "generated", "periodic", "recorded"]

NOISE_N = 0.015
"""Standard deviation of the noise, of the size of the smallest published errors."""


class Generator(StrEnum):
    """What makes the data of a periodic motion through the phantom."""

    III_B = "III-B (beta v, lambda 5, Table 3.4)"
    ABSOLUTE = "III-B (beta |v|, lambda 5, Table 3.4)"
    II = "II (Table 3.3)"
    DISTRIBUTED = "distributed model by characteristics (isosceles trapezoid, Table 3.3)"


def generated(case: int, generator: Generator, motion: Motion) -> Array:
    """Return the friction (N) without noise, shape (samples,)."""
    if generator is Generator.DISTRIBUTED:
        return distributed(model_ii(case), motion, Profile.ISOSCELES)
    if generator is Generator.II:
        return simulate(model_ii(case), motion).output
    beta = Beta.ABSOLUTE if generator is Generator.ABSOLUTE else Beta.TRANSPORT
    model = model_iii_b(case)
    return simulate(type(model)(**{**vars(model), "beta": beta}), motion).output


def recorded(motion: Motion, force_n: Array, seed: int, noise_n: float = NOISE_N) -> Record:
    """Return a trial with that force and white noise."""
    noise = noise_n * np.random.default_rng(seed).standard_normal(len(motion))
    return Record(
        {
            "time_s": motion.time_s,
            "depth_mm": motion.depth_mm,
            "velocity_mm_s": motion.velocity_mm_s,
            "force_n": force_n + noise,
        }
    )


def periodic(case: int, generator: Generator, rate_hz: float, seed: int) -> Record:
    """Return four cycles of a case of Table 3.1."""
    motion = passing_through(case, rate_hz=rate_hz)
    return recorded(motion, generated(case, generator, motion), seed)
