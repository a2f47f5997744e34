"""Synthetic data of chapter 3, and all models fitted to them.

The data are the output of a model with the printed parameters, plus white noise. A `Generator` names the model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from needleplan.identification.friction_candidates import candidates
from needleplan.models import Fit, Model, fit, simulate
from needleplan.models.friction import Beta, Profile, distributed, steady
from needleplan.signals import Array, Motion, Record
from needleplan_thesis.chapter3.published import CASES, Errors, model_ii, model_iii_b, passing_through

__all__ = [
    "NOISE_N",
    "CaseFits",
    "Generator",
    "errors_mn",
    "fit_case",
    "fit_cases",
    "generated",
    "periodic",
    "recorded",
]

NOISE_N = 0.015
"""Standard deviation of the noise (N): about the smallest published error."""


class Generator(StrEnum):
    """Model that generates the data of a periodic motion through the phantom."""

    III_B = "III-B (beta v, lambda 5, Table 3.4)"
    ABSOLUTE = "III-B (beta |v|, lambda 5, Table 3.4)"
    II = "II (Table 3.3)"
    DISTRIBUTED = "distributed model by characteristics (isosceles trapezoid, Table 3.3)"


def generated(case: int, generator: Generator, motion: Motion) -> Array:
    """Return the friction (N) that `generator` gives for a case and a motion, without noise, shape (samples,)."""
    if generator is Generator.DISTRIBUTED:
        return distributed(model_ii(case), motion, Profile.ISOSCELES)
    if generator is Generator.II:
        return simulate(model_ii(case), motion).output
    beta = Beta.ABSOLUTE if generator is Generator.ABSOLUTE else Beta.TRANSPORT
    model = model_iii_b(case)
    return simulate(type(model)(**{**vars(model), "beta": beta}), motion).output


def recorded(motion: Motion, force_n: Array, seed: int, noise_n: float = NOISE_N) -> Record:
    """Return a record of `force_n` plus white noise."""
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
    """Simulate four cycles of a case of Table 3.1 with noise, and return the record."""
    motion = passing_through(case, rate_hz=rate_hz)
    return recorded(motion, generated(case, generator, motion), seed)


_EVALUATIONS = 100
"""Evaluation limit of a fit. Only the static model reaches it: many parameter sets give almost the same error."""

_KINDS = ("Karnopp", "I", "II", "III-B")


@dataclass(frozen=True)
class CaseFits:
    """The fits of one case.

    `fits` holds one fit for each model, by label; Model III-B has its best lambda. `exponents` holds the fits of Model
    III-B by lambda.
    """

    case: int
    generator: Generator
    record: Record
    fits: dict[str, Fit]
    exponents: dict[float, Fit]

    @property
    def exponent(self) -> float:
        """The lambda of Model III-B with the smallest RMSE."""
        return min(self.exponents, key=lambda each: self.exponents[each].rmse)

    def errors(self, label: str) -> Errors:
        """Return the RMSE (mN), after the first cycle, of the fitted model with this label."""
        return errors_mn(self.fits[label].model, self.record)


def errors_mn(model: Model, record: Record) -> Errors:
    """Return the RMSE (mN) after the first cycle: at all speeds, up to half of the top speed, and above it."""
    motion = record.motion()
    counts = steady(record)
    squared = 1e6 * (record["force_n"] - simulate(model, motion).output) ** 2
    speed = np.abs(motion.velocity_mm_s)
    slow = speed <= speed.max() / 2
    return Errors(*(float(np.sqrt(squared[part].mean())) for part in (counts, counts & slow, counts & ~slow)))


def fit_case(case: int, generator: Generator, rate_hz: float, exponents: Sequence[float], seed: int) -> CaseFits:
    """Simulate the data of a case and fit all models to the samples after the first cycle: Karnopp, I, II and III-B.

    Model III-B is fitted with each lambda in `exponents`.
    """
    record = periodic(case, generator, rate_hz, seed)
    found = {
        candidate.label: fit(candidate.model, record, free=candidate.free, mask=steady, max_evaluations=_EVALUATIONS)
        for candidate in candidates([record], exponents, models=_KINDS)
    }
    of_exponents = {each: found[f"III-B, lambda {each:g}"] for each in exponents}
    best = min(of_exponents.values(), key=lambda each: each.rmse)
    fits = {label: found[label] for label in _KINDS[:3]} | {"III-B": best}
    return CaseFits(case, generator, record, fits, of_exponents)


def fit_cases(
    generator: Generator, rate_hz: float, exponents: Sequence[float], note: Callable[[str], None], seed: int = 0
) -> list[CaseFits]:
    """Simulate and fit all cases of Table 3.1, and return the fits. The seed of a case is `seed` plus its number."""
    note(f"friction: data from {generator}")
    return [fit_case(case, generator, rate_hz, exponents, seed + case) for case in CASES]
