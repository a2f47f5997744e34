"""The smallest effects that these data would have shown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis.library import Candidates
from needleplan.diagnosis.space import Space
from needleplan.models.effects import SIZE
from needleplan.signals import Array

__all__ = ["NAMED_FROM", "Smallest", "smallest_seen"]

NAMED_FROM = 45.0
"""Size squared over its variance, with all that the base can take up projected out, from which an effect is named."""


@dataclass(frozen=True)
class Smallest:
    """For one effect: the size that would be seen at half of the places looked at, and its RMS."""

    effect: str
    size: float
    unit: str
    rms: float
    """RMS that this adds to the training data, in the channel's unit."""

    noise_multiple: float
    visible: bool
    """Whether the base leaves anything of it."""

    at: Mapping[str, float]
    """The place that this is said of."""


def smallest_seen(
    space: Space, raw: Sequence[Array], columns: Sequence[Array], candidates: Sequence[Candidates], noise_rms: float
) -> tuple[Smallest, ...]:
    """Return the smallest sizes; `raw` are the columns before whitening."""
    scores = space.scores(columns)
    curvature = scores.curvature[space.best]
    samples = sum(map(len, raw))
    power = np.sqrt(sum(np.einsum("nm,nm->m", each, each) for each in raw) / samples)
    found = []
    for each in candidates:
        part = slice(each.first, each.last)
        visible = curvature[part] > 1e-6 * samples * power[part] ** 2 / noise_rms**2
        sizes = np.sqrt(NAMED_FROM / np.maximum(curvature[part], 1e-12))
        middle = int(np.argsort(sizes)[len(sizes) // 2])
        rms = float(sizes[middle] * power[part][middle])
        unit = each.effect.parameters[SIZE].unit
        found.append(
            Smallest(
                each.effect.name, float(sizes[middle]), unit, rms, rms / noise_rms, bool(visible[middle]),
                dict(each.grid[middle]),
            )
        )  # fmt: skip
    return tuple(found)
