"""All models of chapter 3 fitted to the data of one generator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.identification.shaft_models import candidates
from needleplan.models import Fit, Model, fit, simulate
from needleplan.models.friction import steady
from needleplan.signals import Record
from needleplan_thesis.chapter3.generator import Generator, periodic
from needleplan_thesis.chapter3.published import CASES, Errors

__all__ = ["CaseFits", "errors_mn", "fit_case", "fit_cases"]

_EVALUATIONS = 100
"""Enough for all but the static model, which walks along a valley of the same error for as long as it may."""

_KINDS = ("Karnopp", "I", "II", "III-B")


@dataclass(frozen=True)
class CaseFits:
    """The fits of one case: by model for the best lambda (`fits`), and of III-B by lambda (`exponents`)."""

    case: int
    generator: Generator
    record: Record
    fits: dict[str, Fit]
    exponents: dict[float, Fit]

    @property
    def exponent(self) -> float:
        """Lambda with the smallest error."""
        return min(self.exponents, key=lambda each: self.exponents[each].rmse)

    def errors(self, label: str) -> Errors:
        """Return the RMSE of a model after the first cycle."""
        return errors_mn(self.fits[label].model, self.record)


def errors_mn(model: Model, record: Record) -> Errors:
    """Return the RMSE (mN) after the first cycle: in total, below and above half of the top speed."""
    motion = record.motion()
    counts = steady(record)
    squared = 1e6 * (record["force_n"] - simulate(model, motion).output) ** 2
    speed = np.abs(motion.velocity_mm_s)
    slow = speed <= speed.max() / 2
    return Errors(*(float(np.sqrt(squared[part].mean())) for part in (counts, counts & slow, counts & ~slow)))


def fit_case(case: int, generator: Generator, rate_hz: float, exponents: Sequence[float], seed: int) -> CaseFits:
    """Make the data of a case, and fit Karnopp, I, II and III-B with each lambda after the first cycle."""
    record = periodic(case, generator, rate_hz, seed)
    found = {
        each.label: fit(each.model, record, free=each.free, mask=steady, max_evaluations=_EVALUATIONS)
        for each in candidates([record], exponents, models=_KINDS)
    }
    of_exponents = {each: found[f"III-B, lambda {each:g}"] for each in exponents}
    best = min(of_exponents.values(), key=lambda each: each.rmse)
    fits = {label: found[label] for label in _KINDS[:3]} | {"III-B": best}
    return CaseFits(case, generator, record, fits, of_exponents)


def fit_cases(
    generator: Generator, rate_hz: float, exponents: Sequence[float], note: Callable[[str], None], seed: int = 0
) -> list[CaseFits]:
    """Fit all cases of Table 3.1."""
    note(f"friction: data from {generator}")
    return [fit_case(case, generator, rate_hz, exponents, seed + case) for case in CASES]
