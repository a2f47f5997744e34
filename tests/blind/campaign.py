"""Lists of data sets for a benchmark of the force channel: fixed beforehand, disjoint for tuning and for reporting.

A case keeps its seed whatever the counts are, so that a small campaign is a part of a large one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from tests.blind.effect import ForceName
from tests.blind.force import INSIDE, ForceSpec, Wanted
from tests.blind.motions import POOR, POOR_HELD_OUT, RICH, RICH_HELD_OUT
from tests.blind.outside import NEVER_TUNED, OUTSIDE

HETEROGENEITY = (0.0, 0.03, 0.10)
SMALLEST, LARGEST = 0.05, 6.0  # of sizes, in noise RMS
# A breath of millimetres does twenty times as much to the force as the noise.
LARGEST_OF = {ForceName.RESPIRATION: 24.0}
_ROOM = 1000  # seeds of a row of cases


class Purpose(StrEnum):
    """The seeds of one purpose are never those of the other; TUNING has no effect of NEVER_TUNED."""

    TUNING = "tuning"
    REPORTING = "reporting"


class Stratum(StrEnum):
    NULL = "null"
    SINGLE = "single"
    PAIR = "pair"
    OUTSIDE = "outside"
    ABSORBED = "absorbed"  # hidden, but nobody can see it: scaling that the trials' scatter takes up


class Variety(StrEnum):
    RICH = "rich"
    POOR = "poor"


SEEDS = {Purpose.TUNING: range(10_000_000, 20_000_000), Purpose.REPORTING: range(60_000_000, 70_000_000)}
MOTIONS = {Variety.RICH: (RICH, RICH_HELD_OUT), Variety.POOR: (POOR, POOR_HELD_OUT)}
ABSORBED = (ForceName.GAIN,)
NAMEABLE = tuple(name for name in INSIDE if name not in ABSORBED)
UNSEEN = {Variety.RICH: frozenset[ForceName](), Variety.POOR: frozenset({ForceName.FRESH_CUTTING})}


@dataclass(frozen=True)
class Counts:
    """How many data sets: pairs per level, the rest per level and variety, singles and outside also per effect."""

    rich_nulls: int = 300
    poor_nulls: int = 120
    singles: int = 6
    pairs: int = 100
    outside: int = 6
    absorbed: int = 10


@dataclass(frozen=True)
class Case:
    """One data set of a campaign: what it is for, and its specification."""

    purpose: Purpose
    stratum: Stratum
    variety: Variety
    spec: ForceSpec


def campaign(purpose: Purpose, counts: Counts | None = None) -> Iterator[Case]:
    """Every case of a campaign, stratum by stratum."""
    counts = counts or Counts()
    for level in HETEROGENEITY:
        yield from _cases(purpose, Stratum.NULL, Variety.RICH, level, (), counts.rich_nulls)
        yield from _cases(purpose, Stratum.NULL, Variety.POOR, level, (), counts.poor_nulls)
        for variety in Variety:
            for name in NAMEABLE:
                if name not in UNSEEN[variety]:
                    yield from _cases(purpose, Stratum.SINGLE, variety, level, (name,), counts.singles)
            for kind in OUTSIDE:
                if purpose is Purpose.REPORTING or kind not in NEVER_TUNED:
                    yield from _cases(purpose, Stratum.OUTSIDE, variety, level, (kind.NAME,), counts.outside)
            for name in ABSORBED:
                yield from _cases(purpose, Stratum.ABSORBED, variety, level, (name,), counts.absorbed)
        yield from _pairs(purpose, level, counts.pairs)


def _seed(purpose: Purpose, place: int, index: int) -> int:
    if not 0 <= index < _ROOM:
        raise ValueError(f"index: a row of cases has {_ROOM}, not {index + 1}")
    return SEEDS[purpose].start + place * (_ROOM) + index


def _place(stratum: Stratum, variety: Variety, level: float, names: tuple[ForceName, ...]) -> int:
    """The number of a row of cases. It does not change when effects are added at the end of ForceName."""
    row = [*Stratum].index(stratum) * 6 + [*Variety].index(variety) * 3 + HETEROGENEITY.index(level)
    return row * 100 + (1 + [*ForceName].index(names[0]) if names else 0)


def _drawn(seed: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(3,)))


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _cases(
    purpose: Purpose, stratum: Stratum, variety: Variety, level: float, names: tuple[ForceName, ...], count: int
) -> Iterator[Case]:
    for index in range(count):
        seed = _seed(purpose, _place(stratum, variety, level, names), index)
        wanted = tuple(
            Wanted(name, _log_uniform(_drawn(seed), SMALLEST, LARGEST_OF.get(name, LARGEST))) for name in names
        )
        yield Case(purpose, stratum, variety, ForceSpec(seed, wanted, level, *MOTIONS[variety]))


def _pairs(purpose: Purpose, level: float, count: int) -> Iterator[Case]:
    """Two effects, both of at least 0.2 noise RMS and within a factor of four of each other; rich motion."""
    for index in range(count):
        seed = _seed(purpose, _place(Stratum.PAIR, Variety.RICH, level, ()), index)
        rng = _drawn(seed)
        first, second = rng.choice(len(NAMEABLE), 2, replace=False)
        low = _log_uniform(rng, 0.2, LARGEST / 4)
        high = low * _log_uniform(rng, 1.0, 4.0)
        sizes = (low, high) if rng.random() < 0.5 else (high, low)
        wanted = tuple(Wanted(NAMEABLE[i], size) for i, size in zip((first, second), sizes, strict=True))
        yield Case(purpose, Stratum.PAIR, Variety.RICH, ForceSpec(seed, wanted, level, *MOTIONS[Variety.RICH]))
