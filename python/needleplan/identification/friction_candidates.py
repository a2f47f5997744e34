"""Candidates of the friction model: their fits, held-out errors and Schwarz' criterion (BIC)."""

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

# Values of lambda in the thesis.
EXPONENTS = (0.5, 1.5, 2.5, 5.0)

# Range (mm) of the inserted length above which models that depend on it are fitted.
_VARYING_MM = 1.0

Mask = Callable[[Record], Any]


@dataclass(frozen=True)
class Candidate:
    """An initial model and the names of its fitted parameters."""

    label: str
    model: Friction
    free: tuple[str, ...]


@dataclass(frozen=True)
class Score:
    """A fitted candidate with its held-out RMSE (N) and Schwarz' criterion.

    `bic` uses the number of effective samples (`effective_samples`); only differences between candidates are
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
    """Return the candidates: Karnopp, I, II, and III-B for each lambda; "II, Fn(L)" and III-A if the length varies.

    `patch` sets constants of the models by name, such as thickness_mm. `models` restricts the labels. sigma0 of Model I
    is fixed, because a contact length of many g/sigma0 does not determine it. Raises DataError for records without
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
    """Return all candidates fitted to `train` and scored on `held_out`, by increasing BIC; `smooth` filters outputs."""
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
    """Return the effective number of independent samples, n / (1 + 2 sum of the autocorrelations of the residuals).

    The sum ends before the first negative autocorrelation (Geyer's initial positive sequence, one lag at a time).
    Masked samples are NaN.
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
    """Return the RMSE (N) of a model over the samples that `mask` selects; NaN if there are none."""
    errors = []
    for record in records:
        output = simulate(model, record.motion()).output
        error = record["force_n"] - (smooth(output) if smooth else output)
        errors.append(error[mask(record) & np.isfinite(error)])
    together = np.concatenate(errors) if errors else np.zeros(0)
    return float(np.sqrt(np.mean(together**2))) if together.size else math.nan


def _last_cycle(record: Record, last: bool, mask: Mask) -> Array:
    """Return the selected samples of the last cycle, or of the cycles before it."""
    passed = cycles(record.motion())
    return np.asarray(mask(record) & ((passed == passed.max()) == last))


def split(mask: Mask) -> tuple[Mask, Mask]:
    """Return one mask for all cycles but the last, and one for the last cycle."""
    return partial(_last_cycle, last=False, mask=mask), partial(_last_cycle, last=True, mask=mask)
