"""Whether what was named in some motions also holds in another one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needleplan.diagnosis.calibrate import Calibration, Case, fit_case, with_measured
from needleplan.diagnosis.refit import Joint, cases_with
from needleplan.diagnosis.space import Block, Space
from needleplan.models import ljung_box
from needleplan.signals import Array

__all__ = ["Verified", "verify"]

_STRENGTH = 0.03
"""Standard deviation of the variance of the noise, as known from a record of a minute."""


@dataclass(frozen=True)
class Verified:
    """Held-out trials, with the base calibrated anew and the effects held at their values."""

    promised: float
    """Gain that the effects promise there (twice the log likelihood)."""

    kept: float
    """Gain that they bring."""

    gain: float
    """Twice the log likelihood over the base alone, where base and effects each take the tissue that suits them."""

    before_rms: float
    after_rms: float
    floor_rms: float
    """RMS of what is left, with the base alone and with the effects, and of the noise."""

    shrink: float
    """Part of the energy above the floor that is gone; NaN where there was none."""

    gap_sds: float
    """Energy above the floor before, in standard deviations of what noise leaves, its strength not being known."""

    whiteness_before: float
    whiteness_after: float
    """p-values of Ljung and Box's test of the whitened residuals."""

    @property
    def transfer(self) -> float:
        """Kept over promised: 1 for a true effect."""
        return self.kept / self.promised if self.promised > 0 else float("nan")


def verify(joint: Joint, calibration: Calibration) -> Verified | None:
    """Judge effects on the held-out trials; None where there is none."""
    before = calibration.held_out
    if not before:
        return None
    after = cases_with(joint.added, calibration, before)
    level = joint.space.best
    last = Space([case.block for case in after])
    # With and without the effects, the tissue varies by as much: in a base that imitates an effect by cutting twice as
    # hard, it would hide what is missing.
    first = Space([_varied(case, like) for case, like in zip(before, after, strict=True)])
    # What the base alone would leave of these trials, were they exactly as base and effects say.
    channel = calibration.model.channel
    exact = [
        fit_case(
            case.model, with_measured(case.record, channel, _seen(case, each.predicted)),
            calibration.noise, calibration.free, start_lag_s=case.lag_s, about=calibration.given,
        )
        for case, each in zip(before, after, strict=True)
    ]  # fmt: skip
    without = Space([_varied(case, like) for case, like in zip(exact, after, strict=True)])
    promised = max(without.energy(level) - _pull(after), 0.0)
    kept = first.energy(level) - last.energy(level)
    floor = float(sum(case.block.samples - case.block.sensitivities.shape[1] for case in before))
    gap = first.energy(level) - floor
    return Verified(
        promised,
        kept,
        2 * float(last.evidence.max() - Space([case.block for case in before]).evidence.max()),
        _rms(before),
        _rms(after),
        calibration.noise.rms,
        min(kept / gap, 1.0) if gap > 0 else float("nan"),
        gap / (2 * floor + (_STRENGTH * floor) ** 2) ** 0.5,
        _whiteness(before),
        _whiteness(after),
    )


def _varied(case: Case, like: Case) -> Block:
    """Return a trial in which the tissue varies as in another one of the same motion."""
    return replace(case.block, modes=like.block.modes, variances=like.block.variances)


def _seen(case: Case, values: Array) -> Array:
    """Return values where there was a measurement, NaN elsewhere."""
    return np.where(np.isfinite(case.measured), values, np.nan)


def _pull(cases: Sequence[Case]) -> float:
    """Return what the parameters, as they are with the effects, are away from what was believed of them."""
    return float(sum((case.block.residual[int(case.rows.sum()) :] ** 2).sum() for case in cases))


def _rms(cases: Sequence[Case]) -> float:
    left: Array = np.concatenate([case.measured - case.predicted for case in cases])
    return float(np.sqrt(np.nanmean(left**2)))


def _whiteness(cases: Sequence[Case]) -> float:
    return ljung_box([case.block.residual[: int(case.rows.sum())] for case in cases])[1]
