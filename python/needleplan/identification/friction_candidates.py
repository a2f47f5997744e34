"""The friction models that a record is fitted with, and how they compare."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from needleplan.models import Fit, fit, simulate
from needleplan.models.friction import AveragedLuGre, Friction, Karnopp, LumpedLuGre, Profile, QuasiStatic, first_guess
from needleplan.signals import Array, Record, cycles

__all__ = ["EXPONENTS", "Candidate", "Mask", "Score", "candidates", "effective_samples", "fit_all", "rmse_n", "split"]

EXPONENTS = (0.5, 1.5, 2.5, 5.0)
"""The values of lambda that the thesis tried."""

_VARYING_MM = 1.0
"""Change of the inserted length from which on models that follow it are worth a fit."""

Mask = Callable[[Record], Any]


@dataclass(frozen=True)
class Candidate:
    """A model to begin with, and the parameters that are fitted."""

    label: str
    model: Friction
    free: tuple[str, ...]


@dataclass(frozen=True)
class Score:
    """A fitted candidate: RMSE on what it was fitted to and on what was held out (N), and Schwarz' criterion.

    `bic` counts effective samples (`effective_samples`); only its differences mean something.
    """

    candidate: Candidate
    fit: Fit
    held_out_rmse_n: float
    bic: float


def candidates(
    records: Sequence[Record],
    exponents: Sequence[float] = EXPONENTS,
    *,
    models: Sequence[str] = (),
    **patch: float,
) -> list[Candidate]:
    """Return what is worth fitting: Karnopp, I, II, III-B for each lambda; II with Fn(L) and III-A where L varies.

    `patch` sets constants by name, such as thickness_mm; `models` keeps only those kinds ("II", "III-B"). sigma0 of
    Model I stays where it is: a patch of many g/sigma0 says nothing about it. Raises DataError for records without
    motion or force.
    """
    guess: dict[str, Any] = dict(first_guess(records))
    static = {name: value for name, value in guess.items() if name != "sigma1"}
    base: dict[str, Any] = dict(patch)
    karnopp = Karnopp(mu_c=guess["mu_c"], sigma2=guess["sigma2"], **base)
    lengths = np.concatenate([karnopp.inserted_mm(record.motion()) for record in records])
    varies = float(np.ptp(lengths)) > _VARYING_MM
    surface = ("sigma2", "mu_c", "mu_s", "alpha")
    bristles = ("sigma0", "sigma1", *surface)
    found = [
        Candidate("Karnopp", karnopp, ("mu_c", "sigma2")),
        Candidate("I", QuasiStatic(**static, **base), surface),
        Candidate("II", LumpedLuGre(**guess, **base), bristles),
    ]
    if varies:
        found.append(Candidate("II, Fn(L)", LumpedLuGre(**guess, **base, profile=Profile.ISOSCELES), bristles))
    for exponent in exponents:
        shapes = [("III-A", Profile.RIGHT)] if varies else []
        for label, profile in [*shapes, ("III-B", Profile.ISOSCELES)]:
            averaged = AveragedLuGre(**guess, **base, profile=profile, exponent=exponent)
            found.append(Candidate(f"{label}, lambda {exponent:g}", averaged, bristles))
    return [each for each in found if not models or each.label.split(", lambda")[0] in models]


def fit_all(
    chosen: Sequence[Candidate],
    train: Sequence[Record],
    mask: Mask,
    held_out: Sequence[Record],
    held_mask: Mask,
    smooth: Callable[[Array], Array] | None = None,
) -> list[Score]:
    """Fit every candidate to `train`, score it on `held_out`, best criterion first; `smooth` is done to each output."""
    fits = [fit(each.model, train, free=each.free, mask=mask, smooth=smooth) for each in chosen]
    best = min(fits, key=lambda each: each.rmse)
    count = effective_samples(best.residuals)
    scores = [
        Score(each, found, rmse_n(found.model, held_out, held_mask, smooth), _bic(found, count))
        for each, found in zip(chosen, fits, strict=True)
    ]
    return sorted(scores, key=lambda each: each.bic)


def _bic(found: Fit, count: float) -> float:
    return count * math.log(max(found.rmse, 1e-12) ** 2) + len(found.free) * math.log(count)


def effective_samples(residuals: Sequence[Array]) -> float:
    """Return how many independent samples the residuals are worth: n / (1 + 2 sum of their autocorrelations).

    The sum goes to the first one below zero (Geyer's initial positive sequence, one lag at a time). Masked samples are
    NaN.
    """
    worth = 0.0
    for residual in residuals:
        known = residual[np.isfinite(residual)]
        if known.size < 2 or not known.any():
            worth += known.size
            continue
        size = 1 << (2 * known.size - 1).bit_length()
        power = np.abs(np.fft.rfft(known, size)) ** 2
        correlation = np.fft.irfft(power, size)[: known.size]
        correlation = correlation / correlation[0]
        negative = np.flatnonzero(correlation < 0)
        last = int(negative[0]) if negative.size else known.size
        worth += known.size / (1 + 2 * float(correlation[1:last].sum()))
    return max(worth, 2.0)


def rmse_n(model: Any, records: Sequence[Record], mask: Mask, smooth: Callable[[Array], Array] | None = None) -> float:
    """Return the RMSE (N) of a model over the masked samples of records; NaN without any."""
    errors = []
    for record in records:
        output = simulate(model, record.motion()).output
        error = record["force_n"] - (smooth(output) if smooth else output)
        errors.append(error[mask(record) & np.isfinite(error)])
    together = np.concatenate(errors) if errors else np.zeros(0)
    return float(np.sqrt(np.mean(together**2))) if together.size else math.nan


def _last_cycle(record: Record, last: bool, mask: Mask) -> Array:
    """Return the masked samples of the last cycle, or those before it."""
    passed = cycles(record.motion())
    return np.asarray(mask(record) & ((passed == passed.max()) == last))


def split(mask: Mask) -> tuple[Mask, Mask]:
    """Return masks for all but the last cycle, and for the last one."""
    return partial(_last_cycle, last=False, mask=mask), partial(_last_cycle, last=True, mask=mask)
