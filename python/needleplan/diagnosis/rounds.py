"""One round of a selection: every effect against all others and against competitors without a name."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from needleplan.diagnosis.calibrate import Calibration, Case
from needleplan.diagnosis.channels import measurand_of
from needleplan.diagnosis.fair import fitted_rivals
from needleplan.diagnosis.library import Candidates, Library
from needleplan.diagnosis.refit import Added, Joint, refit
from needleplan.diagnosis.rivals import score_rivals
from needleplan.diagnosis.screen import Screened, hills, screen
from needleplan.diagnosis.size import is_there
from needleplan.diagnosis.space import Space
from needleplan.diagnosis.step import Ranked, Step, Stop, as_good
from needleplan.diagnosis.verdict import Gates
from needleplan.diagnosis.verify import Verified, verify
from needleplan.models import Model
from needleplan.models.effects import SIZE, Effect
from needleplan.signals import Array

__all__ = ["USUAL_LAGS", "Search", "one_round", "transfers", "usual_late", "whitened_columns"]

_REFITTED = 4
_NEAR = 40.0
_NEAR_SHARE = 0.1
_NEAR_SHARE_HILLY = 0.5
"""How far behind the best an effect is still fitted: columns are not what a fit reaches, least of all among hills."""

_MOST_HILLS = 5
_NULLS = 200

USUAL_LAGS = 2.0
"""Multiple of the usual lag that any sensor may have; being late is an effect where it is so much later."""

_IMITATED = 30.0
_TRIED = 5.0
"""Balance of its column from which on an effect is fitted: beside a base that imitates it, it shows only in part."""
_MOST_OTHERS = 2
_APART = 0.5
"""Of its balance that an effect keeps beside another one from which on they do not explain the same."""
_STRONGLY = 3.0
"""Multiple of what an effect needs that it must promise in another motion to be confirmed there."""

_ASKED = 2.0
_HARM = 4.0
"""A motion in which an effect promises less than the one does not ask for it; it must not cost more than the other."""

_MOST_PLACES = 2
"""How many more effects than names: one name may stand for several places."""


@dataclass(frozen=True)
class Search:
    """What all rounds share: the data, the effects that are looked for, and the gates."""

    calibration: Calibration
    library: Library
    candidates: tuple[Candidates, ...]
    base: Space
    first: Sequence[Array]
    """The candidates' columns along the training trials, whitened, beside the base alone."""

    believed: tuple[Case, ...]
    """The trials as they were believed to be, where calibration moved parameters far; empty otherwise."""

    gates: Gates
    seed: int
    _columns: dict[int, tuple[Joint, list[Array]]] = field(default_factory=dict)
    _rests: dict[tuple[int, int], tuple[Joint, Joint]] = field(default_factory=dict)

    @property
    def price(self) -> float:
        """What Schwarz' criterion charges for a parameter."""
        return self.base.price

    def columns_beside(self, joint: Joint | None) -> Sequence[Array]:
        """Return the candidates' columns, whitened, beside the base and effects."""
        if joint is None:
            return self.first
        if id(joint) not in self._columns:
            made = whitened_columns(self.calibration, self.library, joint.cases, self.candidates)
            self._columns[id(joint)] = joint, made  # the joint is kept, so that no other one takes its id
        return self._columns[id(joint)][1]

    def without(self, joint: Joint, index: int) -> Joint:
        """Return effects fitted again without one of them."""
        key = id(joint), index
        if key not in self._rests:
            rest = [each for place, each in enumerate(joint.added) if place != index]
            self._rests[key] = joint, refit(rest, self.calibration, self.base, joint.cases)
        return self._rests[key][1]

    def is_hilly(self, effect: Effect) -> bool:
        """Whether an effect may fit as well at one place as at another."""
        return next(each.is_hilly for each in self.candidates if each.effect is effect)

    def within(self, effect: Effect) -> dict[str, tuple[float, float]]:
        """Return where the parameters of an effect are looked for."""
        return next(each.within() for each in self.candidates if each.effect is effect)

    def columns_as_believed(self) -> Sequence[Array]:
        """Return the candidates' columns beside the base as it was believed to be."""
        return whitened_columns(self.calibration, self.library, self.believed, self.candidates, self.calibration.given)


def one_round(search: Search, taken: Joint | None, first_gain: float) -> Step:
    """Look for one more effect beside those that were taken; `first_gain` is what the first of them brought."""
    gates = search.gates
    space = taken.space if taken else search.base
    cases = taken.cases if taken else search.calibration.training
    columns, count = search.columns_beside(taken), len(taken.added) if taken else 0
    known = {each.effect.name for each in taken.added} if taken else set()
    closed = {each.effect.name for each in taken.added if not each.effect.repeats} if taken else set()
    screened = tuple(each for each in screen(space, columns, search.candidates) if each.effect.name not in closed)
    rivals = score_rivals(space, cases)
    needed = gates.needed(space.level)
    if not screened:
        return Step(screened, rivals, (), None, Stop.WEAK)
    if len(known) >= gates.most or count >= gates.most + _MOST_PLACES:
        return Step(screened, rivals, (), None, Stop.ENOUGH)
    starts = _starts_as_believed(search, needed) if search.believed and not taken else []
    likely = screened if screened[0].balance >= _TRIED else ()
    ranked = _fitted(search, taken, starts, [(each, cases) for each in likely])
    if not ranked:
        return Step(screened, rivals, (), None, Stop.WEAK)
    ranked = _ordered(_on_other_hills(search, taken, _ordered(_judged(search, taken, ranked, needed)), needed))
    tied: tuple[str, ...] = ()
    if ranked[0].balance >= needed:
        before = first_gain if taken else 0.0
        ranked, tied = _least_contested(search, ranked, screened, before, needed)
        tried = {each.name for each in ranked}
        others = [(each, cases) for each in screened if each.effect.name not in tried and each.balance >= needed]
        if tied and others:  # what is far behind both may still be there, and tell them apart
            more = _judged(search, taken, _fitted(search, taken, others[:_MOST_OTHERS], ()), needed)
            ranked, tied = _least_contested(search, _ordered([*ranked, *more]), screened, before, needed)
    best = ranked[0]
    left = [each for each in search.candidates if each.effect.name not in closed]
    p_value = _chance(space, columns, left, best.balance, search.seed + count)
    if not taken and best.balance >= needed:
        rivals = fitted_rivals(best.joint, best.verified, rivals, search.calibration, search.base)

    def ended(stop: Stop) -> Step:
        return Step(screened, rivals, tuple(ranked), p_value, stop, tied if stop is Stop.TIE else ())

    if best.balance < needed or not is_there(best.joint, count):
        return ended(Stop.WEAK)
    if p_value > gates.p_value:
        return ended(Stop.CHANCE)
    if taken and best.gain < (gates.further_elsewhere if _is_confirmed(best, needed) else gates.further) * first_gain:
        return ended(Stop.SMALL)
    if tied:
        return ended(Stop.TIE)
    return ended(Stop.NO_TRANSFER if best.vetoed else Stop.ACCEPTED)


def _is_confirmed(best: Ranked, needed: float) -> bool:
    """Whether another motion speaks for an effect whose family is not that of the first one."""
    first, seen = best.joint.added[0].effect, best.verified
    return (
        seen is not None and not best.vetoed
        and seen.promised >= _STRONGLY * needed and best.joint.added[-1].effect.family is not first.family
    )  # fmt: skip


def _least_contested(
    search: Search, ranked: Sequence[Ranked], screened: Sequence[Screened], first_gain: float, needed: float
) -> tuple[list[Ranked], tuple[str, ...]]:
    """Return the effects with one first that no other rivals, and () then; or as they are, and what rivals the best.

    Where two rival each other, a third one that both leave as it is comes first: beside it they may differ.
    """
    tied = _tied(search, ranked, screened)
    least = search.gates.further * max(first_gain, ranked[0].gain)
    for place, each in enumerate(ranked if tied else ()):
        fits = each.balance >= needed and not each.vetoed and each.gain >= least
        if place and each.name not in tied and fits:
            order = [each, *ranked[:place], *ranked[place + 1 :]]
            if not _tied(search, order, screened):
                return order, ()
    return list(ranked), tied


def _tied(search: Search, ranked: Sequence[Ranked], screened: Sequence[Screened]) -> tuple[str, ...]:
    """Return the effects of which one is to be chosen, the best among them; nothing where it leads.

    Two effects that are both there bring as much as each other, too, and neither takes from the other: what brings most
    of its own beside the best is no other name for it.
    """
    best, lead = ranked[0], search.gates.lead
    tried = {each.name for each in ranked}
    alone = {each.name: each.balance for each in ranked[1:] if as_good(best, each, lead)} | {
        each.effect.name: each.balance
        for each in screened if each.effect.name not in tried and each.balance > best.balance - lead
    }  # fmt: skip
    if not alone:
        return ()
    beside = screen(best.joint.space, search.columns_beside(best.joint), search.candidates)
    kept = {each.effect.name: each.balance for each in beside}
    needed = search.gates.needed(best.joint.space.level)
    rivals = [name for name, balance in alone.items() if kept[name] < max(needed, _APART * balance)]
    return (best.name, *rivals) if rivals else ()


def _on_other_hills(search: Search, taken: Joint | None, ranked: list[Ranked], needed: float) -> list[Ranked]:
    """Return effects, the best one where another motion does not refute it, if it fits as well at such a place.

    A breath that shows in a few seconds of rest only has many frequencies, and all data together choose among them.
    """
    best = ranked[0]
    each = next(each for each in search.candidates if each.effect is best.joint.added[-1].effect)
    places = [name for name in each.effect.parameters if name != SIZE]
    if not best.vetoed or best.balance < needed or not each.is_hilly:
        return ranked
    space, columns = (taken.space if taken else search.base), search.columns_beside(taken)
    found = hills(space, columns, search.candidates, each.effect, places[0])
    starts = [hill for hill in found[: _MOST_HILLS + 1] if hill.balance > (1 - _NEAR_SHARE) * found[0].balance]
    cases = taken.cases if taken else search.calibration.training
    others = [other for hill in starts for other in _fitted(search, taken, [(hill, cases)], ())]
    as_well = [other for other in others if other.balance > best.balance - search.gates.lead]
    held = [other for other in _judged(search, taken, as_well, needed) if other.verified and not other.vetoed]
    return [max(held, key=lambda other: other.support), *ranked[1:]] if held else ranked


_Start = tuple[Screened, Sequence[Case]]
"""From where an effect is fitted, beside which base."""


def _ordered(ranked: Sequence[Ranked]) -> list[Ranked]:
    """Return effects, the best supported first; what another motion refutes not before what it supports."""
    ordered = sorted(ranked, key=lambda each: -each.support)
    if any(each.verified and not each.vetoed for each in ordered):
        ordered.sort(key=lambda each: each.verified is None or each.vetoed)
    return ordered


def _judged(search: Search, taken: Joint | None, ranked: Sequence[Ranked], needed: float) -> list[Ranked]:
    """Return effects with what they bring in another motion, those that could be named or are near the best."""
    top = max((each.balance for each in ranked), default=0.0)
    least = max(needed, top - max(_NEAR, _NEAR_SHARE * top))
    found = []
    for each in ranked:
        seen = verify(each.joint, search.calibration, taken) if each.balance >= least else None
        vetoed = seen is not None and not transfers(seen, search.gates)
        found.append(replace(each, verified=seen, vetoed=vetoed))
    return found


def _starts_as_believed(search: Search, needed: float) -> list[_Start]:
    """Return where effects may be that the calibrated base imitates: seen from the base as it was believed to be."""
    cases, columns = search.believed, search.columns_as_believed()
    believed = Space([case.block for case in cases])
    behind = 2 * float(search.base.evidence.max() - believed.evidence.max())
    seen = screen(believed, columns, search.candidates)
    likely = [each for each in seen if each.balance - behind > needed - _IMITATED][: _REFITTED - 1]
    lag = usual_late(search.calibration)
    late = [replace(each, values={**each.values, SIZE: lag}) for each in seen if each.effect.is_lag and lag]
    return [(each, cases) for each in (*likely, *late)]


def _fitted(search: Search, taken: Joint | None, certain: Sequence[_Start], screened: Sequence[_Start]) -> list[Ranked]:
    """Return effects fitted from where they were screened, the best first and each once.

    What is `certain` is fitted; of what was screened, the best, until the next one is far behind what a fit reached.
    """
    usual_lag_s = measurand_of(search.calibration.given.channel).usual_lag_s
    before = taken.gain if taken else 0.0
    found: dict[str, Ranked] = {}
    for count, (each, cases) in enumerate([*certain, *screened]):
        best = max((ranked.balance for ranked in found.values()), default=-math.inf)
        if count >= len(certain) + _REFITTED:
            break
        far = max(_NEAR, (_NEAR_SHARE_HILLY if search.is_hilly(each.effect) else _NEAR_SHARE) * best)
        if count >= len(certain) and each.balance < best - far:
            continue
        start = [*(taken.added if taken else ()), Added(each.effect, each.values, search.within(each.effect))]
        joint = refit(start, search.calibration, search.base, cases if not taken else None)
        if each.effect.is_lag and _lateness(joint) < (1 + USUAL_LAGS) * usual_lag_s:
            continue  # any sensor may be as late as that
        gain = max(joint.gain - before, 0.0)
        ranked = Ranked(each.effect.name, joint, gain, gain - len(each.effect.parameters) * search.price)
        if ranked.name not in found or ranked.balance > found[ranked.name].balance:
            found[ranked.name] = ranked
    return sorted(found.values(), key=lambda each: -each.balance)


def _lateness(joint: Joint) -> float:
    """Return how late readings are (s), by the last effect and by what the base takes for its sensor's own lag."""
    return joint.added[-1].values[SIZE] + float(np.median([case.lag_s for case in joint.cases]))


def usual_late(calibration: Calibration) -> float:
    """Return the lag that calibration found (s), 0 where it is one that any sensor may have."""
    usual_lag_s = measurand_of(calibration.given.channel).usual_lag_s
    found = float(np.median([case.lag_s for case in calibration.training]))
    return found if usual_lag_s > 0 and found > USUAL_LAGS * usual_lag_s else 0.0


def transfers(verified: Verified, gates: Gates) -> bool:
    """Whether what was found holds in another motion."""
    if verified.promised < _ASKED:
        return verified.kept > -_HARM
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
    return -math.expm1(-math.exp(min((place - balance) / scale, 700.0)))
