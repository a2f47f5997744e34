"""Curvature of the path from a model file, converted to the radii and layers of a scenario."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

from needleplan.config import suggestion
from needleplan.errors import Mistake, ModelError, ScenarioError
from needleplan.scenario._parts import Layer, Needle, Tissue

if TYPE_CHECKING:
    from needleplan.models import ModelFile
    from needleplan.signals import Array

__all__ = [
    "CurvaturePiece",
    "HasCurvature",
    "Identified",
    "identified",
    "needle_with",
    "pieces_of",
    "tissues_with",
    "within",
]

# Depth (mm) to which the curvature of a model of the tip's path is evaluated.
_DEEPEST_MM = 200.0
# Shortest piece of constant curvature (mm).
_SHORTEST_MM = 2.0
# Largest relative difference from the median curvature within a piece.
_WITHIN = 0.02


class HasCurvature(Protocol):
    """The curvature of a piece of the path, such as `needleplan.identification.Curvature`."""

    @property
    def curvature_per_mm(self) -> float:
        """Curvature (1/mm); its sign depends on the side of the bevel."""

    @property
    def low_mm(self) -> float:
        """Position along the insertion at which the piece begins (mm)."""


@dataclass(frozen=True)
class CurvaturePiece:
    """A piece of the path with constant curvature (1/mm); it begins at x = `low_mm` from the entry."""

    low_mm: float
    curvature_per_mm: float


@dataclass(frozen=True)
class Identified:
    """An identified positive curvature (1/mm) with its 95 % interval, or NaN if there is no interval.

    `kind` is the kind of the model, `trials` the number of trials of the identification, `digest` the digest of the
    model file.
    """

    curvature_per_mm: float
    low_per_mm: float
    high_per_mm: float
    kind: str
    trials: int
    digest: str
    pieces: tuple[CurvaturePiece, ...] = ()
    """All pieces of a path whose curvature changes; `curvature_per_mm` is then the curvature of the first piece."""

    @property
    def radius_mm(self) -> float:
        """Radius of the arc (mm)."""
        return 1 / self.curvature_per_mm

    @property
    def interval_mm(self) -> tuple[float, float]:
        """The 95 % interval of the radius (mm); NaN if there is no interval."""
        return 1 / self.high_per_mm, 1 / self.low_per_mm

    def __str__(self) -> str:
        low, high = self.interval_mm
        interval = f" (95 % interval {low:.4g} to {high:.4g})" if math.isfinite(low) else " (no interval)"
        trials = f" from {self.trials} trial{'s' * (self.trials != 1)}" if self.trials else ""
        layers = f", {len(self.pieces)} pieces" if self.pieces else ""
        return f"radius {self.radius_mm:.4g} mm{interval}{layers}, {self.kind} identified{trials}"


def identified(file: ModelFile, source: str | os.PathLike[str] = "", velocity_mm_s: float = 5.0) -> Identified:
    """Return the curvature of a path from a model of the kind `bicycle`, `tip_path` or `spatial_bicycle`.

    For `tip_path` the curvature is that far behind the entry; it is proportional to the force on the bevel, whose
    interval gives the interval of the curvature. For `spatial_bicycle`, with the effects that a diagnosis added, it is
    the curvature in the plane of an insertion at `velocity_mm_s` (`needleplan.models.in_plane`). Raises ModelError for
    other kinds, for a path that becomes straight, and if the interval contains a straight path: it has no radius.
    """
    from needleplan.models import Bicycle, Channel, SpatialBicycle, TipPath, in_plane

    model = file.model
    pieces: tuple[CurvaturePiece, ...] = ()
    if isinstance(model, Bicycle):
        name, value = "curvature_per_mm", model.curvature_per_mm
    elif isinstance(model, TipPath):
        name, value = "cutting_force", model.curvature_1_mm
        if model.anchoring < 1:
            rule = "must be 1: the tissue gives way, the path becomes straight and has no radius"
            raise ModelError(Mistake("parameters.anchoring.value", f"{model.anchoring:g}", rule), os.fspath(source))
    elif model.channel is Channel.TIP:
        bends = in_plane(model, _DEEPEST_MM, velocity_mm_s)
        pieces = pieces_of(bends.along_mm, bends.curvature_per_mm)
        name, value = "curvature_per_mm", pieces[0].curvature_per_mm
    else:
        kinds = f"{Bicycle.name}, {TipPath.name} or {SpatialBicycle.name}"
        rule = f"must be {kinds}: no curvature of a path follows from other models"
        raise ModelError(Mistake("kind", file.model.name, rule), os.fspath(source))
    estimate = file.estimates.get(name)
    ends = (estimate.low / estimate.value, estimate.high / estimate.value) if estimate and estimate.value else ()
    if value == 0 or (estimate and not (estimate.identified and ends and min(ends) > 0)):
        interval = f"{estimate.low:.4g} to {estimate.high:.4g}" if estimate else f"{value:.4g}"
        rule = "is not identified: a straight path is possible, and a plan needs a radius"
        raise ModelError(Mistake(f"parameters.{name}", interval, rule), os.fspath(source))
    low, high = sorted(abs(value) * end for end in ends) if ends else (math.nan, math.nan)
    trials = len(file.parents)
    return Identified(abs(value), low, high, model.name, trials, file.digest, pieces if len(pieces) > 1 else ())


def pieces_of(along_mm: Array, curvature_per_mm: Array) -> tuple[CurvaturePiece, ...]:
    """Return pieces of constant curvature from the curvature at places along x, shape (n,) each, increasing from 0.

    A piece is cut in two where the sum of squared differences from the means is smallest. It is cut until all places
    but one are within 2 % of its median, or its parts would be shorter than 2 mm.
    """
    return tuple(
        CurvaturePiece(
            float(along_mm[first] + along_mm[max(first - 1, 0)]) / 2, float(curvature_per_mm[first:last].mean())
        )
        for first, last in _cut(along_mm, curvature_per_mm, 0, len(along_mm))
    )


def within(pieces: Sequence[CurvaturePiece], along_mm: float) -> tuple[CurvaturePiece, ...]:
    """Return the pieces that begin before x = `along_mm`, because layers must begin in the workspace."""
    return tuple(each for each in pieces if each.low_mm < along_mm)


def _cut(along: Array, bend: Array, first: int, last: int) -> Iterator[tuple[int, int]]:
    import numpy as np

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


def needle_with(curvature_per_mm: float | Sequence[HasCurvature], entry_mm: float) -> Needle:
    """Return a needle with one curvature, or, for pieces of a path, with one layer per piece. Raises ScenarioError."""
    if not isinstance(curvature_per_mm, Sequence):
        return Needle(_radius_mm(curvature_per_mm))
    if not curvature_per_mm:
        raise ScenarioError(Mistake("curvature_per_mm", "[]", "must be a number or at least one piece of a path"))
    first, *others = curvature_per_mm
    layers = tuple(Layer(entry_mm + each.low_mm, _radius_mm(each.curvature_per_mm)) for each in others)
    return Needle(_radius_mm(first.curvature_per_mm), layers)


def tissues_with(
    tissues: Sequence[Tissue], curvature_per_mm: float | Sequence[HasCurvature], name: str
) -> tuple[Tissue, ...]:
    """Return the tissues after setting the curvature of all tissues called `name`. Raises ScenarioError."""
    if isinstance(curvature_per_mm, Sequence):
        raise ScenarioError(Mistake("curvature_per_mm", "", f'must be one number for the tissue "{name}"'))
    names = [each.name for each in tissues]
    if name not in names:
        rule = "there is no [[tissue]] of that name" + suggestion(name, filter(None, names))
        raise ScenarioError(Mistake("tissue", f'"{name}"', rule))
    radius = _radius_mm(curvature_per_mm)
    return tuple(replace(each, curvature_radius_mm=radius) if each.name == name else each for each in tissues)


def _radius_mm(curvature_per_mm: float) -> float:
    if not curvature_per_mm or not math.isfinite(curvature_per_mm):
        rule = "must be a finite number other than 0: a plan needs a needle that bends"
        raise ScenarioError(Mistake("curvature_per_mm", f"{curvature_per_mm:g}", rule))
    return abs(1 / curvature_per_mm)
