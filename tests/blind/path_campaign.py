"""Lists of data sets for a benchmark of the tip path: fixed beforehand, disjoint for tuning and for reporting."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tests.blind.campaign import HETEROGENEITY, SEEDS, Purpose, Stratum, Variety
from tests.blind.path import INSIDE_PATH, Moves, PathSpec
from tests.blind.path_effect import PathName
from tests.blind.path_outside import NEVER_TUNED_PATH, OUTSIDE_PATH
from tests.blind.steering import STRAIGHT_ON, STRAIGHT_ON_HELD_OUT, TWO_SPEED, TWO_SPEED_HELD_OUT

SMALLEST_SIGMAS, LARGEST_SIGMAS = 0.5, 40.0
STEERINGS = {Variety.RICH: (TWO_SPEED, TWO_SPEED_HELD_OUT), Variety.POOR: (STRAIGHT_ON, STRAIGHT_ON_HELD_OUT)}
# What three insertions at one speed without a turn cannot show at all.
UNSEEN_PATH = {
    Variety.RICH: frozenset[PathName](),
    Variety.POOR: frozenset({PathName.CURVATURE_SPEED, PathName.TORSIONAL_LAG, PathName.TURN_SLIP}),
}
_OFFSET, _ROOM = 8_000_000, 1000  # of this channel's seeds in those of a purpose; seeds of a row of cases


@dataclass(frozen=True)
class PathCounts:
    """How many data sets: nulls per level and variety, pairs per level, the rest per effect, level and variety."""

    nulls: int = 100
    singles: int = 8
    pairs: int = 40
    outside: int = 6


SMALL_PATH = PathCounts(3, 1, 2, 1)


@dataclass(frozen=True)
class PathCase:
    """One data set of a campaign: what it is for, and its specification."""

    purpose: Purpose
    stratum: Stratum
    variety: Variety
    spec: PathSpec

    @property
    def never_tuned(self) -> bool:
        return any(each.name in {kind.NAME for kind in NEVER_TUNED_PATH} for each in self.spec.effects)


def path_campaign(purpose: Purpose, counts: PathCounts | None = None) -> Iterator[PathCase]:
    """Every case of a campaign; a case keeps its seed whatever the counts are."""
    counts = counts or PathCounts()
    outside = tuple(each.NAME for each in OUTSIDE_PATH if purpose is Purpose.REPORTING or each not in NEVER_TUNED_PATH)
    for level in HETEROGENEITY:
        for variety in Variety:
            yield from _cases(purpose, Stratum.NULL, variety, level, None, counts.nulls)
            for stratum, names, count in (
                (Stratum.SINGLE, INSIDE_PATH, counts.singles),
                (Stratum.OUTSIDE, outside, counts.outside),
            ):
                for name in names:
                    if name not in UNSEEN_PATH[variety]:
                        yield from _cases(purpose, stratum, variety, level, name, count)
        yield from _cases(purpose, Stratum.PAIR, Variety.RICH, level, None, counts.pairs)


def _cases(
    purpose: Purpose, stratum: Stratum, variety: Variety, level: float, name: PathName | None, count: int
) -> Iterator[PathCase]:
    if count > _ROOM:
        raise ValueError(f"counts: a row of cases has {_ROOM}, not {count}")
    row = [*Stratum].index(stratum) * 6 + [*Variety].index(variety) * 3 + HETEROGENEITY.index(level)
    place = row * 50 + (0 if name is None else 1 + [*PathName].index(name))
    for index in range(count):
        seed = SEEDS[purpose].start + _OFFSET + place * _ROOM + index
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(3,)))
        if stratum is Stratum.PAIR:
            effects = _pair(rng)
        elif name is None:
            effects = ()
        else:
            effects = (Moves(name, _log_uniform(rng, SMALLEST_SIGMAS, LARGEST_SIGMAS)),)
        yield PathCase(purpose, stratum, variety, PathSpec(seed, effects, level, *STEERINGS[variety]))


def _pair(rng: np.random.Generator) -> tuple[Moves, ...]:
    """Two effects of at least 2 sigma, within a factor of four of each other."""
    chosen = rng.choice(len(INSIDE_PATH), 2, replace=False)
    low = _log_uniform(rng, 2.0, LARGEST_SIGMAS / 4)
    sizes = rng.permutation([low, low * _log_uniform(rng, 1.0, 4.0)])
    return tuple(Moves(INSIDE_PATH[i], float(size)) for i, size in zip(chosen, sizes, strict=True))


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
