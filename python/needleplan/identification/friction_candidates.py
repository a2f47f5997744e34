"""Candidates of the friction model: their fits, held-out errors and Schwarz' criterion (BIC)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.models import Fit, Model, fit, simulate
from needleplan.models.friction import (
    AveragedLuGre,
    DirectionalKarnopp,
    Karnopp,
    LumpedLuGre,
    Profile,
    QuasiStatic,
    first_guess,
)
from needleplan.signals import Array, Record, cycles

__all__ = ["EXPONENTS", "Candidate", "Mask", "Score", "candidates", "effective_samples", "fit_all", "rmse_n", "split"]

# Default values of lambda, the exponent of the models III: those of the thesis.
EXPONENTS = (0.5, 1.5, 2.5, 5.0)

# Range (mm) of the inserted length above which the models "II, Fn(L)" and III-A are candidates.
_VARYING_MM = 1.0

# Friction (N) above which the normal force is not 1 N.
_LARGE_N = 10.0

Mask = Callable[[Record], Any]


@dataclass(frozen=True)
class Candidate(CallRepr):
    """A model with initial parameters, and the names of the parameters that are fitted."""

    label: str
    model: Model
    free: tuple[str, ...]


@dataclass(frozen=True)
class Score(CallRepr):
    """A fitted candidate with its RMSE (N) on held-out samples and Schwarz' criterion `bic`.

    `bic` uses the effective number of samples (`effective_samples`). Only differences of `bic` between candidates are
    meaningful.
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
    """Return the candidate models with initial parameters estimated from the records.

    The candidates are Karnopp, Karnopp by direction, I, II and, for each value of lambda in `exponents`, III-B. If the
    inserted length varies by more than 1 mm, "II, Fn(L)" and, for each lambda, III-A are added. If `models` is not
    empty, only candidates are returned whose label without lambda is in `models`. `patch` sets constants of all models
    by name, such as thickness_mm. The normal force is 1 N; if the friction is above 10 N, it is the power of ten below
    the friction, so that coefficients stay within their ranges. sigma0 of Model I is not fitted, because the data
    hardly depend on it if the contact length is many times g/sigma0. Raises DataError for records without motion or
    force.
    """
    guess: dict[str, Any] = dict(first_guess(records))
    normal_n = 10.0 ** math.floor(math.log10(guess["mu_c"])) if guess["mu_c"] > _LARGE_N else 1.0
    guess |= {name: guess[name] / normal_n for name in guess if name != "alpha"}
    static = {name: value for name, value in guess.items() if name != "sigma1"}
    base: dict[str, Any] = {"normal_force_n": normal_n} | patch
    karnopp = Karnopp(mu_c=guess["mu_c"], sigma2=guess["sigma2"], **base)
    same: dict[str, Any] = {"mu_c": karnopp.mu_c, "sigma2": karnopp.sigma2}
    directional = DirectionalKarnopp(**base, **same, **{f"{name}_out": value for name, value in same.items()})
    lengths = np.concatenate([karnopp.inserted_mm(record.motion()) for record in records])
    varies = float(np.ptp(lengths)) > _VARYING_MM
    surface = ("sigma2", "mu_c", "mu_s", "alpha")
    bristles = ("sigma0", "sigma1", *surface)
    listed = [
        Candidate("Karnopp", karnopp, ("mu_c", "sigma2")),
        Candidate("Karnopp by direction", directional, ("mu_c", "sigma2", "mu_c_out", "sigma2_out")),
        Candidate("I", QuasiStatic(**static, **base), surface),
        Candidate("II", LumpedLuGre(**guess, **base), bristles),
    ]
    if varies:
        listed.append(Candidate("II, Fn(L)", LumpedLuGre(**guess, **base, profile=Profile.ISOSCELES), bristles))
    for exponent in exponents:
        shapes = [("III-A", Profile.RIGHT)] if varies else []
        for label, profile in [*shapes, ("III-B", Profile.ISOSCELES)]:
            averaged = AveragedLuGre(**guess, **base, profile=profile, exponent=exponent)
            listed.append(Candidate(f"{label}, lambda {exponent:g}", averaged, bristles))
    return [candidate for candidate in listed if not models or candidate.label.split(", lambda")[0] in models]


def fit_all(
    chosen: Sequence[Candidate],
    train: Sequence[Record],
    mask: Mask,
    held_out: Sequence[Record],
    held_mask: Mask,
    smooth: Callable[[Array], Array] | None = None,
) -> list[Score]:
    """Fit all candidates to `train`, compute their RMSE on `held_out`, and return the scores by increasing BIC.

    `mask` selects the samples of `train`, `held_mask` those of `held_out`. `smooth` filters the outputs of the models.
    """
    fits = [fit(candidate.model, train, free=candidate.free, mask=mask, smooth=smooth) for candidate in chosen]
    best = min(fits, key=lambda candidate_fit: candidate_fit.rmse)
    count = effective_samples(best.residuals)
    scores = [
        Score(
            candidate,
            candidate_fit,
            rmse_n(candidate_fit.model, held_out, held_mask, smooth),
            _bic(candidate_fit, count),
        )
        for candidate, candidate_fit in zip(chosen, fits, strict=True)
    ]
    return sorted(scores, key=lambda score: score.bic)


def _bic(result: Fit, count: float) -> float:
    return count * math.log(max(result.rmse, 1e-12) ** 2) + len(result.free) * math.log(count)


def effective_samples(residuals: Sequence[Array]) -> float:
    """Return the effective number of independent samples, summed over the records and at least 2.

    A record with n samples counts n / (1 + 2 c), where c is the sum of the autocorrelations of its residuals from lag 1
    to the last before the first negative one (Geyer's initial positive sequence, one lag at a time). A record with one
    sample or with residuals of zero only counts n. NaN marks masked samples, which are left out.
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
    """Return the RMSE (N) of the simulated force over the samples that `mask` selects; NaN if it selects none.

    `smooth` filters the simulated force.
    """
    errors = []
    for record in records:
        output = simulate(model, record.motion()).output
        error = record["force_n"] - (smooth(output) if smooth else output)
        errors.append(error[mask(record) & np.isfinite(error)])
    together = np.concatenate(errors) if errors else np.zeros(0)
    return float(np.sqrt(np.mean(together**2))) if together.size else math.nan


def _last_cycle(record: Record, last: bool, mask: Mask) -> Array:
    """Return a mask of the samples that `mask` selects in the last cycle if `last`, else in all earlier cycles."""
    passed = cycles(record.motion())
    return np.asarray(mask(record) & ((passed == passed.max()) == last))


def split(mask: Mask) -> tuple[Mask, Mask]:
    """Split `mask` into two: one that selects its samples in all cycles but the last, and one for the last cycle."""
    return partial(_last_cycle, last=False, mask=mask), partial(_last_cycle, last=True, mask=mask)
