"""Which effects can be told from which, in the motions at hand: how well one imitates what another does.

Of an effect counts what is left when the base has taken up what it can and the sensor's noise and the tissue's
variation are weighed. With a the columns of one effect and b those of another, over all of their places,

    imitated = max over b of (a'b)^2 / (a'a b'b),

for the place of the first that is seen in the middle of all. At 1, no number of such trials tells them apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis.calibrate import Calibration, Case
from needleplan.diagnosis.library import Library
from needleplan.signals import Array

__all__ = ["Isolability", "isolability"]

_ALIKE = 0.8
_INVISIBLE = 1e-6
"""Share of a column's energy below which the base has taken it up."""


@dataclass(frozen=True)
class Isolability:
    """`imitated[i, j]`: share, 0 to 1, of what effect i shows that effect j shows too; NaN where i shows nothing."""

    effects: tuple[str, ...]
    imitated: Array

    def alike(self, share: float = _ALIKE) -> tuple[tuple[str, str, float], ...]:
        """Return pairs (effect, imitator, share) from `share` on, the most alike first."""
        found = [
            (self.effects[i], self.effects[j], float(self.imitated[i, j]))
            for i in range(len(self.effects))
            for j in range(len(self.effects))
            if i != j and self.imitated[i, j] >= share
        ]
        return tuple(sorted(found, key=lambda each: -each[2]))


def isolability(calibration: Calibration, library: Library, level: float) -> Isolability:
    """Return the matrix for the training trials, with tissue that varies by `level`."""
    cases = calibration.training
    candidates = library.candidates([case.motion for case in cases])
    parts, raw = [], np.zeros(candidates[-1].last)
    for case in cases:
        whitened = case.whiten(library.columns(calibration.model, case.motion, candidates))
        raw += (whitened**2).sum(axis=0)
        parts.append(_left(case, whitened, level))
    left = np.vstack(parts)
    energy = (left**2).sum(axis=0)
    seen = energy > _INVISIBLE * raw
    unit = left / np.sqrt(np.where(seen, energy, 1.0))
    imitated = np.full((len(candidates), len(candidates)), np.nan)
    visible = [np.arange(each.first, each.last)[seen[each.first : each.last]] for each in candidates]
    shown = [i for i, places in enumerate(visible) if places.size]
    middles = [int(visible[i][np.argsort(energy[visible[i]], kind="stable")[visible[i].size // 2]]) for i in shown]
    likeness = np.where(seen, (unit[:, middles].T @ unit) ** 2, 0.0)
    for i, alike in zip(shown, likeness, strict=True):
        for j, other in enumerate(candidates):
            imitated[i, j] = 1.0 if i == j else _best(alike, other.first, other.last)
    return Isolability(tuple(each.effect.name for each in candidates), imitated)


def _best(likeness: Array, first: int, last: int) -> float:
    return float(np.clip(likeness[first:last].max(), 0.0, 1.0))


def _left(case: Case, columns: Array, level: float) -> Array:
    """Return whitened columns, weighed by the tissue's variation and free of all that the base can take up."""
    weighed = _weighed(case, (case.block.sensitivities, columns), level)
    basis = np.linalg.qr(weighed[0])[0]
    return np.asarray(weighed[1] - basis @ (basis.T @ weighed[1]), float)


def _weighed(case: Case, many: Sequence[Array], level: float) -> list[Array]:
    block = case.block
    # (1 + level^2 variance)^(-1/2) along each mode, which are orthonormal.
    share = 1 - 1 / np.sqrt(1 + level**2 * block.variances)
    return [each - block.modes @ (share[:, None] * (block.modes.T @ each)) for each in many]
