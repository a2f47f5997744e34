"""The curvature that a model file holds, as a scenario wants it."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from needleplan.errors import Mistake, ModelError
from needleplan.scenario.pieces import Piece, pieces_of

if TYPE_CHECKING:
    from needleplan.models import ModelFile

__all__ = ["Bend", "Identified", "identified"]

_DEEPEST_MM = 200.0


class Bend(Protocol):
    """The curvature of a piece of the path, such as `needleplan.estimation.Curvature`."""

    @property
    def curvature_per_mm(self) -> float:
        """Curvature, 1/mm; its sign, the side on which the bevel was, does not matter."""

    @property
    def low_mm(self) -> float:
        """Where the piece begins, in mm along the insertion."""


@dataclass(frozen=True)
class Identified:
    """An identified curvature, 1/mm and positive, with its 95 % interval, NaN where there is none.

    `kind` is that of the model, `trials` the number of trials that it was identified from, `digest` that of the file.
    """

    curvature_per_mm: float
    low_per_mm: float
    high_per_mm: float
    kind: str
    trials: int
    digest: str
    pieces: tuple[Piece, ...] = ()
    """Where the curvature changes along the path: all of its pieces, of which `curvature_per_mm` is the first."""

    @property
    def radius_mm(self) -> float:
        """Radius of the arc."""
        return 1 / self.curvature_per_mm

    @property
    def interval_mm(self) -> tuple[float, float]:
        """The ends of the interval as radii; NaN where there is none."""
        return 1 / self.high_per_mm, 1 / self.low_per_mm

    def __str__(self) -> str:
        low, high = self.interval_mm
        interval = f" (95 % interval {low:.4g} to {high:.4g})" if math.isfinite(low) else " (no interval)"
        trials = f" from {self.trials} trial{'s' * (self.trials != 1)}" if self.trials else ""
        layers = f", {len(self.pieces)} pieces" if self.pieces else ""
        return f"radius {self.radius_mm:.4g} mm{interval}{layers}, {self.kind} identified{trials}"


def identified(file: ModelFile, source: str | os.PathLike[str] = "", velocity_mm_s: float = 5.0) -> Identified:
    """Return the curvature of a path from a model of the kind `bicycle`, `tip_path` or `spatial_bicycle`.

    Of `tip_path` it is the curvature well after the entry, its interval that of the force on the bevel, to which it is
    proportional. Of `spatial_bicycle`, with the effects that a diagnosis has added, it is what a plan can take of it
    for an insertion at that speed (`needleplan.models.in_plane`). Raises ModelError for other kinds, for a path that
    becomes straight, and where the interval says that a straight path is possible: no radius follows from that.
    """
    from needleplan.models import Bicycle, Channel, SpatialBicycle, TipPath, in_plane

    model = file.model
    pieces: tuple[Piece, ...] = ()
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
