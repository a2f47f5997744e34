"""The motion that lowers the detection limits, if no gap was found but a relevant effect may be hidden.

The information of the recordings on an amplitude is proportional to 1 / limit^2, where limit is the detection limit.
The information of several trials adds up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis._diagnosis import Diagnosis
from needleplan.diagnosis.calibration import CalibratedTrial
from needleplan.diagnosis.catalogue import DETECTION_NONCENTRALITY, DetectionLimit
from needleplan.diagnosis.likelihood import JointLikelihood
from needleplan.diagnosis.next_motion._programs import NextMotion, Tried, predicted_trial
from needleplan.models.effects import SIZE, Effect
from needleplan.signals import Array, Role

__all__ = ["Revealed", "Revealing", "revealing"]

# Ratio of new to present detection limit below which a further improvement does not count.
_LEAST = 0.01


@dataclass(frozen=True)
class Revealed:
    """Detection limit of one effect: at present (`now`), and with one more trial of the motion (`after`)."""

    effect: str
    unit: str
    now: float | None
    """Present limit; None if the limit exceeds the effect's bound or the base model absorbs the effect."""

    after: float
    repeated: float | None
    """Limit if the last training motion were repeated instead; None if the effect would stay invisible."""


@dataclass(frozen=True)
class Revealing(NextMotion):
    """The motion that lowers the detection limits most, in the geometric mean of the effects that may be hidden."""

    effects: tuple[Revealed, ...]
    """Effects that may be hidden, the most improved first."""

    shrinks_to: float
    """Geometric mean of the ratios of new to present detection limits."""

    repeated_shrinks_to: float
    """As `shrinks_to`, if the last training motion were repeated instead."""

    considered: tuple[tuple[str, float], ...]
    """Name and geometric mean ratio of each program, as `shrinks_to`."""

    @property
    def why(self) -> str:
        """Reason for the motion, in words."""
        best = self.effects[0]
        now = "undetectable" if best.now is None else f"{best.now:.3g} {best.unit}"
        return (
            f"On average, this motion lowers the detection limits to {self.shrinks_to:.0%} of their present "
            f"values; the last motion, repeated, would lower them to {self.repeated_shrinks_to:.0%}. The largest "
            f"improvement is {best.effect}: from {now} to {best.after:.3g} {best.unit}."
        )


def revealing(found: Diagnosis, tried: Sequence[Tried], role: Role) -> Revealing | None:
    """Return the motion that lowers the detection limits most; None if no motion lowers any of them."""
    hidden = [each for each in found.detection_limits if not each.visible or each.noise_multiple > found.gates.relevant]
    hidden = hidden or list(found.detection_limits)
    effects = {each.effect.name: each.effect for each in found.selection.rounds[0].screened}
    hidden = [each for each in hidden if each.effect in effects]
    largest = np.array([_largest(effects[each.effect]) for each in hidden])
    # An effect whose limit exceeds its bound is invisible.
    amplitudes = np.array([each.amplitude if each.visible else np.inf for each in hidden])
    now = DETECTION_NONCENTRALITY / np.minimum(amplitudes, largest) ** 2
    heterogeneity_sd = np.array([found.selection.base.heterogeneity_sd])
    trials = [predicted_trial(found.calibration.model, found.calibration, motion) for _, motion in tried]
    last = found.calibration.training[-1]
    more = [
        np.array([_information(effects[each.effect], each, trial, heterogeneity_sd) for each in hidden])
        for trial in trials
    ]
    again = np.array([_information(effects[each.effect], each, last, heterogeneity_sd) for each in hidden])
    shares = [_shares(now, each) for each in more]
    if not hidden or not any((each < 1).any() for each in shares):
        return None
    means = [float(np.exp(np.log(each).mean())) for each in shares]
    best = int(np.argmin(means))
    order = [index for index in np.argsort(shares[best], kind="stable") if now[index] + more[best][index] > 0]
    revealed = tuple(
        Revealed(
            hidden[index].effect, hidden[index].unit,
            hidden[index].amplitude if amplitudes[index] <= largest[index] else None,
            _amplitude(now[index] + more[best][index]),
            _amplitude(now[index] + again[index]) if now[index] + again[index] > 0 else None,
        )
        for index in order
    )  # fmt: skip
    program, motion = tried[best]
    return Revealing(
        program, motion, role, revealed, means[best], float(np.exp(np.log(_shares(now, again)).mean())),
        tuple((each.name, value) for (each, _), value in zip(tried, means, strict=True)),
    )  # fmt: skip


def _information(effect: Effect, limit: DetectionLimit, trial: CalibratedTrial, heterogeneity_sd: Array) -> float:
    """Return the information of one trial on the amplitude of an effect at the grid point of its detection limit."""
    raw = effect.columns(trial.model, trial.motion, [dict(limit.at)])
    column = trial.lag_sensitivity[:, None] if effect.is_lag else trial.whiten(raw)
    curvature = float(JointLikelihood([trial.whitened], heterogeneity_sd).scores([column]).curvature[0, 0])
    # The remainder of a sensitivity that the base model absorbs is rounding error.
    return curvature if curvature > 1e-6 * float((column**2).sum()) else 0.0


def _largest(effect: Effect) -> float:
    what = effect.parameters[SIZE]
    return max(abs(what.lower), abs(what.upper))


def _shares(now: Array, more: Array) -> Array:
    """Return the ratios of new to present detection limits, shape (effects,).

    `now` is the present information, `more` that of the new trial. The ratio is at least 0.01, and 1 if both are zero.
    """
    total = now + more
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.where(total > 0, np.sqrt(now / total), 1.0)
    return np.asarray(np.maximum(found, _LEAST))


def _amplitude(curvature: float) -> float:
    return float(np.sqrt(DETECTION_NONCENTRALITY / curvature))
