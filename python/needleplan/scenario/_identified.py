"""Read the curvature of the path from a model file and convert it to the radii and layers of a scenario."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

from needleplan.artifacts import CallRepr
from needleplan.config import suggestion
from needleplan.errors import Mistake, ModelError, ScenarioError
from needleplan.scenario._parts import Layer, Needle, Tissue

if TYPE_CHECKING:
    from needleplan.models import BicycleByDepth, ModelFile
    from needleplan.signals import Array

__all__ = [
    "CurvaturePiece",
    "EntryPose",
    "HasCurvature",
    "Identified",
    "identified",
    "needle_with",
    "pieces_of",
    "tissues_with",
    "within",
]

# Inserted length (mm) to which the curvature of a model of the tip's path is evaluated.
_DEEPEST_MM = 200.0
# Shortest piece of constant curvature (mm).
_SHORTEST_MM = 2.0
# Largest number of pieces into which a curvature that is linear between depths is divided.
_MOST_PIECES = 8
# Relative difference from the median curvature above which a sample counts as different from its piece.
_WITHIN = 0.02


class HasCurvature(Protocol):
    """Protocol of a piece of the path with a curvature, such as `needleplan.identification.Curvature`."""

    @property
    def curvature_per_mm(self) -> float:
        """Curvature (1/mm). Only the magnitude is used; the sign depends on the side of the bevel."""

    @property
    def low_mm(self) -> float:
        """Distance along x from the entry to the beginning of the piece (mm)."""


@dataclass(frozen=True)
class CurvaturePiece:
    """A piece of the path with constant curvature (1/mm). `low_mm` is the distance along x from entry to piece."""

    low_mm: float
    curvature_per_mm: float


@dataclass(frozen=True)
class EntryPose:
    """Pose of the tip at the entry relative to the guide, with its scatter between insertions.

    Parameters
    ----------
    heading_rad, offset_mm : float
        Heading and lateral offset of the tip, positive to the left, for the bevel side `side`.
    heading_sd_rad, offset_sd_mm : float
        Standard deviations between insertions; 0 if unknown.
    side : int
        Bevel side of the identification, +1 if the path bends to the left.

    Examples
    --------
    >>> from needleplan.scenario import EntryPose
    >>> EntryPose(heading_rad=0.05).side
    1
    """

    heading_rad: float = 0.0
    offset_mm: float = 0.0
    heading_sd_rad: float = 0.0
    offset_sd_mm: float = 0.0
    side: int = 1


@dataclass(frozen=True)
class Identified(CallRepr):
    """An identified curvature (1/mm, positive) with the 95 % interval from `low_per_mm` to `high_per_mm`.

    Both limits are NaN if the model file has no interval. `kind` is the kind of the model, `trials` the number of files
    from which the model was identified, `digest` the digest of the model file.
    """

    curvature_per_mm: float
    low_per_mm: float
    high_per_mm: float
    kind: str
    trials: int
    digest: str
    pieces: tuple[CurvaturePiece, ...] = ()
    """The pieces of constant curvature if the curvature changes along the path, else empty.

    If there are pieces, `curvature_per_mm` is the curvature of the first piece that bends. A straight piece has the
    curvature 0.
    """

    entry: EntryPose | None = None
    """Pose of the tip at the entry relative to the guide; None if the file says that there is no deviation."""

    @property
    def radius_mm(self) -> float:
        """Radius of the arc (mm); of the first piece if there are pieces."""
        return 1 / self.curvature_per_mm

    @property
    def interval_mm(self) -> tuple[float, float]:
        """Lower and upper limit (mm) of the 95 % interval of the radius; both NaN if there is no interval."""
        return 1 / self.high_per_mm, 1 / self.low_per_mm

    def ratios_to(self, planned_per_mm: float) -> tuple[float, float] | None:
        """Return the 95 % interval of the curvature relative to a planned one (1/mm); None if there is no interval.

        Examples
        --------
        >>> from needleplan.scenario import Identified
        >>> Identified(0.01, 0.008, 0.012, "bicycle", 1, "").ratios_to(0.016)
        (0.5, 0.75)
        """
        if not math.isfinite(self.low_per_mm):
            return None
        return self.low_per_mm / planned_per_mm, self.high_per_mm / planned_per_mm

    def __str__(self) -> str:
        low, high = self.interval_mm
        interval = f" (95 % interval {low:.4g} to {high:.4g})" if math.isfinite(low) else " (no interval)"
        trials = f" from {self.trials} trial{'s' * (self.trials != 1)}" if self.trials else ""
        layers = f", {len(self.pieces)} pieces" if self.pieces else ""
        return f"radius {self.radius_mm:.4g} mm{interval}{layers}, {self.kind} identified{trials}"


def identified(file: ModelFile, source: str | os.PathLike[str] = "", velocity_mm_s: float = 5.0) -> Identified:
    """Return the curvature of the path that a model of the tip's path predicts.

    - `bicycle`: the curvature of the model.
    - `bicycle_by_depth`: at most `_MOST_PIECES` pieces. A piece that bends to the other side than the whole path is
      straight.
    - `tip_path`: the curvature far behind the entry. The interval has the same relative limits as the interval of the
      cutting force, to which the curvature is proportional.
    - `spatial_bicycle`, with or without effects: the curvature in the plane (`needleplan.models.in_plane`), in pieces
      if it changes along the path.

    Parameters
    ----------
    file : ModelFile
        Model file.
    source : str or path, optional
        Name of the file in messages.
    velocity_mm_s : float, default 5.0
        Speed of the insertion (mm/s), for `spatial_bicycle`.

    Returns
    -------
    Identified

    Raises
    ------
    ModelError
        The model is of another kind, its path cannot bend to both sides or becomes straight, or its curvature is 0, is
        not identified, or has an interval that contains 0.
    """
    from needleplan.models import Bicycle, BicycleByDepth, Channel, SpatialBicycle, TipPath, in_plane

    model = file.model
    pieces: tuple[CurvaturePiece, ...] = ()
    if isinstance(model, Bicycle):
        name, value = "curvature_per_mm", model.curvature_per_mm
    elif isinstance(model, BicycleByDepth):
        return _by_depth(model, file, os.fspath(source))
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
        kinds = f"{Bicycle.name}, {BicycleByDepth.name}, {TipPath.name} or {SpatialBicycle.name}"
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
    found = Identified(abs(value), low, high, model.name, trials, file.digest, pieces if len(pieces) > 1 else ())
    return replace(found, entry=_entry(file, 1 if value > 0 else -1))


def _entry(file: ModelFile, side: int) -> EntryPose | None:
    """Return the pose of the tip at the entry that a model file has, or None if heading, offset and scatter are 0."""
    values = file.model.values()
    pairs = []
    for names in (("heading_rad", "slope"), ("offset_mm", "offset")):
        name = next((each for each in names if each in values), "")
        estimate = file.estimates.get(name)
        pairs.append((values.get(name, 0.0), (estimate.between_sd if estimate else None) or 0.0))
    (heading, heading_sd), (offset, offset_sd) = pairs
    known = any((heading, offset, heading_sd, offset_sd))
    return EntryPose(heading, offset, heading_sd, offset_sd, side) if known else None


def _by_depth(model: BicycleByDepth, file: ModelFile, source: str) -> Identified:
    """Return the pieces of a curvature that changes with the depth, and the interval of the first that bends.

    Raises ModelError if no piece bends: every interval that the file has for a curvature contains 0.
    """
    import numpy as np

    from needleplan.models import BetweenDepths, arc_step

    edges, bends = model.knots
    if model.between is BetweenDepths.LINEAR and len(edges) > 1:
        grid = np.linspace(0.0, edges[-1], _MOST_PIECES + 1)
        edges = grid[:-1]
        bends = model.curvature_at((grid[1:] + grid[:-1]) / 2)
    names = [name for name in model.parameters() if name.startswith("curvature")]
    known = [file.estimates[name] for name in names if name in file.estimates]
    sure = [each for each in known if each.low > 0 or each.high < 0]
    if not np.any(bends) or (known and not sure):
        rule = "is not identified at any depth: a straight path is possible, and a plan needs a radius"
        raise ModelError(Mistake("parameters.curvature_per_mm", f"{bends.max():.4g}", rule), source)
    side = np.sign(max((each.value for each in sure), key=abs) if sure else bends[np.argmax(np.abs(bends))])
    places, pose = [], (0.0, 0.0, model.heading_rad)
    for bend, length in zip(bends, np.diff(edges, append=edges[-1]), strict=True):
        places.append(float(pose[0]))
        pose = arc_step(*pose, bend, length)
    pieces = tuple(
        CurvaturePiece(place, max(float(side * bend), 0.0)) for place, bend in zip(places, bends, strict=True)
    )
    first = next(number for number, each in enumerate(pieces) if each.curvature_per_mm)
    most, estimate = pieces[first].curvature_per_mm, file.estimates.get(names[min(first, len(names) - 1)])
    layered = model.between is BetweenDepths.CONSTANT and estimate in sure
    low, high = sorted((abs(estimate.low), abs(estimate.high))) if estimate and layered else (math.nan, math.nan)
    found = Identified(most, low, high, model.name, len(file.parents), file.digest, pieces if len(pieces) > 1 else ())
    return replace(found, entry=_entry(file, 1 if side > 0 else -1))


def pieces_of(along_mm: Array, curvature_per_mm: Array) -> tuple[CurvaturePiece, ...]:
    """Approximate a curvature profile by pieces of constant curvature, from the entry on.

    The profile is split repeatedly, each time where the squared differences from the means of both parts have the
    smallest sum. A piece is not split if at most one of its samples differs by more than 2 % from their median, or if a
    part would be shorter than 2 mm. The curvature of a piece is the mean of its samples.

    Parameters
    ----------
    along_mm : numpy.ndarray
        Increasing positions along x (mm), shape (n,).
    curvature_per_mm : numpy.ndarray
        Curvature at each position (1/mm), shape (n,).

    Returns
    -------
    tuple of CurvaturePiece
    """
    return tuple(
        CurvaturePiece(
            float(along_mm[first] + along_mm[max(first - 1, 0)]) / 2, float(curvature_per_mm[first:last].mean())
        )
        for first, last in _cut(along_mm, curvature_per_mm, 0, len(along_mm))
    )


def within(pieces: Sequence[CurvaturePiece], along_mm: float) -> tuple[CurvaturePiece, ...]:
    """Return the pieces that begin in a workspace.

    Parameters
    ----------
    pieces : sequence of CurvaturePiece
        Pieces of a path, from the entry on.
    along_mm : float
        Length of the workspace (mm). Pieces that begin there or beyond are dropped.

    Returns
    -------
    tuple of CurvaturePiece
    """
    return tuple(piece for piece in pieces if piece.low_mm < along_mm)


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
    """Return a needle with the radius of a curvature (1/mm, either sign), or with layers made from pieces of a path.

    The first piece gives the radius of the needle; each other piece gives a layer from x = `entry_mm` + `low_mm`. A
    straight piece, with curvature 0, gives a layer with infinite radius; if it is the first, the radius of the needle
    is that of the first piece that bends. Raises ScenarioError if there is no piece, no piece bends, a curvature is not
    finite, or a layer violates a rule.
    """
    if not isinstance(curvature_per_mm, Sequence):
        return Needle(_radius_mm(curvature_per_mm))
    if not curvature_per_mm:
        raise ScenarioError(Mistake("curvature_per_mm", "[]", "must be a number or at least one piece of a path"))
    first, *others = curvature_per_mm
    radii = [_radius_mm(other.curvature_per_mm) if other.curvature_per_mm else math.inf for other in others]
    layers = tuple(Layer(entry_mm + each.low_mm, radius) for each, radius in zip(others, radii, strict=True))
    bent = next((radius for radius in radii if math.isfinite(radius)), None)
    if not first.curvature_per_mm and bent:
        return Needle(bent, (Layer(entry_mm, math.inf), *layers))
    return Needle(_radius_mm(first.curvature_per_mm), layers)


def tissues_with(
    tissues: Sequence[Tissue], curvature_per_mm: float | Sequence[HasCurvature], name: str
) -> tuple[Tissue, ...]:
    """Return the tissues, with the radius of all tissues called `name` set from the curvature (1/mm, either sign).

    Raises ScenarioError if the curvature is a sequence, 0 or not finite, or no tissue has this name.
    """
    if isinstance(curvature_per_mm, Sequence):
        raise ScenarioError(Mistake("curvature_per_mm", "", f'must be one number for the tissue "{name}"'))
    names = [tissue.name for tissue in tissues]
    if name not in names:
        rule = "there is no [[tissue]] of that name" + suggestion(name, filter(None, names))
        raise ScenarioError(Mistake("tissue", f'"{name}"', rule))
    radius = _radius_mm(curvature_per_mm)
    return tuple(replace(tissue, curvature_radius_mm=radius) if tissue.name == name else tissue for tissue in tissues)


def _radius_mm(curvature_per_mm: float) -> float:
    if not curvature_per_mm or not math.isfinite(curvature_per_mm):
        rule = "must be a finite number other than 0: a plan needs a needle that bends"
        raise ScenarioError(Mistake("curvature_per_mm", f"{curvature_per_mm:g}", rule))
    return abs(1 / curvature_per_mm)
