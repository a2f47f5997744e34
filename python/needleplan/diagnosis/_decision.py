"""The answer of a diagnosis from posterior probabilities of sets of effects: one function, no gates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from scipy.special import ndtri

from needleplan.diagnosis._settings import Settings
from needleplan.diagnosis.channels import GapAxis

__all__ = ["DiagnosisDecision", "Names", "Ranked", "Verdict", "decide"]

Names = tuple[str, ...]
"""Names of the effects of a set."""

# Probability from which something is more probable than not.
_LIKELY = 0.5
# Largest number of effects that are reported as a family of which one is missing.
_LARGEST_FAMILY = 4


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

    LAW_DIFFERS = "law_differs"
    """An effect is present, but a smooth function along its own axis describes it better than its law."""

    IMPLAUSIBLE = "implausible"
    """An amplitude, or a time constant, of an effect is at the end of its range: it stands for something else."""


@dataclass(frozen=True)
class Ranked:
    """One hypothesis: its probability, its effects, and the axis of its nonparametric component, None without one."""

    probability: float
    names: Names
    axis: GapAxis | None = None


@dataclass(frozen=True)
class DiagnosisDecision:
    """The answer with its probability, the effects that it names, and its reason."""

    verdict: Verdict
    names: Names
    probability: float
    because: str
    axis: GapAxis | None = None
    tied: tuple[Names, ...] = ()
    """Sets among which the data do not decide, the most probable first."""

    family: Names = ()
    """Fewest effects of which at least one is missing with the probability of a name, if no single one is certain."""

    other_laws: tuple[str, ...] = ()
    """Laws of the base that differ from the model's, if nothing is named for this reason."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "probability", min(self.probability, 1.0))  # a sum of probabilities may round up


def decide(
    ranked: Sequence[Ranked],
    settings: Settings,
    *,
    axes: Mapping[str, GapAxis],
    powered: bool = True,
    at_bound: Mapping[str, str] | None = None,
    transfer_z: float = 0.0,
    transfers: int = 1,
    lacks: Sequence[str] = (),
    doubted: Mapping[str, Names] | None = None,
) -> DiagnosisDecision:
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
        Parameter at the end of its range, by effect of the most probable set.
    transfer_z
        Largest deviation of leave-one-motion-out, in standard deviations.
    transfers
        Number of deviations of which `transfer_z` is the largest.
    lacks
        Data that are missing and without which nothing is named.
    doubted
        By law of the base that differs from the model's, the effects that may be what is left of this deviation.

    Returns
    -------
    DiagnosisDecision
        Answer, names and reason.
    """
    sets: dict[Names, float] = {}
    sure: dict[str, float] = {}
    for each in ranked:
        sets[each.names] = sets.get(each.names, 0.0) + each.probability
        for name in set(each.names):
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
    more = along if component > _LIKELY * sets[best] else None
    tied = tuple(sorted(sets, key=lambda names: -sets[names]))[:4]
    together = sum(value for names, value in sets.items() if set(best) <= set(names))
    if not best and nothing >= component:
        sure_of_it = nothing >= settings.named and powered
        answer = Verdict.NONE if sure_of_it else Verdict.UNDERPOWERED
        return DiagnosisDecision(answer, (), nothing, f"that nothing is missing has the probability {nothing:.2f}")
    if not best and component >= _LIKELY:
        why = f"no effect of the library explains the gap, a function of {along.label if along else '?'} does"
        return DiagnosisDecision(Verdict.UNKNOWN, (), component, why, along)
    if not certain:
        family = _family(ranked, settings.named)
        why = f"one of {', '.join(family)} is missing" if family else "no few effects stand out"
        why += f"; the most probable set has the probability {sets[best]:.2f}"
        return DiagnosisDecision(Verdict.AMBIGUOUS, (), sets[best], why, more, tied, family)
    if lacks:
        why = f"{', '.join(best)}: fits best, but these data do not support a name: no {', no '.join(lacks)}"
        return DiagnosisDecision(Verdict.AMBIGUOUS, (), sets[best], why, more, tied)
    small = {name for names in (doubted or {}).values() for name in names}
    certain = tuple(name for name in certain if name not in small)
    if not certain:
        laws = tuple(doubted or {})
        why = f"{', '.join(best)}: fits best, but may be what is left of the base: {', and '.join(laws)} by another law"
        return DiagnosisDecision(Verdict.AMBIGUOUS, (), sets[best], why, more, tied, other_laws=laws)
    if abs(transfer_z) > -ndtri(settings.transfer / 2 / max(transfers, 1)):
        why = f"{', '.join(best)}: one trial contradicts the others by {transfer_z:.1f} standard deviations"
        return DiagnosisDecision(Verdict.AMBIGUOUS, (), sets[best], why, more, tied)
    if ends := [f"{name}.{parameter}" for name, parameter in (at_bound or {}).items() if name in certain]:
        why = f"at the end of its range: {', '.join(ends)}"
        return DiagnosisDecision(Verdict.IMPLAUSIBLE, (), sets[best], why, tied=(best,))
    if set(certain) != set(best):
        beside = f"; may be what is left of the base: {', '.join(sorted(small))}" if small else ""
        why = f"named: {', '.join(certain)}; not all of the most probable set: {', '.join(best)}{beside}"
        return DiagnosisDecision(Verdict.INCOMPLETE, certain, sets[best], why, tied=tied)
    if more is not None:
        own = [name for name in best if axes.get(name) is more]
        if own:
            why = f"{', '.join(own)} or an effect alike: a function of {more.label} fits better than the law"
            return DiagnosisDecision(Verdict.LAW_DIFFERS, (), component, why, more, (best,))
        why = f"a function of {more.label} is missing too"
        return DiagnosisDecision(Verdict.INCOMPLETE, best, component, why, more)
    why = f"that {' and '.join(best)} {'is' if len(best) == 1 else 'are'} missing has the probability {together:.3f}"
    return DiagnosisDecision(Verdict.NAMED, best, together, why)


def _family(ranked: Sequence[Ranked], wanted: float) -> Names:
    """Return the fewest effects of which at least one is missing with the probability `wanted`; none if over four."""
    found: list[str] = []
    rest = [each for each in ranked if each.names]
    covered = 0.0
    while rest and covered < wanted and len(found) < _LARGEST_FAMILY:
        sure: dict[str, float] = {}
        for each in rest:
            for name in set(each.names):
                sure[name] = sure.get(name, 0.0) + each.probability
        found.append(max(sure, key=lambda name: sure[name]))
        covered += sure[found[-1]]
        rest = [each for each in rest if found[-1] not in each.names]
    return tuple(found) if covered >= wanted else ()
