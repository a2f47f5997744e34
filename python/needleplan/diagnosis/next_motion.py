"""What to measure next: the motion that tells rival effects apart (T-optimal, after Hunter and Reiner).

Were the first of two effects true, one more trial of a motion would show what its model predicts, and the second would
explain what it can of that: with the base calibrated anew, and with its own parameters moved as far as the data so
far allow. The whitened square of what is left is how much the balance between the two is expected to change, in the
same units as the lead that a name needs. A balance that is expected to change by D does so with a variance of 4 D.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.stats import norm

from needleplan.diagnosis.calibrate import Calibration, Case, fit_case, late, pooled
from needleplan.diagnosis.diagnosis import Diagnosis
from needleplan.diagnosis.program import Limits, Program, programs
from needleplan.diagnosis.refit import Added, Joint, added_output
from needleplan.diagnosis.select import Step, Stop
from needleplan.diagnosis.space import Space
from needleplan.diagnosis.verdict import Verdict
from needleplan.models import Model, simulate
from needleplan.signals import Array, Motion, Record

__all__ = ["NOTHING", "NextMotion", "Separation", "limits_of", "next_motion", "separations"]

NOTHING = "nothing"
"""Name of the rival of an effect that has no other."""

_MOST = 4
_NEAR = 2.0
"""Leads behind the best within which an effect is a rival."""

_STEP = 0.02
_FLOOR_MM = -10.0


@dataclass(frozen=True)
class Separation:
    """How far one more trial would tell two effects apart, were the first one true."""

    true: str
    rival: str
    lead: float
    """Of the first over the second so far, in the units of the balance."""

    expected: float
    """By how much the lead is expected to grow."""

    thresholds: float
    """The same, in units of the lead that a name needs."""

    resolves: float
    """Probability that the lead is enough then."""


@dataclass(frozen=True)
class NextMotion:
    """The motion to be made next, and what is expected of it."""

    program: Program
    motion: Motion
    separations: tuple[Separation, ...]
    resolves: float
    """Probability that it decides between the rivals, each true with the probability that the balance gives it."""

    repeated: tuple[Separation, ...]
    """What the last training motion would do, were it made once more."""

    repeated_resolves: float
    considered: tuple[tuple[str, float, float], ...]
    """All programs: name, probability, least separation in thresholds."""

    @property
    def least(self) -> float:
        """Separation of the pair that is told apart worst, in units of the lead that a name needs."""
        return min(each.thresholds for each in self.separations)


@dataclass(frozen=True)
class _Rival:
    name: str
    balance: float
    base: Model
    added: tuple[Added, ...]
    names: tuple[tuple[int, str], ...]
    covariance: Array


def limits_of(found: Diagnosis, *, fastest_mm_s: float = 0.0) -> Limits:
    """Return limits within what the recordings have shown to be possible: their depths, and 15 mm/s at least."""
    motions = [case.motion for case in (*found.calibration.training, *found.calibration.held_out)]
    top = min(float(each.depth_mm.min()) for each in motions)
    deepest = max(float(each.depth_mm.max()) for each in motions)
    fastest = max(float(np.abs(each.velocity_mm_s).max()) for each in motions)
    return Limits(round(deepest, 2), fastest_mm_s or max(fastest, Limits.fastest_mm_s), round(max(top, _FLOOR_MM), 2))


def next_motion(found: Diagnosis, limits: Limits | None = None) -> NextMotion | None:
    """Return the motion that separates the effects between which a diagnosis wavers; None where it does not.

    Candidates are `programs` within `limits`, by default those of the recordings. Raises DataError for limits that
    leave no room to move.
    """
    rivals = _rivals(found)
    if len(rivals) < 2:
        return None
    limits = limits or limits_of(found)
    last = found.calibration.training[-1]
    rate_hz = 1 / float(np.median(last.motion.interval_s))
    lead, level = found.gates.lead, found.selection.base.level
    tried = []
    for program in programs(found.given.channel, limits):
        motion = program.motion(rate_hz)
        pairs = _separations(rivals, found.calibration, motion, level, lead)
        tried.append((program, motion, pairs, _resolves(rivals, pairs)))
    # Probabilities that are all but the same are no choice: then the farther apart, the better.
    best = max(tried, key=lambda each: (round(each[3], 2), min(pair.thresholds for pair in each[2])))
    again = _separations(rivals, found.calibration, last.motion, level, lead)
    considered = tuple((each[0].name, each[3], min(pair.thresholds for pair in each[2])) for each in tried)
    return NextMotion(*best, again, _resolves(rivals, again), considered)


def separations(found: Diagnosis, motion: Motion) -> tuple[Separation, ...]:
    """Return how far one more trial of a motion would tell the rivals of a diagnosis apart, every pair both ways."""
    level, lead = found.selection.base.level, found.gates.lead
    return _separations(_rivals(found), found.calibration, motion, level, lead)


def _rivals(found: Diagnosis) -> tuple[_Rival, ...]:
    """Return the effects that are near the best one in the round that decided, or could not."""
    step = _deciding(found)
    if step is None:
        return ()
    behind = max(each.balance for each in step.ranked) - _NEAR * found.gates.lead
    near = [_fitted(each.joint, each.name, each.balance, found) for each in step.ranked if each.balance > behind]
    tried = {each.name for each in step.ranked}
    taken = step.ranked[0].joint.added[:-1]
    for screened in step.screened:
        if screened.effect.name not in tried and screened.balance > behind:
            added = (*taken, Added(screened.effect, screened.values))
            near.append(
                _Rival(screened.effect.name, screened.balance, found.calibration.model, added, (), np.zeros((0, 0)))
            )
    if len(near) == 1 and found.verdict is Verdict.AMBIGUOUS:
        # What lacks is not a rival but data: then what shows the one effect best, beside none.
        near.append(_Rival(NOTHING, 0.0, found.calibration.model, (), (), np.zeros((0, 0))))
    return tuple(sorted(near, key=lambda each: -each.balance)[:_MOST])


def _deciding(found: Diagnosis) -> Step | None:
    accepted = [step for step in found.selection.steps if step.stop is Stop.ACCEPTED]
    last = found.selection.steps[-1]
    if found.verdict in (Verdict.AMBIGUOUS, Verdict.INCOMPLETE):
        return last if last.stop is Stop.TIE else accepted[-1] if accepted else None
    return accepted[-1] if found.verdict is Verdict.NAMED else None


def _fitted(joint: Joint, name: str, balance: float, found: Diagnosis) -> _Rival:
    base = pooled([case.model for case in joint.cases], found.calibration.free)
    return _Rival(name, balance, base, joint.added, joint.names, joint.covariance)


def _resolves(rivals: Sequence[_Rival], pairs: Sequence[Separation]) -> float:
    best = max(each.balance for each in rivals)
    weights = np.array([np.exp((each.balance - best) / 2) for each in rivals])
    each = [min(pair.resolves for pair in pairs if pair.true == rival.name) for rival in rivals]
    return float(weights @ each / weights.sum())


def _separations(
    rivals: Sequence[_Rival], calibration: Calibration, motion: Motion, level: float, lead: float
) -> tuple[Separation, ...]:
    shown = {each.name: _output(each, motion) for each in rivals}
    found = []
    for rival in rivals:
        case = _predicted_case(rival.base, calibration, motion)
        moved = case.whiten(_derivatives(rival, motion)) if rival.names else np.zeros((case.block.samples, 0))
        space = Space([case.block], np.array([level]))
        for true in rivals:
            if true is rival:
                continue
            gap = case.whiten((shown[true.name] - shown[rival.name])[:, None])
            matrix, _ = space.normal([np.column_stack([gap, moved])], 0)
            expected = _left(matrix, rival.covariance)
            now = true.balance - rival.balance
            sure = norm.cdf((now + expected - lead) / (2 * sqrt(expected) + 1e-9))
            found.append(Separation(true.name, rival.name, now, expected, expected / lead, float(sure)))
    return tuple(found)


def _left(matrix: Array, covariance: Array) -> float:
    """Return the square of the first column with the others taken out, as far as what is known of them lets them."""
    if not covariance.size:
        return max(float(matrix[0, 0]), 0.0)
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    known = np.linalg.inv(covariance / np.outer(scale, scale) + 1e-9 * np.eye(len(scale)))
    inner = matrix[1:, 1:] * np.outer(scale, scale) + known
    cross = matrix[1:, 0] * scale
    return max(float(matrix[0, 0] - cross @ np.linalg.solve(inner, cross)), 0.0)


def _predicted_case(base: Model, calibration: Calibration, motion: Motion) -> Case:
    """Return a trial of a motion as it would be calibrated: what the base can take up there, and the tissue vary."""
    lag_s = float(np.mean([case.lag_s for case in calibration.training]))
    output = late(simulate(base, motion).output.ravel(), motion, lag_s)
    columns = dict(zip(base.channel.columns, np.split(output, len(base.channel.columns)), strict=True))
    record = Record(
        {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s,
         "angle_rad": motion.angle_rad, **columns}, "next",
    )  # fmt: skip
    return fit_case(base, record, calibration.noise, calibration.free, start_lag_s=lag_s, about=base)


def _output(rival: _Rival, motion: Motion) -> Array:
    plain = simulate(rival.base, motion).output.ravel()
    return np.asarray(plain + added_output(rival.added, rival.base, motion).ravel())


def _derivatives(rival: _Rival, motion: Motion) -> Array:
    """Return how the output depends on each coordinate of an effect's parameters, shape (samples, coordinates)."""
    here = added_output(rival.added, rival.base, motion).ravel()
    columns = []
    for index, name in rival.names:
        each = rival.added[index]
        what = each.effect.parameters[name]
        step = _STEP if what.value(what.coordinate(each.values[name]) + _STEP) <= what.upper else -_STEP
        values = {**each.values, name: what.value(what.coordinate(each.values[name]) + step)}
        added = tuple(Added(each.effect, values) if at == index else old for at, old in enumerate(rival.added))
        columns.append((added_output(added, rival.base, motion).ravel() - here) / step)
    return np.column_stack(columns)
