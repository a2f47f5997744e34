"""The answer of a diagnosis from posterior probabilities of sets of effects: one function, no gates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from needleplan.artifacts import CallRepr
from needleplan.diagnosis._constants import LARGEST_FAMILY, LIKELY, MOST_EFFECTS
from needleplan.diagnosis._settings import Settings
from needleplan.diagnosis.channels import GapAxis

__all__ = ["DiagnosisDecision", "Names", "Ranked", "Verdict", "decide"]

Names = tuple[str, ...]
"""Names of the effects of a set."""


class Verdict(StrEnum):
    """Answer of a diagnosis."""

    NONE = "none"
    """Nothing is missing with the probability of a name, and a relevant effect would have been seen."""

    UNDERPOWERED = "underpowered"
    """"Nothing" is the most probable, but the data could hide a relevant effect."""

    NAMED = "named"
    """Every effect of the most probable set is certain."""

    INCOMPLETE = "incomplete"
    """At least one missing effect is certain, and probably something else is missing too."""

    CHANGED = "changed"
    """No effect is missing, but other values of parameters, or other laws of the base, close a part of the gap."""

    AMBIGUOUS = "ambiguous"
    """Something is missing, and several sets of effects explain it."""

    UNKNOWN = "unknown"
    """Something is missing, and no effect of the library explains it: a smooth function along `axis` does."""

    IMPLAUSIBLE = "implausible"
    """An amplitude, or a time constant, of an effect is at the end of its range: it stands for something else."""


@dataclass(frozen=True)
class Ranked:
    """One hypothesis: its probability, its effects, and the axis of its nonparametric component, None without one."""

    probability: float
    names: Names
    axis: GapAxis | None = None


@dataclass(frozen=True)
class DiagnosisDecision(CallRepr):
    """The answer with its probability, the effects that it names, and its reason."""

    verdict: Verdict
    names: Names
    probability: float
    because: str
    axis: GapAxis | None = None
    tied: tuple[Names, ...] = ()
    """Sets among which the data do not decide, the most probable first."""

    family: Names = ()
    """Smallest set of effects that contains a missing effect with the probability required for a name.

    Given if no single effect has this probability.
    """

    other_laws: tuple[str, ...] = ()
    """Laws of the base whose lead exceeds that of the best effects, if nothing is named for this reason."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "probability", min(self.probability, 1.0))  # a sum of probabilities may round up


def decide(
    ranked: Sequence[Ranked],
    settings: Settings,
    *,
    powered: bool = True,
    at_bound: Mapping[str, str] | None = None,
    contradiction: str = "",
    lacks: Sequence[str] = (),
    laws: Mapping[str, float] | None = None,
) -> DiagnosisDecision:
    """Return the answer from the posterior: the first of the ordered rules that applies.

    Parameters
    ----------
    ranked
        All hypotheses; the probabilities sum to 1.
    settings
        Probabilities from which an answer is given.
    powered
        Whether most relevant effects would have been seen.
    at_bound
        Parameter at the end of its range, by effect of the most probable set.
    contradiction
        Words on what single trials say against the most probable set; empty if they say nothing.
    lacks
        Data that are missing and without which nothing is named.
    laws
        Lead (nats) of each law of the base that differs from the model's. A law competes for each effect that leads by
        less: such an effect may be what is left of the law.

    Returns
    -------
    DiagnosisDecision
        Answer, names and reason.

    Examples
    --------
    >>> from needleplan.diagnosis import Ranked, Settings, decide
    >>> ranked = [Ranked(0.98, ("viscous",)), Ranked(0.02, ())]
    >>> decide(ranked, Settings()).names
    ('viscous',)
    >>> str(decide(ranked, Settings(), laws={"friction reverses": 10.0}).verdict)
    'ambiguous'
    """
    laws, sets, sure = laws or {}, dict[Names, float](), dict[str, float]()
    for each in ranked:
        sets[each.names] = sets.get(each.names, 0.0) + each.probability
        for name in set(each.names):
            sure[name] = sure.get(name, 0.0) + each.probability
    best = max(sets, key=lambda names: sets[names])
    likely = tuple(name for name, value in sure.items() if value >= settings.named)
    rivals = {name: [law for law, nats in laws.items() if _lead(ranked, name, best) < nats] for name in likely}
    certain = tuple(name for name in likely if not rivals[name])
    nothing = sum(each.probability for each in ranked if not each.names and each.axis is None)
    by_axis: dict[GapAxis, float] = {}
    for each in ranked:
        if each.axis is not None and each.names == best:
            by_axis[each.axis] = by_axis.get(each.axis, 0.0) + each.probability
    along = max(by_axis, key=lambda axis: by_axis[axis]) if by_axis else None
    component = sum(by_axis.values())
    more = along if component > LIKELY * sets[best] else None
    tied = tuple(sorted(sets, key=lambda names: -sets[names]))[:4]
    together = sum(value for names, value in sets.items() if set(best) <= set(names))
    ends = [f"{name}.{parameter}" for name, parameter in (at_bound or {}).items() if name in certain]
    family = _family(ranked, settings.named)
    beside = tuple(dict.fromkeys(law for name in likely for law in rivals[name]))
    fits = f"{', '.join(best)}: fits best, but"
    one_of = f"one of {', '.join(family)} is missing" if family else "no few effects stand out"
    not_all = f"named: {', '.join(certain)}; not all of the most probable set: {', '.join(best)}"
    doubtful = ", ".join(sorted(name for name in likely if rivals[name]))
    not_all += f"; may be what is left of the base: {doubtful}" if doubtful else ""
    answer, missing = DiagnosisDecision, f"{' and '.join(best)} {'is' if len(best) == 1 else 'are'} missing"
    rules: list[tuple[bool, DiagnosisDecision]] = [
        (not best and nothing >= component, answer(
            Verdict.NONE if nothing >= settings.named and powered else Verdict.UNDERPOWERED, (), nothing,
            f"that nothing is missing has the probability {nothing:.2f}")),
        (not best and component >= LIKELY, answer(
            Verdict.UNKNOWN, (), component,
            f"no effect of the library explains the gap, a function of {along.label if along else '?'} does", along)),
        (not likely, answer(
            Verdict.AMBIGUOUS, (), sets[best], f"{one_of}; the most probable set has the probability {sets[best]:.2f}",
            more, tied, family)),
        (bool(lacks), answer(
            Verdict.AMBIGUOUS, (), sets[best], f"{fits} these data do not support a name: no {', no '.join(lacks)}",
            more, tied)),
        (not certain, answer(
            Verdict.AMBIGUOUS, (), sets[best],
            f"{fits} may be what is left of the base: {', and '.join(beside)} by another law", more, tied,
            other_laws=beside)),
        (bool(contradiction), answer(
            Verdict.AMBIGUOUS, (), sets[best], f"{', '.join(best)}: {contradiction}", more, tied)),
        (bool(ends), answer(
            Verdict.IMPLAUSIBLE, (), sets[best], f"at the end of its range: {', '.join(ends)}", tied=(best,))),
        (len(set(best)) >= MOST_EFFECTS and (more is not None or set(certain) != set(best)), answer(
            Verdict.AMBIGUOUS, (), sets[best],
            f"{fits} {len(set(best))} effects do not close the gap: it is a curve fitted by effects", more, tied)),
        (set(certain) != set(best), answer(Verdict.INCOMPLETE, certain, sets[best], not_all, tied=tied)),
        (more is not None, answer(
            Verdict.INCOMPLETE, best, component, f"a function of {more.label if more else '?'} is missing too", more)),
        (True, answer(Verdict.NAMED, best, together, f"that {missing} has the probability {together:.3f}")),
    ]  # fmt: skip
    return next(decision for applies, decision in rules if applies)


def _lead(ranked: Sequence[Ranked], name: str, best: Names) -> float:
    """Return the log odds (nats) of the hypotheses with an effect against those of the set `best` without it.

    These are what is left if a law of the base takes the place of the effect; another effect is another answer.
    """
    having = sum(each.probability for each in ranked if name in each.names)
    lacking = sum(each.probability for each in ranked if {*each.names} <= {*best} - {name})
    return math.log(max(having, 1e-300)) - math.log(max(lacking, 1e-300))


def _family(ranked: Sequence[Ranked], wanted: float) -> Names:
    """Return the smallest family that contains a missing effect with the probability `wanted`; empty if over four."""
    found: list[str] = []
    rest = [each for each in ranked if each.names]
    covered = 0.0
    while rest and covered < wanted and len(found) < LARGEST_FAMILY:
        sure: dict[str, float] = {}
        for each in rest:
            for name in set(each.names):
                sure[name] = sure.get(name, 0.0) + each.probability
        found.append(max(sure, key=lambda name: sure[name]))
        covered += sure[found[-1]]
        rest = [each for each in rest if found[-1] not in each.names]
    return tuple(found) if covered >= wanted else ()
