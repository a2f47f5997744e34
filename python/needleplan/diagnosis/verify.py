"""Whether what was named in some motions also holds in another one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needleplan.diagnosis.calibrate import Calibration, Case, fit_case, with_measured
from needleplan.diagnosis.refit import Joint, cases_with, whole_model
from needleplan.diagnosis.space import Block, Space
from needleplan.models import Model, ljung_box
from needleplan.signals import Array

__all__ = ["Verified", "verify"]

_STRENGTH = 0.03
"""Standard deviation of the variance of the noise, as known from a record of a minute."""


@dataclass(frozen=True)
class Verified:
    """Held-out trials, with the base calibrated anew and the effects held at their values.

    "Before" is the base alone, or with the effects that were there before.
    """

    promised: float
    """Gain that the effects promise there over what was before (twice the log likelihood)."""

    kept: float
    """Gain that they bring."""

    gain: float
    """Twice the log likelihood over what was before, where each takes the tissue that suits it."""

    before_rms: float
    after_rms: float
    floor_rms: float
    """RMS of what is left, before and with the effects, and of the noise."""

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


def verify(joint: Joint, calibration: Calibration, before: Joint | None = None) -> Verified | None:
    """Judge effects on the held-out trials, beside those of `before` or the base alone; None where there is none."""
    if not calibration.held_out:
        return None
    held = before.added if before else ()

    def with_held(model: Model) -> Model:
        return whole_model(held, model)

    earlier = cases_with(held, calibration, calibration.held_out) if held else calibration.held_out
    after = cases_with(joint.added, calibration, earlier)
    level = joint.space.best
    last = Space([case.block for case in after])
    # With and without the effects, the tissue varies by as much: in a base that imitates an effect by cutting twice as
    # hard, it would hide what is missing.
    first = Space([_varied(case, like) for case, like in zip(earlier, after, strict=True)])
    # What was before would leave this of these trials, were they exactly as base and effects say.
    channel = calibration.model.channel
    exact = [
        fit_case(
            case.model, with_measured(case.record, channel, _seen(case, each.predicted)),
            calibration.noise, calibration.free, whole=with_held, start_lag_s=case.lag_s, about=calibration.given,
        )
        for case, each in zip(earlier, after, strict=True)
    ]  # fmt: skip
    without = Space([_varied(case, like) for case, like in zip(exact, after, strict=True)])
    promised = max(without.energy(level) - _pull(after), 0.0)
    kept = first.energy(level) - last.energy(level)
    floor = float(sum(case.block.samples - case.block.sensitivities.shape[1] for case in earlier))
    gap = first.energy(level) - floor
    return Verified(
        promised,
        kept,
        2 * float(last.evidence.max() - Space([case.block for case in earlier]).evidence.max()),
        _rms(earlier),
        _rms(after),
        calibration.noise.rms,
        min(kept / gap, 1.0) if gap > 0 else float("nan"),
        gap / (2 * floor + (_STRENGTH * floor) ** 2) ** 0.5,
        _whiteness(earlier),
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
