"""A curvature that changes along the path, as pieces of constant curvature: the layers of a scenario."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.signals import Array

__all__ = ["Piece", "pieces_of", "within"]

_SHORTEST_MM = 2.0
_WITHIN = 0.02


@dataclass(frozen=True)
class Piece:
    """A piece of the path with a curvature of its own; `low_mm` is the x, from the entry on, at which it begins."""

    low_mm: float
    curvature_per_mm: float


def pieces_of(along_mm: Array, curvature_per_mm: Array) -> tuple[Piece, ...]:
    """Return pieces of the curvature at places along x, shape (n,) each, increasing from 0.

    A piece is cut in two where that brings it nearest to the curvature, until all of it but one place is within 2 %
    of the median, or pieces would be shorter than 2 mm.
    """
    return tuple(
        Piece(float(along_mm[first] + along_mm[max(first - 1, 0)]) / 2, float(curvature_per_mm[first:last].mean()))
        for first, last in _cut(along_mm, curvature_per_mm, 0, len(along_mm))
    )


def within(pieces: Sequence[Piece], along_mm: float) -> tuple[Piece, ...]:
    """Return the pieces that begin before a place: a scenario has none beyond its workspace."""
    return tuple(each for each in pieces if each.low_mm < along_mm)


def _cut(along: Array, bend: Array, first: int, last: int) -> Iterator[tuple[int, int]]:
    part = bend[first:last]
    allowed = [
        at for at in range(first + 1, last)
        if along[at] - along[first] >= _SHORTEST_MM and along[last - 1] - along[at] >= _SHORTEST_MM
    ]  # fmt: skip
    odd = np.sum(np.abs(part / np.median(part) - 1) > _WITHIN)
    if odd <= 1 or not allowed:
        yield first, last
        return
    left = [np.var(bend[first:at]) * (at - first) + np.var(bend[at:last]) * (last - at) for at in allowed]
    best = allowed[int(np.argmin(left))]
    yield from _cut(along, bend, first, best)
    yield from _cut(along, bend, best, last)
