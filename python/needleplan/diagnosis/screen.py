"""Every effect over its grid: how much more likely the data are with it, after everything the base can take up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis.library import Candidates
from needleplan.diagnosis.space import Space
from needleplan.models.effects import SIZE, Effect
from needleplan.signals import Array

__all__ = ["Screened", "allowed_sizes", "hills", "screen"]

_NEAR = (0.4, 2.5)
"""How far the size of an effect that is not linear in it may be from the one that its column was made for."""


@dataclass(frozen=True)
class Screened:
    """An effect where it fits best: gain is twice that in log likelihood, balance what Schwarz' criterion leaves."""

    effect: Effect
    values: Mapping[str, float]
    """With the size."""

    gain: float
    balance: float
    size_sd: float
    level: float
    """Heterogeneity that goes with it."""


def screen(space: Space, columns: Sequence[Array], candidates: Sequence[Candidates]) -> tuple[Screened, ...]:
    """Return all effects, the best first. `columns` are whitened, one array for each trial."""
    scored = _Scored.of(space, columns, candidates)
    found = [scored.at(each, each.first + int(scored.gains[each.first : each.last].argmax())) for each in candidates]
    return tuple(sorted(found, key=lambda each: -each.balance))


def hills(
    space: Space, columns: Sequence[Array], candidates: Sequence[Candidates], effect: Effect, name: str
) -> tuple[Screened, ...]:
    """Return one effect where it fits best for each value of one of its parameters, the best first."""
    scored = _Scored.of(space, columns, candidates)
    each = next(each for each in candidates if each.effect is effect)
    best: dict[float, int] = {}
    for index in range(each.first, each.last):
        value = each.grid[index - each.first][name]
        if value not in best or scored.gains[index] > scored.gains[best[value]]:
            best[value] = index
    return tuple(sorted((scored.at(each, index) for index in best.values()), key=lambda found: -found.balance))


@dataclass(frozen=True)
class _Scored:
    """All columns, each with the size that it may have."""

    space: Space
    curvature: Array
    sizes: Array
    gains: Array
    levels: Array

    @classmethod
    def of(cls, space: Space, columns: Sequence[Array], candidates: Sequence[Candidates]) -> _Scored:
        scores = space.scores(columns)
        sizes = allowed_sizes(scores.sizes(), candidates)
        return cls(space, scores.curvature, sizes, *scores.gains(sizes))

    def at(self, each: Candidates, index: int) -> Screened:
        level = int(self.levels[index])
        curvature = float(self.curvature[level, index])
        values = {**each.grid[index - each.first], SIZE: float(self.sizes[level, index])}
        sd = curvature**-0.5 if curvature > 0 else float("inf")
        gain = float(self.gains[index])
        balance = gain - each.count * self.space.price
        return Screened(each.effect, values, gain, balance, sd, float(self.space.levels[level]))


def allowed_sizes(sizes: Array, candidates: Sequence[Candidates]) -> Array:
    """Return sizes, shape (levels, m), within the bounds of their effect; 0 where they do not belong to their column.

    A share of more than the whole explains nothing, however well its column fits: what counts is what the bound allows.
    """
    found = np.array(sizes, float)
    for each in candidates:
        part = sizes[:, each.first : each.last]
        what = each.effect.parameters[SIZE]
        guessed = each.guessed()
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = part / guessed
        least = np.where(guessed > np.nanmin(guessed, initial=np.inf), _NEAR[0], 0.0)  # what is small is nearly linear
        belongs = np.isnan(guessed) | ((ratio > least) & (ratio < _NEAR[1]))
        found[:, each.first : each.last] = np.where(belongs, np.clip(part, what.lower, what.upper), 0.0)
    return found
