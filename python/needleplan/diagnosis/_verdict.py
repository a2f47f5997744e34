"""The verdict of a diagnosis, and the estimates of the named effects.

The output is almost linear in an effect's amplitude, so the interval of the amplitude comes from the linearised fit.
The intervals of depths, times and speeds come from the profile likelihood: the parameter is moved and all others are
refitted, until twice the log-likelihood has dropped by 3.84.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from needleplan.diagnosis.alternatives import AlternativeModel, smooth_sensitivities, winning_alternative
from needleplan.diagnosis.calibration import UNUSUAL_LAG_FACTOR, CalibratedTrial, Calibration
from needleplan.diagnosis.catalogue import FittedEffect
from needleplan.diagnosis.channels import GapAxis, channel_description
from needleplan.diagnosis.data import CheckedData
from needleplan.diagnosis.joint_fit import (
    DIRECTION,
    TWO_SIDED_95,
    HeldOutValidation,
    JointFit,
    amplitude_interval,
    effect_sensitivities,
    effects_output,
    is_nonzero,
    is_within_bounds,
)
from needleplan.diagnosis.likelihood import Gates, JointLikelihood
from needleplan.diagnosis.selection import Selection
from needleplan.diagnosis.selection_round import RoundOutcome
from needleplan.models import Estimate, Parameter, Scale
from needleplan.models.effects import SIZE

__all__ = [
    "DiagnosisDecision",
    "Verdict",
    "decide",
    "estimate_effects",
    "limit_to_data",
    "parameter_interval",
    "reject_if_worse",
]

# Multiple of the required BIC gain above which an effect that fails validation still proves that a gap exists.
_STRONG_FACTOR = 3.0
# Sum of explained and unexplained likelihood gain below which the explained share is not computed.
_LEAST_GAP = 40.0
# Share of the held-out gap that the effects must close; with less, the verdict is UNKNOWN.
_LEAST_CLOSED = 0.1
# Largest relative difference between achieved and predicted held-out gain that counts as agreement.
_PREDICTION_TOLERANCE = 0.3
# Residual energy above the noise, in standard deviations, above which a gap in the held-out trials is certain.
_CERTAIN_SDS = 5.0
# Largest permitted ratio of the residual RMS with the effects to the RMS with the base model alone.
_WORSE_RMS_RATIO = 1.1
# Drop of twice the log-likelihood at the ends of a 95 % interval (chi-square, one degree of freedom).
_CHI2_95 = 3.84
# Two-sided 95 % quantile of the standard normal distribution.
_NORMAL_95 = 1.96
# Largest number of evaluations of the profile likelihood for one end of an interval.
_PROFILE_STEPS = 5
# Relative tolerance of the likelihood drop at an interval's end.
_PROFILE_TOLERANCE = 0.15
# Standard deviation of an amplitude, relative to the amplitude, because effects are simplified formulas.
_FORMULA_SD = 0.04
# Name of the parameter that is a depth along the path; its interval is widened by half a sampling step.
_DEPTH_PARAMETER = "depth_mm"
# Distance (mm) from a depth within which samples determine the sampling step there.
_NEARBY_MM = 1.0
# Largest half width of an interval, in the fit coordinate of any parameter; wider ones are cut to it.
_WIDEST_STEP = 50.0
# Largest half width of a profile interval, as a multiple of the linearised half width.
_FURTHEST_PROFILE = 6.0


class Verdict(StrEnum):
    """Result of a diagnosis."""

    NONE = "none"
    """There is no gap, and a relevant effect would have been detected."""

    UNDERPOWERED = "underpowered"
    """There is no gap, but the data could hide a relevant effect."""

    NAMED = "named"
    """The missing effects are known, and they close the gap on the held-out trials."""

    INCOMPLETE = "incomplete"
    """At least one missing effect is known, and part of the gap remains."""

    AMBIGUOUS = "ambiguous"
    """Several effects explain the gap equally well, or data are missing that a name requires."""

    UNKNOWN = "unknown"
    """There is a gap, and no known effect explains it."""

    IMPLAUSIBLE = "implausible"
    """The amplitude of an accepted effect is at a bound of its range."""


@dataclass(frozen=True)
class DiagnosisDecision:
    """The verdict with its reason."""

    verdict: Verdict
    named: tuple[str, ...]
    tied: tuple[str, ...]
    """Names of effects that explain the data equally well."""

    axis: GapAxis | None
    """Variable on which the unexplained gap depends; None if no gap is unexplained."""

    explained: float | None
    """Share (0 to 1) of the gap that the effects explain; None if it was not computed, as for a small gap."""

    because: str  # reason for the verdict, in words


def decide(selection: Selection, gates: Gates, *, detection_limit: float) -> DiagnosisDecision:
    """Return the verdict with its reason.

    `detection_limit` is the upper quartile of the detection limits of all visible effects, in units of the noise RMS.
    """
    last, first = selection.rounds[-1], selection.rounds[0]
    alternative = first.alternatives[0]
    if selection.joint is None:
        if last.outcome is RoundOutcome.TIE:
            if _winning(last.ranked[0], last.ranked[0].newest.bic_gain, 0.0, first.alternatives, gates):
                return _unknown(alternative.axis, "a nonparametric alternative explains more than any known effect")
            text = "these effects explain the gap alike: " + ", ".join(last.tied)
            return DiagnosisDecision(Verdict.AMBIGUOUS, (), last.tied, None, None, text)
        unsupported = (
            last.outcome is RoundOutcome.NO_TRANSFER
            and last.ranked[0].newest.bic_gain > _STRONG_FACTOR * gates.bic_gain
        )
        if alternative.bic_gain >= gates.needed(selection.base.heterogeneity_sd) or unsupported:
            if last.outcome is RoundOutcome.NO_TRANSFER and last.ranked[0].newest.bic_gain > alternative.bic_gain:
                return _unknown(
                    alternative.axis, f"{last.ranked[0].newest.name} fits best, but the held-out trials refute it"
                )
            return _unknown(alternative.axis, "a nonparametric alternative explains the gap, but no known effect does")
        if detection_limit > gates.relevant:
            return DiagnosisDecision(
                Verdict.UNDERPOWERED, (), (), None, None, "no gap, but a relevant effect may be hidden"
            )
        return DiagnosisDecision(Verdict.NONE, (), (), None, None, "no gap: the residual is noise")
    joint = selection.joint
    # One effect may occur at several places.
    names = tuple(dict.fromkeys(each.effect.name for each in selection.unambiguous))
    all_ = ", ".join(dict.fromkeys(each.effect.name for each in joint.effects))
    better = _winning(joint, selection.bic_gain, _further_held_out_gain(selection), first.alternatives, gates)
    if better:
        return _unknown(better.axis, f"{all_} fits, but a nonparametric alternative fits as well: {better.name}")
    other = selection.validation
    if other and other.gap_sds > _CERTAIN_SDS and other.shrink < gates.closed:
        text = f"{all_} fits, but closes only {max(other.shrink, 0.0):.0%} of the gap on the held-out trials"
        if not names or other.shrink < _LEAST_CLOSED or not _matches_prediction(other):
            return _unknown(alternative.axis, text)
        return DiagnosisDecision(
            Verdict.INCOMPLETE, names, last.tied, last.alternatives[0].axis, _explained(selection), text
        )
    share = _explained(selection)
    remaining = last.alternatives[0]
    for index, each in enumerate(joint.effects):
        if not is_within_bounds(joint, index):
            what = each.effect.parameters[SIZE]
            text = f"the amplitude of {each.effect.name} is at its bound, {each.values[SIZE]:.3g} {what.unit}"
            return DiagnosisDecision(Verdict.IMPLAUSIBLE, names, (), None, share, text)
    if share is not None and share < gates.explained and remaining.bic_gain > gates.bic_gain:
        return _unknown(remaining.axis, f"{all_} explains only {share:.0%} of the gap", share)
    left = remaining.bic_gain > gates.bic_gain and share is not None and share < gates.complete
    if not names:
        text = "several effects are missing, and others explain the data as well: " + ", ".join(last.tied)
        return DiagnosisDecision(Verdict.AMBIGUOUS, (), last.tied, None, share, text)
    if left or last.outcome in (RoundOutcome.TIE, RoundOutcome.NAMELESS):
        return DiagnosisDecision(
            Verdict.INCOMPLETE, names, last.tied, remaining.axis, share, "another effect is missing too"
        )
    return DiagnosisDecision(Verdict.NAMED, names, (), None, share, "passes all gates")


def _matches_prediction(other: HeldOutValidation) -> bool:
    """Return whether the achieved held-out gain agrees with the predicted gain, to 30 % or four standard deviations."""
    return bool(
        abs(other.achieved - other.predicted)
        < max(_PREDICTION_TOLERANCE * other.predicted, 4 * math.sqrt(other.predicted))
    )


def _unknown(axis: GapAxis, text: str, share: float | None = None) -> DiagnosisDecision:
    return DiagnosisDecision(Verdict.UNKNOWN, (), (), axis, share, text)


def _further_held_out_gain(selection: Selection) -> float:
    """Return the held-out gain of all effects minus that of the first effect; 0 if either was not validated."""
    best, whole = selection.rounds[0].ranked[0].validation, selection.validation
    return whole.likelihood_gain - best.likelihood_gain if whole and best else 0.0


def _winning(
    joint: JointFit, bic_gain: float, held_out_difference: float, alternatives: Sequence[AlternativeModel], gates: Gates
) -> AlternativeModel | None:
    """Return the nonparametric alternative that wins against the effects of a fit; None if no alternative wins."""
    return winning_alternative(
        alternatives,
        gates,
        likelihood_gain=joint.likelihood_gain,
        bic_gain=bic_gain,
        degrees_of_freedom=len(joint.coordinates),
        lead=gates.lead,
        held_out_difference=held_out_difference,
    )


def _explained(selection: Selection) -> float | None:
    """Return the share (0 to 1) of the gap that the effects explain; None if the gap is too small.

    The gap is the gain of the effects plus the gain of smooth functions added to them. Smooth functions alone would
    miss sudden changes such as a puncture.
    """
    assert selection.joint is not None
    joint = selection.joint
    columns = smooth_sensitivities(joint.trials)
    left = max(joint.likelihood.basis_gains(columns) - columns[0].shape[1], 0.0)
    if joint.likelihood_gain + left < _LEAST_GAP:
        return None
    return float(np.clip(joint.likelihood_gain / (joint.likelihood_gain + left), 0.0, 1.0))


def reject_if_worse(decision: DiagnosisDecision, selection: Selection, calibration: Calibration) -> DiagnosisDecision:
    """Return UNKNOWN if the named effects increase the residual RMS by more than 10 %, else the given decision."""
    if not decision.named or selection.joint is None:
        return decision
    alone, both = _residual_rms(calibration.training), _residual_rms(selection.joint.trials)
    if both <= _WORSE_RMS_RATIO * alone:
        return decision
    text = (
        f"with a heterogeneity of {selection.joint.likelihood.heterogeneity_sd:.0%} the best known effects would be "
        f"{' and '.join(decision.named)}, but the base model alone leaves a smaller residual"
    )
    return DiagnosisDecision(
        Verdict.UNKNOWN, (), (), selection.rounds[0].alternatives[0].axis, decision.explained, text
    )


def _residual_rms(trials: Sequence[CalibratedTrial]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate([trial.measured - trial.predicted for trial in trials]) ** 2)))


def limit_to_data(decision: DiagnosisDecision, checked: CheckedData) -> DiagnosisDecision:
    """Return AMBIGUOUS in place of NAMED or INCOMPLETE if data are missing (`checked.lacks`), else the decision."""
    if decision.verdict not in (Verdict.NAMED, Verdict.INCOMPLETE) or not checked.lacks:
        return decision
    fits = "fits" if len(decision.named) == 1 else "fit"
    lack = ", ".join(f"no {lack}" for lack in checked.lacks)
    text = f"{' and '.join(decision.named)} {fits} best, but these data do not support a name: {lack}"
    return DiagnosisDecision(Verdict.AMBIGUOUS, (), decision.named, decision.axis, decision.explained, text)


def estimate_effects(selection: Selection) -> tuple[FittedEffect, ...]:
    """Return the unambiguous effects of the joint fit, each with 95 % intervals, RMS and share of the gain."""
    joint = selection.joint
    if joint is None:
        return ()
    whole = sum(each.likelihood_gain for each in selection.effects)
    found = []
    for index, each in enumerate(selection.effects):
        if each.alternatives:
            continue
        estimates = {name: _parameter_estimate(joint, index, name) for name in each.values}
        rows = [effects_output([each], trial.model, trial.motion) for trial in joint.trials]
        rms = float(np.sqrt(np.mean(np.concatenate(rows) ** 2)))
        share = float(each.likelihood_gain / max(whole, 1e-12))
        found.append(replace(each, estimates=estimates, rms=rms, share=share))
    return tuple(found)


def _parameter_estimate(joint: JointFit, index: int, name: str) -> Estimate:
    """Return a parameter of effect number `index` with its standard deviation and its final 95 % interval."""
    what, value = joint.effects[index].effect.parameters[name], joint.effects[index].values[name]
    sd = joint.sd(index, name) if what.free else 0.0
    if not what.free or name in (SIZE, DIRECTION):
        low, high = parameter_interval(joint, index, name)
        if name == SIZE:
            low, high = _with_formula_error(value, (low, high), what)
        if name == SIZE and joint.effects[index].effect.is_lag:
            # Part of a lag effect may be the usual lag of the sensor's filter.
            low = max(
                low - UNUSUAL_LAG_FACTOR * channel_description(joint.trials[0].model.channel).usual_lag_s, what.lower
            )
        return Estimate(value, sd, low, high, what.unit, name != SIZE or is_nonzero(joint, index))
    low, high = (_profile_end(joint, index, name, sign) for sign in (-1, 1))
    if name == _DEPTH_PARAMETER:
        half_step = _half_sample_step_mm(joint, value)
        low, high = max(low - half_step, what.lower), min(high + half_step, what.upper)
    return Estimate(value, sd, min(low, value), max(high, value), what.unit, low > what.lower or high < what.upper)


def parameter_interval(joint: JointFit, which: int, name: str) -> tuple[float, float]:
    """Return the linearised 95 % interval of a parameter of effect number `which`, clipped to its bounds.

    If the interval of a nonzero amplitude contains zero, the interval of the logarithm is returned instead.
    """
    each = joint.effects[which]
    what, value = each.effect.parameters[name], each.values[name]
    if not what.free:
        return value, value
    if name != SIZE:
        step = min(TWO_SIDED_95 * joint.sd(which, name) / what.slope(value), _WIDEST_STEP)
        ends = what.value(what.coordinate(value) - step), what.value(what.coordinate(value) + step)
    else:
        ends = amplitude_interval(joint.covariance, joint, which)
        if ends[0] * ends[1] <= 0 and is_nonzero(joint, which):
            factor = float(np.exp(min(max(abs(end - value) for end in ends) / abs(value), _WIDEST_STEP)))
            ends = value / factor, value * factor
    low, high = (float(np.clip(end, what.lower, what.upper)) for end in ends)
    return min(low, high, value), max(low, high, value)


def _with_formula_error(value: float, ends: tuple[float, float], what: Parameter) -> tuple[float, float]:
    """Return the interval of an amplitude, widened by the model error of the effect's formula."""
    more = _NORMAL_95 * _FORMULA_SD * abs(value)
    low, high = value - math.hypot(value - ends[0], more), value + math.hypot(ends[1] - value, more)
    if ends[0] * ends[1] > 0 >= low * high:  # a formula error does not change the sign
        low, high = (ends[0], high) if value > 0 else (low, ends[1])
    return max(low, what.lower), min(high, what.upper)


def _half_sample_step_mm(joint: JointFit, depth_mm: float) -> float:
    """Return half of the median depth change (mm) between samples near a depth; 0 if no sample moves there."""
    ways = []
    for trial in joint.trials:
        depth = trial.motion.depth_mm
        near = np.abs(depth[1:] - depth_mm) < _NEARBY_MM
        ways.append(np.abs(np.diff(depth))[near])
    every = np.concatenate(ways)
    moving = every[every > 0]
    return float(np.median(moving)) / 2 if moving.size else 0.0


def _profile_end(joint: JointFit, index: int, name: str, sign: int) -> float:
    """Return the lower (`sign` -1) or upper (`sign` +1) end of the 95 % interval of the profile likelihood, clipped."""
    fitted = joint.effects[index]
    what, value = fitted.effect.parameters[name], fitted.values[name]
    centre = what.coordinate(value)
    half = _NORMAL_95 * min(joint.sd(index, name) / what.slope(value), 2.0)
    bound = _bound_coordinate(what, what.lower if sign < 0 else what.upper)
    step, short, far = half, 0.0, math.inf
    for _ in range(_PROFILE_STEPS):
        here = centre + sign * step
        beyond = sign * (here - bound) >= 0
        here = bound if beyond else here
        step = abs(here - centre)
        drop = _profile_drop(joint, index, name, _clipped_value(what, here))
        if abs(drop - _CHI2_95) < _PROFILE_TOLERANCE * _CHI2_95 or (drop < _CHI2_95 and beyond):
            break
        if drop < _CHI2_95:
            short = max(short, step)
        else:
            far = min(far, step)
        wanted = step * math.sqrt(_CHI2_95 / max(drop, 0.05 * _CHI2_95))
        step = wanted if short < wanted < far else (short + far) / 2 if far < math.inf else 2 * step
        if step > _FURTHEST_PROFILE * half:
            step = _FURTHEST_PROFILE * half
            break
    return _clipped_value(what, centre + sign * step)


def _profile_drop(joint: JointFit, index: int, name: str, value: float) -> float:
    """Return the drop of twice the log-likelihood with one parameter held at `value` and all others refitted."""
    heterogeneity_sd = np.array([joint.likelihood.heterogeneity_sd])
    values = {**joint.effects[index].values, name: value}
    moved: Sequence[FittedEffect] = [
        replace(each, values=values) if place == index else each for place, each in enumerate(joint.effects)
    ]
    others = tuple(each for each in joint.coordinates if each != (index, name))
    blocks = []
    for trial in joint.trials:
        before = effects_output(joint.effects, trial.model, trial.motion)
        more = trial.whiten(effects_output(moved, trial.model, trial.motion) - before)
        columns = trial.whiten(effect_sensitivities(moved, others, trial.model, trial.motion))
        blocks.append(replace(trial.whitened, residual=trial.whitened.residual - more, shared=columns))
    return JointLikelihood(blocks, heterogeneity_sd).energy() - joint.likelihood.energy()


def _clipped_value(what: Parameter, coordinate: float) -> float:
    """Return the parameter value that belongs to a fit coordinate, clipped to the parameter's bounds."""
    ends = [_bound_coordinate(what, each) for each in (what.lower, what.upper)]
    return float(np.clip(what.value(min(max(coordinate, ends[0]), ends[1])), what.lower, what.upper))


def _bound_coordinate(what: Parameter, bound: float) -> float:
    return what.coordinate(max(bound, 1e-300) if what.scale is Scale.LOG else bound)
