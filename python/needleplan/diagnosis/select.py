"""Which effects are missing: one after the other, each against all others and against competitors without a name."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy import stats

from needleplan.diagnosis.calibrate import LAG, Calibration, Case, fit_case
from needleplan.diagnosis.channels import measurand_of
from needleplan.diagnosis.fair import fitted_rival
from needleplan.diagnosis.library import Candidates, Library
from needleplan.diagnosis.minimal import Smallest, smallest_seen
from needleplan.diagnosis.refit import Added, Joint, refit
from needleplan.diagnosis.rivals import RivalScore, score_rivals
from needleplan.diagnosis.screen import Screened, screen
from needleplan.diagnosis.size import is_there
from needleplan.diagnosis.space import Space
from needleplan.diagnosis.verdict import Gates
from needleplan.diagnosis.verify import Verified, verify
from needleplan.models import Model
from needleplan.models.effects import SIZE
from needleplan.signals import Array

__all__ = ["Ranked", "Selection", "Step", "Stop", "select", "whitened_columns"]

_REFITTED = 4
_NEAR = 40.0
_NEAR_SHARE = 0.1
"""How far behind the best an effect is still fitted: columns are not what a fit reaches."""
_NULLS = 200
_LAGS = 2.0
"""Multiple of the usual lag from which on being late is an effect."""
_IMITATED = 30.0
_TRIED = 5.0
"""Balance of its column from which on an effect is fitted: beside a base that imitates it, it shows only in part."""
_FAR = 0.3


class Stop(StrEnum):
    """Why no further effect was taken."""

    ACCEPTED = "accepted"
    WEAK = "weak"
    """The best one does not reach the threshold, or its size may be zero."""

    CHANCE = "chance"
    """Simulated data without an effect reach as much too often."""

    TIE = "tie"
    """Another effect explains it as well."""

    NO_TRANSFER = "no_transfer"
    """It does not hold in another motion."""

    SMALL = "small"
    """It is a small part of what the first one brought."""

    ENOUGH = "enough"
    """As many as are looked for were found."""


@dataclass(frozen=True)
class Ranked:
    """An effect, fitted together with the base and the effects before it."""

    name: str
    joint: Joint
    balance: float
    """Schwarz' balance of this effect over those before it."""

    verified: Verified | None = None
    """How it does in another motion; None where it was not asked, or there is none."""

    kept: float = 0.0
    """What it brings there over those before it: twice the log likelihood of data that it was not fitted to."""

    vetoed: bool = False
    """Whether it does not hold there."""

    @property
    def support(self) -> float:
        """What all data say for it: the balance of the fitted ones, and the gain in those that were held out."""
        return self.balance + self.kept


@dataclass(frozen=True)
class Step:
    """One round: what was screened, what was fitted, and how it ended."""

    screened: tuple[Screened, ...]
    rivals: tuple[RivalScore, ...]
    ranked: tuple[Ranked, ...]
    p_value: float | None
    lead: float
    verified: Verified | None
    stop: Stop

    @property
    def tied(self) -> tuple[str, ...]:
        """Effects that are as good as the best, itself among them."""
        return tuple(each.name for each in self.ranked if _rivals(self.ranked[0], each, self.lead))


@dataclass(frozen=True)
class Selection:
    """All rounds; `joint` holds what was accepted, None where nothing was."""

    base: Space
    steps: tuple[Step, ...]
    joint: Joint | None
    verified: Verified | None
    smallest: tuple[Smallest, ...]
    believed: tuple[Case, ...] = ()
    """The trials with parameters held that calibration moved far from what was believed of them; empty otherwise."""


def select(calibration: Calibration, library: Library, gates: Gates, *, seed: int = 0) -> Selection:
    """Take effects as long as one passes all gates."""
    base = Space([case.block for case in calibration.training])
    candidates = library.candidates([case.motion for case in calibration.training])
    first = whitened_columns(calibration, library, calibration.training, candidates)
    raw = [library.columns(calibration.model, case.motion, candidates) for case in calibration.training]
    smallest = smallest_seen(base, raw, first, candidates, calibration.noise.rms)
    again = _believed(calibration)
    cases, space = calibration.training, base
    joint: Joint | None = None
    verified: Verified | None = None
    steps: list[Step] = []
    while True:
        taken = joint.added if joint else ()
        before = joint.gain if joint else 0.0
        columns = first if joint is None else whitened_columns(calibration, library, cases, candidates)
        round_ = _Round(calibration, gates, base, candidates, taken, before, tuple(steps), seed)
        other = None
        if joint is None and again:
            other = (again, whitened_columns(calibration, library, again, candidates, calibration.given))
        step = _round(round_, space, cases, columns, other)
        steps.append(step)
        if step.stop is not Stop.ACCEPTED:
            break
        joint, verified = step.ranked[0].joint, step.verified
        cases, space = joint.cases, joint.space
    return Selection(base, tuple(steps), joint, verified, smallest, again)


_Trials = tuple[Sequence[Case], Sequence[Array]]
"""Cases, and the candidates' columns along them."""

_Start = tuple[Screened, Sequence[Case]]
"""From where an effect is fitted, beside which base."""


@dataclass(frozen=True)
class _Round:
    """What a round knows of those before it."""

    calibration: Calibration
    gates: Gates
    base: Space
    candidates: tuple[Candidates, ...]
    taken: tuple[Added, ...]
    before: float
    steps: tuple[Step, ...]
    seed: int


def _round(
    known: _Round,
    space: Space,
    cases: Sequence[Case],
    columns: Sequence[Array],
    other: _Trials | None,
) -> Step:
    gates, taken, before, steps = known.gates, known.taken, known.before, known.steps
    names = {each.effect.name for each in taken if not each.effect.repeats}
    left = [each for each in known.candidates if each.effect.name not in names]
    screened = tuple(each for each in screen(space, columns, known.candidates) if each.effect.name not in names)
    rivals = score_rivals(space, cases)
    needed = gates.needed(space.level)
    if not screened:
        return Step(screened, rivals, (), None, gates.lead, None, Stop.WEAK)
    if len(taken) >= gates.most:
        return Step(screened, rivals, (), None, gates.lead, None, Stop.ENOUGH)
    starts = _starts_as_believed(known, other, needed) if other else []
    likely = screened if screened[0].balance >= _TRIED else ()
    ranked = _fitted(known, starts, [(each, cases) for each in likely], space)
    if not ranked:
        return Step(screened, rivals, (), None, gates.lead, None, Stop.WEAK)
    ranked = sorted(_judged(known, ranked, needed), key=lambda each: -each.support)
    if any(each.verified and not each.vetoed for each in ranked):
        # What another motion refutes is not named before what it supports.
        ranked = sorted(ranked, key=lambda each: each.verified is None or each.vetoed)
    best = ranked[0]
    p_value = _chance(space, columns, left, best.balance, known.seed + len(taken))
    tried = {each.name for each in ranked}
    tied = any(_rivals(best, each, gates.lead) for each in ranked[1:]) or any(
        e.balance > best.balance - gates.lead for e in screened if e.effect.name not in tried
    )
    verified = best.verified or verify(best.joint, known.calibration)

    if not taken and best.balance >= needed:
        rival = fitted_rival(best.joint, known.calibration, known.base)
        rivals = tuple(sorted([*rivals, *([rival] if rival else [])], key=lambda each: -each.balance))

    def ended(stop: Stop) -> Step:
        return Step(screened, rivals, tuple(ranked), p_value, gates.lead, verified, stop)

    if best.balance < needed or not is_there(best.joint, len(taken)):
        return ended(Stop.WEAK)
    if p_value > gates.p_value:
        return ended(Stop.CHANCE)
    if taken and best.joint.gain - before < gates.further * steps[0].ranked[0].joint.gain:
        return ended(Stop.SMALL)
    if tied:
        return ended(Stop.TIE)
    if best.vetoed:
        return ended(Stop.NO_TRANSFER)
    return ended(Stop.ACCEPTED)


def _rivals(best: Ranked, other: Ranked, lead: float) -> bool:
    """Whether all data together do not tell two effects apart, or those that were fitted speak for the other one."""
    fits_better = not other.vetoed and other.balance > best.balance + lead
    return bool(other.support > best.support - lead or fits_better)


def _judged(known: _Round, ranked: Sequence[Ranked], needed: float) -> list[Ranked]:
    """Return effects with what they bring in another motion, those that could be named or are near the best."""
    before = known.steps[-1].verified if known.taken else None
    least = max(needed, ranked[0].balance - max(_NEAR, _NEAR_SHARE * ranked[0].balance))
    found = []
    for each in ranked:
        seen = verify(each.joint, known.calibration) if each.balance >= least else None
        kept = seen.gain - (before.gain if before else 0.0) if seen else 0.0
        vetoed = seen is not None and not _transfers(each, seen, known)
        found.append(replace(each, verified=seen, kept=kept, vetoed=vetoed))
    return found


def _starts_as_believed(known: _Round, other: _Trials, needed: float) -> list[_Start]:
    """Return where effects may be that the calibrated base imitates: seen from the base as it was believed to be."""
    cases, columns = other
    believed = Space([case.block for case in cases])
    behind = 2 * float(known.base.evidence.max() - believed.evidence.max())
    seen = screen(believed, columns, known.candidates)
    found = [(each, cases) for each in seen if each.balance - behind > needed - _IMITATED][: _REFITTED - 1]
    lag = _usual_late(known.calibration)
    return found + [
        (replace(each, values={**each.values, SIZE: lag}), cases) for each in seen if each.effect.is_lag and lag
    ]


def _fitted(known: _Round, certain: Sequence[_Start], screened: Sequence[_Start], space: Space) -> list[Ranked]:
    """Return effects fitted from where they were screened, the best first and each once.

    What is `certain` is fitted; of what was screened, the best, until the next one is far behind what a fit reached.
    """
    price = space.price
    usual_lag_s = measurand_of(known.calibration.given.channel).usual_lag_s
    found: dict[str, Ranked] = {}
    for count, (each, cases) in enumerate([*certain, *screened]):
        best = max((ranked.balance for ranked in found.values()), default=-math.inf)
        if count >= len(certain) and (
            each.balance < best - max(_NEAR, _NEAR_SHARE * best) or count >= len(certain) + _REFITTED
        ):
            break
        within = next(c.within() for c in known.candidates if c.effect is each.effect)
        start = [*known.taken, Added(each.effect, each.values, within)]
        joint = refit(start, known.calibration, known.base, cases if not known.taken else None)
        if each.effect.is_lag and joint.added[-1].values[SIZE] < _LAGS * usual_lag_s:
            continue  # any sensor may be as late as that
        gain = max(joint.gain - known.before, 0.0)
        ranked = Ranked(each.effect.name, joint, gain - len(each.effect.parameters) * price)
        if ranked.name not in found or ranked.balance > found[ranked.name].balance:
            found[ranked.name] = ranked
    return sorted(found.values(), key=lambda each: -each.balance)


def _usual_late(calibration: Calibration) -> float:
    """Return the lag that calibration found (s), 0 where it is one that any sensor may have."""
    usual_lag_s = measurand_of(calibration.given.channel).usual_lag_s
    found = float(np.median([case.lag_s for case in calibration.training]))
    return found if usual_lag_s > 0 and found > _LAGS * usual_lag_s else 0.0


def _believed(calibration: Calibration) -> tuple[Case, ...]:
    """Return the trials with those parameters held that calibration moved far from what was believed of them.

    Where an effect acts like such a parameter, the calibrated base imitates it, and its score there says nothing. Seen
    from the base as it was given it stands out. Nothing, where no parameter was moved far.
    """
    given, now = calibration.given, calibration.model
    far = {
        name
        for name in calibration.free
        if abs(given.parameters()[name].coordinate(getattr(now, name))
               - given.parameters()[name].coordinate(getattr(given, name))) > _FAR
    }  # fmt: skip
    late = _usual_late(calibration) > 0
    if not far and not late:
        return ()
    held = {*far, LAG} if late else far
    usual_lag_s = measurand_of(given.channel).usual_lag_s
    return tuple(
        fit_case(
            case.model.with_values(**{name: getattr(given, name) for name in far}), case.record, calibration.noise,
            calibration.free, start_lag_s=usual_lag_s if late else case.lag_s, about=given, hold=held,
        )
        for case in calibration.training
    )  # fmt: skip


def _transfers(each: Ranked, verified: Verified, known: _Round) -> bool:
    """Whether an effect holds in another motion; a further one must bring there part of what it brought in training."""
    gates, calibration = known.gates, known.calibration
    before = known.steps[-1].verified if known.taken else None
    if before is not None:
        samples = [sum(len(case.motion) for case in part) for part in (calibration.held_out, calibration.training)]
        hoped = (each.joint.gain - known.before) * samples[0] / samples[1]
        return verified.gain - before.gain >= gates.further_transfer * hoped
    # What is kept is promised + 2 sqrt(promised) times a standard normal number, where the effect is there.
    chance = verified.promised - gates.transfer_sds * 2 * math.sqrt(max(verified.promised, 0.0))
    return verified.kept > max(0.0, min(gates.transfer * verified.promised, chance))


def whitened_columns(
    calibration: Calibration,
    library: Library,
    cases: Sequence[Case],
    candidates: Sequence[Candidates],
    about: Model | None = None,
) -> list[Array]:
    """Return every candidate along every trial, whitened; beside the calibrated base, or one like `about`."""
    model = about or calibration.model
    columns = [case.whiten(library.columns(model, case.motion, candidates)) for case in cases]
    for each in candidates:
        if each.effect.is_lag:  # the lag that was calibrated and one more are not the same as one that is longer
            for case, whitened in zip(cases, columns, strict=True):
                whitened[:, each.first] = case.lag_column
    return columns


def _chance(
    space: Space, columns: Sequence[Array], candidates: Sequence[Candidates], balance: float, seed: int
) -> float:
    """Return how often data without an effect reach such a balance: Gumbel's law, fitted to simulated data."""
    price = space.price
    penalty, signs = np.full(columns[0].shape[1], np.inf), np.zeros(columns[0].shape[1])
    for each in candidates:
        penalty[each.first : each.last], signs[each.first : each.last] = each.count * price, each.sign
    maxima = space.null_maxima(columns, penalty, signs, _NULLS, seed)
    scale = float(maxima.std(ddof=1)) * np.sqrt(6) / np.pi
    place = float(maxima.mean()) - np.euler_gamma * scale
    return float(stats.gumbel_r.sf(balance, place, scale))
