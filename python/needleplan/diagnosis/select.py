"""Which effects are missing: a set of them, in which each is needed beside the others and none could be another one.

Effects are added one after the other. How the best one does while another one is missing may mislead: it seems to fail
in another motion, or one that acts like it and like the missing one together does better. So a first effect that fails
alone is tried together with a second one, and at the end each effect of a set is judged again beside the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from needleplan.diagnosis.calibrate import LAG, Calibration, Case, fit_case
from needleplan.diagnosis.channels import measurand_of
from needleplan.diagnosis.library import Library
from needleplan.diagnosis.minimal import Smallest, smallest_seen
from needleplan.diagnosis.refit import Added, Joint, refit
from needleplan.diagnosis.rivals import score_rivals, winner
from needleplan.diagnosis.rounds import Search, one_round, transfers, usual_late, whitened_columns
from needleplan.diagnosis.screen import screen
from needleplan.diagnosis.size import is_possible
from needleplan.diagnosis.space import Space
from needleplan.diagnosis.step import Ranked, Step, Stop
from needleplan.diagnosis.verdict import Gates
from needleplan.diagnosis.verify import Verified, verify

__all__ = ["Member", "Selection", "select"]

_FAR = 0.3
_IN_PLACE = 0.5
"""Of the balance of an effect that another one must have to be tried in its place."""
_MOST_IN_PLACE = 3


@dataclass(frozen=True)
class Member:
    """What one effect is worth in a set: beside all others of it."""

    gain: float
    """Twice the log likelihood over the others without it."""

    balance: float
    p_value: float | None
    """Of the round in which it was taken."""

    rivals: tuple[Added, ...] = ()
    """Effects that do as well in its place."""


@dataclass(frozen=True)
class Selection:
    """All rounds; `joint` holds what was accepted, None where nothing was."""

    base: Space
    steps: tuple[Step, ...]
    joint: Joint | None
    members: tuple[Member, ...]
    """One for each effect of `joint`."""

    verified: Verified | None
    """How they do in another motion together, over the base alone."""

    smallest: tuple[Smallest, ...]
    believed: tuple[Case, ...] = ()
    """The trials with parameters held that calibration moved far from what was believed of them; empty otherwise."""

    @property
    def sure(self) -> tuple[Added, ...]:
        """The effects of the set in whose place no other one does as well."""
        added = self.joint.added if self.joint else ()
        return tuple(each for each, member in zip(added, self.members, strict=True) if not member.rivals)

    @property
    def balance(self) -> float:
        """Schwarz' balance of all that was accepted."""
        return _balance(self.joint, self.base) if self.joint else 0.0


def select(calibration: Calibration, library: Library, gates: Gates, *, seed: int = 0) -> Selection:
    """Take effects as long as one passes all gates, then judge each beside the others."""
    base = Space([case.block for case in calibration.training])
    candidates = library.candidates([case.motion for case in calibration.training])
    first = whitened_columns(calibration, library, calibration.training, candidates)
    raw = [library.columns(calibration.model, case.motion, candidates) for case in calibration.training]
    smallest = smallest_seen(base, raw, first, candidates, calibration.noise.rms)
    believed = _believed(calibration)
    search = Search(calibration, library, candidates, base, first, believed, gates, seed)
    steps, last = _grown(search)
    found = _settled(search, steps, last) if steps else None
    first_step = steps[0] if steps else last
    tied = first_step.ranked[0] if first_step.stop is Stop.TIE else None
    for begin in _other_beginnings(search, first_step, found):
        other = _settled(search, *_grown(search, begin))
        least = found.support if found else tied.support if tied else 0.0
        if other and len(other.joint.added) > 1 and other.support > least + gates.lead:
            found = other
    if found is None:
        last = replace(steps[0], stop=Stop.NO_TRANSFER) if steps else last
        return Selection(base, (last,), None, (), None, smallest, believed)
    return Selection(base, (*found.steps, found.last), found.joint, found.members, found.verified, smallest, believed)


@dataclass(frozen=True)
class _Set:
    """Effects that were accepted together, and the rounds that led to them."""

    steps: tuple[Step, ...]
    last: Step
    joint: Joint
    members: tuple[Member, ...]
    verified: Verified | None
    balance: float

    @property
    def support(self) -> float:
        """What all data say for it: the balance of the fitted ones, and the gain in those that were held out."""
        return self.balance + (self.verified.gain if self.verified else 0.0)


def _grown(search: Search, begin: Step | None = None) -> tuple[list[Step], Step]:
    """Return the rounds in which an effect was accepted, and the one in which none was; `begin` is the first.

    A first effect that does not hold in another motion is accepted with a second one beside which it may.
    """
    accepted: list[Step] = []
    on_trial: Step | None = None
    joint: Joint | None = None
    step = begin or one_round(search, None, 0.0)
    while True:
        if step.stop is Stop.ACCEPTED:
            accepted += [replace(on_trial, stop=Stop.ACCEPTED), step] if on_trial else [step]
            on_trial = None
        elif step.stop is Stop.NO_TRANSFER and joint is None:
            on_trial = step
        else:
            return accepted, on_trial or step
        joint = step.ranked[0].joint
        step = one_round(search, joint, (on_trial or accepted[0]).ranked[0].gain)


def _other_beginnings(search: Search, first: Step, found: _Set | None) -> Iterator[Step]:
    """Return the first round with another effect taken, where that one and a second promise more than what was found.

    One effect can look like two others: a sensor that warms up like a bias and a drift. Where the first one was not
    decided, two may be.
    """
    if not found and first.stop is not Stop.TIE:
        return
    names = {each.effect.name for each in found.joint.added} if found else set()
    balance = found.balance if found else first.ranked[0].balance
    for each in first.ranked:
        if each.name in names:
            continue
        beside = screen(each.joint.space, search.columns_beside(each.joint), search.candidates)
        second = max((other.balance for other in beside if other.effect.name not in (each.name, *names)), default=0.0)
        if second < search.gates.needed(each.joint.space.level) or each.balance + second < balance:
            continue
        order = (each, *(other for other in first.ranked if other is not each))
        yield replace(first, ranked=order, stop=Stop.NO_TRANSFER if each.vetoed else Stop.ACCEPTED)


def _settled(search: Search, steps: Sequence[Step], last: Step) -> _Set | None:
    """Return the set with each effect the best of those that fit in its place, and needed beside the others.

    None where the first effect does not hold in another motion, and the others do not help it.
    """
    if not steps:
        return None
    joint, members, beaten = _pruned(search, steps)
    if any(each.rivals for each in members):
        last = _contest(search, joint, members, last)
    elif joint is not steps[-1].ranked[0].joint:
        last = replace(last, rivals=score_rivals(joint.space, joint.cases))
    if beaten:
        last = replace(last, stop=Stop.NAMELESS, tied=())
    alone = len(steps) == 1
    verified = (alone and steps[0].ranked[0].verified) or verify(joint, search.calibration)
    if steps[0].ranked[0].vetoed and (len(joint.added) == 1 or (verified and not transfers(verified, search.gates))):
        return None
    return _Set(tuple(steps), last, joint, members, verified, _balance(joint, search.base))


def _pruned(search: Search, steps: Sequence[Step]) -> tuple[Joint, tuple[Member, ...], bool]:
    """Return the effects that are needed, each the best in its place, and what each is worth.

    And whether what has no name did better in the place of one that is no longer among them.
    """
    joint = steps[-1].ranked[0].joint
    chances = [step.p_value for step in steps]
    if len(steps) == 1:
        return joint, (Member(joint.gain, steps[0].ranked[0].balance, chances[0]),), False
    beaten = False
    rivals: list[tuple[Added, ...]] = [()] * len(steps)
    for index in range(len(steps)):
        joint, rivals[index] = _in_place(search, joint, index)
    while True:
        rests = [search.without(joint, index) for index in range(len(joint.added))]
        members = tuple(
            Member(joint.gain - rest.gain, _balance(joint, search.base) - _balance(rest, search.base), chance, others)
            for rest, chance, others in zip(rests, chances, rivals, strict=True)
        )
        weakest = min(range(len(members)), key=lambda index: members[index].balance)
        if members[weakest].balance >= search.gates.needed(joint.space.level):
            lost = [index for index, member in enumerate(members) if _is_beaten(search, joint, member, index)]
            if not lost:
                return joint, members, beaten
            weakest, beaten = min(lost, key=lambda index: members[index].balance), True
        joint = rests[weakest]
        del chances[weakest], rivals[weakest]
        if len(joint.added) == 1:
            return joint, (Member(joint.gain, _balance(joint, search.base), chances[0], rivals[0]),), beaten


def _is_beaten(search: Search, joint: Joint, member: Member, index: int) -> bool:
    """Whether what has no name does better than a member beside the others: as it may not than a single effect."""
    rest = search.without(joint, index)
    freedom = len(joint.added[index].effect.parameters)
    rivals = score_rivals(rest.space, rest.cases)
    return winner(rivals, search.gates, gain=member.gain, balance=member.balance, freedom=freedom, lead=0.0) is not None


def _in_place(search: Search, joint: Joint, index: int) -> tuple[Joint, tuple[Added, ...]]:
    """Return the set with the best effect in one place, and the effects that do as well there."""
    rest = search.without(joint, index)
    names = {each.effect.name for each in joint.added}
    least = _IN_PLACE * (_balance(joint, search.base) - _balance(rest, search.base))
    sets = [joint]
    for other in screen(rest.space, search.columns_beside(rest), search.candidates):
        if other.effect.name in names or other.balance < least or len(sets) > _MOST_IN_PLACE:
            continue
        added = [*joint.added]
        added[index] = Added(other.effect, other.values, search.within(other.effect))
        sets.append(refit(added, search.calibration, search.base, joint.cases))
    if len(sets) == 1:
        return joint, ()
    supports = []
    for each in sets:
        seen = verify(each, search.calibration)
        holds = (seen is None or transfers(seen, search.gates)) and is_possible(each, index)
        supports.append((holds, _balance(each, search.base) + (seen.gain if seen else 0.0)))
    best = max(range(len(sets)), key=lambda place: supports[place])
    holds, support = supports[best]
    return sets[best], tuple(
        each.added[index] for place, each in enumerate(sets)
        if place != best and (supports[place][0] or not holds) and supports[place][1] > support - search.gates.lead
    )  # fmt: skip


def _contest(search: Search, joint: Joint, members: Sequence[Member], last: Step) -> Step:
    """Return the round that was not decided after all: an effect of the set, and those that do as well in its place."""
    index = next(place for place, each in enumerate(members) if each.rivals)
    rest = search.without(joint, index) if len(joint.added) > 1 else None
    added, gain, before = (rest.added, rest.gain, _balance(rest, search.base)) if rest else ((), 0.0, 0.0)
    ranked = []
    for each in (joint.added[index], *members[index].rivals):
        whole = refit([*added, each], search.calibration, search.base, joint.cases)
        ranked.append(Ranked(each.effect.name, whole, whole.gain - gain, _balance(whole, search.base) - before))
    return Step(
        last.screened, score_rivals(joint.space, joint.cases), tuple(ranked), members[index].p_value, Stop.TIE,
        tuple(each.name for each in ranked),
    )  # fmt: skip


def _balance(joint: Joint, base: Space) -> float:
    return joint.gain - base.price * sum(len(each.effect.parameters) for each in joint.added)


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
    late = usual_late(calibration) > 0
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
