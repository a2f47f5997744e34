"""Probabilities of all hypotheses that a search considered, and their prior."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from needleplan.diagnosis._components import Components
from needleplan.diagnosis._constants import MOST_EFFECTS, STRONG
from needleplan.diagnosis._decision import Names
from needleplan.diagnosis._evidence import Projected
from needleplan.diagnosis._hypothesis import Hypothesis
from needleplan.diagnosis._problem import Problem
from needleplan.diagnosis._settings import Settings
from needleplan.diagnosis.catalogue import CatalogueEntry
from needleplan.signals import Array

__all__ = ["Posterior", "log_prior"]


@dataclass(frozen=True)
class Posterior:
    """Log posterior of every hypothesis that was considered: a set of effects and the name of a component or ""."""

    problem: Problem
    entries: tuple[CatalogueEntry, ...]
    components: Components
    hypotheses: Mapping[Names, Hypothesis]
    """Fitted sets by the names of their effects."""

    logs: Mapping[tuple[Names, str], float]
    """Normalised log posterior by set and component."""

    screened: Projected
    """Slope and curvature of every column of the library, for the empty set of effects."""

    units: Array
    """Amplitude of each column whose output has the RMS of the noise, shape (m,)."""

    def probability(self, names: Names, component: str = "") -> float:
        """Return the probability of a hypothesis; 0 if the search did not consider it.

        `names` are the names of its effects. `component` is the name of its component; "" means no component.
        """
        return min(math.exp(self.logs.get((names, component), -math.inf)), 1.0)

    def without_formula_errors(self) -> tuple[Posterior, list[str]]:
        """Return the posterior without sets whose weaker members may be errors of a stronger one's formula.

        If the formula of an effect is wrong by a share, what another effect or a component gains by closing this error
        is about the squared share of what the effect gains. A member of the most probable hypothesis that gains less
        may be such an error: all hypotheses with it and the strongest member are left out, equation (9), until the most
        probable one has no such member. The result also has a remark on each that gains more than `STRONG` nats.
        """
        logs, remarks = dict(self.logs), list[str]()
        share = self.problem.settings.formula_share
        while True:
            best = max(logs, key=lambda key: logs[key])
            gains = {member: logs[best] - _without(logs, best, member) for member in _members(best)}
            strongest = max(gains, key=lambda member: gains[member], default="")
            weaker = [member for member in gains if gains[member] < share * gains[strongest]]
            if not weaker:
                break
            weakest = min(weaker, key=lambda member: gains[member])
            if gains[weakest] > STRONG:
                remarks.append(
                    f"{weakest} may be an error of the formula of {strongest}: it gains {gains[weakest]:.0f} nats "
                    f"beside {gains[strongest]:.0f}"
                )
            logs = {key: value for key, value in logs.items() if not {weakest, strongest} <= {*_members(key)}}
        total = float(np.logaddexp.reduce(list(logs.values())))
        return replace(self, logs={key: value - total for key, value in logs.items()}), remarks

    @property
    def ranked(self) -> list[tuple[float, Names, str]]:
        """Probability, set and component of all hypotheses, the most probable first."""
        order = sorted(self.logs.items(), key=lambda entry: (entry[1], entry[0]), reverse=True)
        return [(min(math.exp(value), 1.0), *key) for key, value in order]


def _members(key: tuple[Names, str]) -> tuple[str, ...]:
    """Return the names of the effects of a hypothesis, and of its component if it has one."""
    names, component = key
    return tuple(dict.fromkeys([*names, *([component] if component else [])]))


def _without(logs: Mapping[tuple[Names, str], float], best: tuple[Names, str], member: str) -> float:
    """Return the largest log posterior of the hypotheses that have only members of the best one, and not this one."""
    left = {*_members(best)} - {member}
    return max((value for key, value in logs.items() if {*_members(key)} <= left), default=-math.inf)


def log_prior(settings: Settings, every: int, count: int) -> float:
    """Return the log prior of one set of `count` of the effects of a library, equation (8); `every` is their number."""
    if not count:
        return math.log(1 - settings.any_effect)
    more = settings.further_cause
    share = settings.any_effect * more ** (count - 1) * (1 - more)
    return math.log(share) - math.log(math.comb(every, min(count, every, MOST_EFFECTS)))
