"""The answer of a diagnosis from posterior probabilities of sets of effects: one function, no gates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from needleplan.diagnosis.channels import GapAxis
from needleplan.diagnosis.posterior._settings import Settings

__all__ = ["PosteriorAnswer", "PosteriorDecision", "Ranked", "decide"]

Names = tuple[str, ...]


class PosteriorAnswer(StrEnum):
    """PosteriorAnswer of a diagnosis."""

    NONE = "none"
    """No effect is certain, and a relevant effect would have been seen."""

    UNDERPOWERED = "underpowered"
    """No effect is certain, but the data could hide a relevant effect."""

    NAMED = "named"
    """The set of missing effects is known."""

    INCOMPLETE = "incomplete"
    """At least one missing effect is known, and something else is missing too."""

    AMBIGUOUS = "ambiguous"
    """Something is missing, and several sets of effects explain it."""

    UNKNOWN = "unknown"
    """Something is missing, and no effect of the library explains it: a smooth function along `axis` does."""

    LAW_DIFFERS = "law_differs"
    """An effect is present, but a smooth function along its own axis describes it better than its law."""

    IMPLAUSIBLE = "implausible"
    """The amplitude of an effect is at a bound of its physical range."""


@dataclass(frozen=True)
class Ranked:
    """One hypothesis: its probability, its effects, and the axis of its nonparametric component, None without one."""

    probability: float
    names: Names
    axis: GapAxis | None = None


@dataclass(frozen=True)
class PosteriorDecision:
    """The answer with its probability, the effects that it names, and its reason."""

    answer: PosteriorAnswer
    names: Names
    probability: float
    because: str
    axis: GapAxis | None = None
    tied: tuple[Names, ...] = ()
    """Sets among which the data do not decide, the most probable first."""


def decide(
    ranked: Sequence[Ranked],
    settings: Settings,
    *,
    axes: Mapping[str, GapAxis],
    powered: bool = True,
    at_bound: Sequence[str] = (),
    transfer_z: float = 0.0,
    lacks: Sequence[str] = (),
) -> PosteriorDecision:
    """Return the answer from the posterior.

    Parameters
    ----------
    ranked
        All hypotheses; the probabilities sum to 1.
    settings
        Probabilities from which an answer is given.
    axes
        Axis of each effect's law.
    powered
        Whether most relevant effects would have been seen.
    at_bound
        Effects of the most probable set whose amplitude is at a bound.
    transfer_z
        Largest deviation of leave-one-motion-out, in standard deviations.
    lacks
        Data that are missing and without which nothing is named.

    Returns
    -------
    PosteriorDecision
        PosteriorAnswer, names and reason.
    """
    sets: dict[Names, float] = {}
    sure: dict[str, float] = {}
    for each in ranked:
        sets[each.names] = sets.get(each.names, 0.0) + each.probability
        for name in each.names:
            sure[name] = sure.get(name, 0.0) + each.probability
    best = max(sets, key=lambda names: sets[names])
    certain = tuple(name for name, value in sure.items() if value >= settings.named)
    nothing = sum(each.probability for each in ranked if not each.names and each.axis is None)
    by_axis: dict[GapAxis, float] = {}
    for each in ranked:
        if each.axis is not None and each.names == best:
            by_axis[each.axis] = by_axis.get(each.axis, 0.0) + each.probability
    along = max(by_axis, key=lambda axis: by_axis[axis]) if by_axis else None
    component = sum(by_axis.values())
    tied = tuple(sorted(sets, key=lambda names: -sets[names]))[:4]
    if not certain and nothing > 1 - settings.named:
        answer = PosteriorAnswer.NONE if powered else PosteriorAnswer.UNDERPOWERED
        return PosteriorDecision(answer, (), nothing, f"that nothing is missing has the probability {nothing:.2f}")
    if not best and component >= settings.unknown:
        why = f"no effect of the library explains the gap, a function of {along.label if along else '?'} does"
        return PosteriorDecision(PosteriorAnswer.UNKNOWN, (), component, why, along)
    if sets[best] < settings.named and not certain:
        why = f"the most probable set has the probability {sets[best]:.2f}"
        return PosteriorDecision(PosteriorAnswer.AMBIGUOUS, (), sets[best], why, tied=tied)
    if lacks:
        why = f"{', '.join(best)}: fits best, but these data do not support a name: no {', no '.join(lacks)}"
        return PosteriorDecision(PosteriorAnswer.AMBIGUOUS, (), sets[best], why, along, tied)
    if abs(transfer_z) > settings.transfer_z:
        why = f"{', '.join(best)}: one trial contradicts the others by {transfer_z:.1f} standard deviations"
        return PosteriorDecision(PosteriorAnswer.AMBIGUOUS, (), sets[best], why, along, tied)
    if sets[best] < settings.named:
        why = f"certain: {', '.join(certain)}; the whole set has the probability {sets[best]:.2f} only"
        return PosteriorDecision(PosteriorAnswer.INCOMPLETE, certain, sets[best], why, tied=tied)
    if at_bound:
        why = f"the amplitude is at a bound of its range: {', '.join(at_bound)}"
        return PosteriorDecision(PosteriorAnswer.IMPLAUSIBLE, (), sets[best], why, tied=(best,))
    if component > 0.5 * sets[best] and along is not None:
        own = [name for name in best if axes.get(name) is along]
        if own:
            why = f"{', '.join(own)} or an effect alike: a function of {along.label} fits better than the law"
            return PosteriorDecision(PosteriorAnswer.LAW_DIFFERS, (), component, why, along, (best,))
        why = f"a function of {along.label} is missing too"
        return PosteriorDecision(PosteriorAnswer.INCOMPLETE, best, component, why, along)
    return PosteriorDecision(PosteriorAnswer.NAMED, best, sets[best], f"the set has the probability {sets[best]:.3f}")
