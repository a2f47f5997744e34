"""Probabilities of all hypotheses that a search considered, and their prior."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from needleplan.diagnosis._components import Components
from needleplan.diagnosis._constants import MOST_EFFECTS
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

    @property
    def ranked(self) -> list[tuple[float, Names, str]]:
        """Probability, set and component of all hypotheses, the most probable first."""
        order = sorted(self.logs.items(), key=lambda entry: (entry[1], entry[0]), reverse=True)
        return [(min(math.exp(value), 1.0), *key) for key, value in order]


def log_prior(settings: Settings, every: int, count: int) -> float:
    """Return the log prior of one set of `count` of the effects of a library, equation (8); `every` is their number."""
    if not count:
        return math.log(1 - settings.any_effect)
    more = settings.further_cause
    share = settings.any_effect * more ** (count - 1) * (1 - more)
    return math.log(share) - math.log(math.comb(every, min(count, every, MOST_EFFECTS)))
