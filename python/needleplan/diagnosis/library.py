"""All effects over all places, times and speeds where they are looked for, as columns along the motions at hand."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from needleplan.artifacts import digest
from needleplan.models import Model, Scale
from needleplan.models.effects import SIZE, Effect, Reach
from needleplan.signals import Array, Motion

__all__ = ["Candidates", "Library"]

_STEP = 2.0
_SLACK = 1.3


@dataclass(frozen=True)
class Candidates:
    """One effect: where it is looked for, m places."""

    effect: Effect
    grid: tuple[Mapping[str, float], ...]
    first: int
    """Where its columns begin."""

    @cached_property
    def words(self) -> str:
        """Effect and grid: what its columns are kept by."""
        return f"{self.effect.name} {self.grid}"

    @property
    def last(self) -> int:
        """Where they end."""
        return self.first + len(self.grid)

    @property
    def count(self) -> int:
        """How many parameters it has, size included."""
        return len(self.effect.parameters)

    @property
    def sign(self) -> int:
        """Sign that the size must have: +1, -1, or 0 for either."""
        what = self.effect.parameters[SIZE]
        return 1 if what.lower >= 0 else -1 if what.upper <= 0 else 0

    @property
    def is_hilly(self) -> bool:
        """Whether it is far from linear, in its size and in others: between two places there may be a valley."""
        return self.count > 2 and any(SIZE in each for each in self.grid)

    def within(self) -> dict[str, tuple[float, float]]:
        """Return the hull of the grid, by parameter, and a little more. An angle comes round and has none."""
        names = [
            name for name, what in self.effect.parameters.items()
            if name != SIZE and what.unit != "rad" and any(name in each for each in self.grid)
        ]  # fmt: skip
        found = {}
        for name in names:
            values = sorted({each[name] for each in self.grid})
            if self.effect.parameters[name].scale is Scale.LOG:
                found[name] = (values[0] / _SLACK, values[-1] * _SLACK)
            else:
                step = values[1] - values[0] if len(values) > 1 else 0.0
                found[name] = (values[0] - step, values[-1] + step)
        return {name: ends for name, ends in found.items() if ends[0] < ends[1]}

    def guessed(self) -> Array:
        """Return for what size each column was made, shape (m,); NaN where the effect is linear in its size."""
        return np.array([values.get(SIZE, np.nan) for values in self.grid])


@dataclass
class Library:
    """Columns by motion, made once and kept: recordings of the same motions share them."""

    effects: Sequence[Effect]
    nominal: Model
    _kept: dict[tuple[str, str], Array] = field(default_factory=dict, repr=False)

    def candidates(self, motions: Sequence[Motion]) -> tuple[Candidates, ...]:
        """Return the grids of all effects in what some motions visit."""
        reach = Reach.of(motions)
        found: list[Candidates] = []
        first = 0
        for effect in self.effects:
            grid = tuple(effect.grid(reach)) if effect.suits(self.nominal) else ()
            if grid:
                found.append(Candidates(effect, grid, first))
                first += len(grid)
        return tuple(found)

    def columns(self, model: Model, motion: Motion, candidates: Sequence[Candidates]) -> Array:
        """Return what the output gains for each candidate, shape (samples, m).

        Columns are for the nominal model unless `model` is far from it, so that data sets of one needle share them.
        """
        near = _near(model, self.nominal)
        rows = motion.time_s, motion.depth_mm, motion.velocity_mm_s, motion.angle_rad
        place = digest(b"".join(row.tobytes() for row in rows))
        keys = [(place, f"{near} {each.words}") for each in candidates]
        whole = (place, f"{near} {' '.join(each.words for each in candidates)}")
        if whole not in self._kept:
            for key, each in zip(keys, candidates, strict=True):
                if key not in self._kept:
                    self._kept[key] = each.effect.columns(near, motion, each.grid)
            self._kept[whole] = stacked = np.column_stack([self._kept[key] for key in keys])
            stacked.flags.writeable = False
            ends = np.cumsum([len(each.grid) for each in candidates])
            self._kept |= zip(keys, np.split(stacked, ends[:-1], axis=1), strict=True)  # so that all is kept once
        return self._kept[whole]


def _near(model: Model, nominal: Model) -> Model:
    """Return the nominal model, with each parameter that is far from it moved by factors of two."""
    values = {}
    for name, what in model.parameters().items():
        given, nominal_value = getattr(model, name), getattr(nominal, name)
        if what.free and given * nominal_value > 0:
            near = nominal_value * _STEP ** round(math.log(given / nominal_value) / math.log(_STEP))
            values[name] = min(max(near, what.lower), what.upper)
    return nominal.with_values(**values)
