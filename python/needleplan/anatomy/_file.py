"""The anatomy file: a segmented volume, its regions, the needle, the lattice and the costs.

The file is a kind of its own beside the scenario file: a scenario describes a plane by polygons, and its digest and the
shape of its policy table follow from the keys of the plane (`workspace`, `headings`, `transition`), none of which exist
here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from needleplan.config import (
    ConfigTable,
    Flag,
    Integer,
    Maybe,
    Number,
    Numbers,
    Subtable,
    TableList,
    Text,
    Violation,
    build,
    parse_toml,
    raw_of,
    ruled,
    sequence,
    toml_text,
)
from needleplan.errors import Mistake, ScenarioError

__all__ = [
    "AnatomyFile",
    "AnatomyRegions",
    "SpaceLattice",
    "SpaceNeedle",
    "SpaceObjective",
    "Sphere",
    "TissueCurvature",
]

_LENGTH = Number("mm", above=0, at_most=1000)
_RADIUS = Number("mm", at_least=1, at_most=1e6)
_COST = Number(at_least=0, at_most=1e9)
_FAILURE = Number(above=0, at_most=1e9)


@dataclass(frozen=True)
class _Label:
    """Rule for a label: its name, or its number."""

    def read(self, value: object) -> str | int:
        """Return the name or number. Raises Violation."""
        if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 65535:
            return value
        if isinstance(value, str) and value.strip():
            return value
        raise Violation("must be the name of a label, or its number from 0 to 65535", value)


@dataclass(frozen=True)
class _Labels:
    """Rule for a list of labels."""

    def read(self, value: object) -> tuple[str | int, ...]:
        """Return the labels as a tuple. Raises Violation."""
        entries = sequence(value)
        if entries is None:
            raise Violation("must be a list of labels", value)
        return tuple(_Label().read(entry) for entry in entries)


@dataclass(frozen=True)
class Sphere(ConfigTable, error=ScenarioError):
    """A ball as target or entry region: centre in RAS mm, radius in mm."""

    center_mm: tuple[float, float, float] = ruled(Numbers(3))
    radius_mm: float = ruled(_LENGTH)

    def __str__(self) -> str:
        return f"{[round(each, 1) for each in self.center_mm]}, radius {self.radius_mm:g}"


@dataclass(frozen=True)
class _Region:
    """Rule for a region: a label, or a ball `{center_mm = [R, A, S], radius_mm = 3.0}`."""

    def read(self, value: object) -> str | int | Sphere:
        """Return the label or the ball. Raises Violation."""
        if isinstance(value, Sphere):
            return value
        return build(Sphere, value) if isinstance(value, Mapping) else _Label().read(value)


@dataclass(frozen=True)
class TissueCurvature(ConfigTable, key="anatomy.curvature", error=ScenarioError):
    """Radius of the needle's arc (mm) in the voxels of a label."""

    label: str | int = ruled(_Label())
    radius_mm: float = ruled(_RADIUS)


def _no_label_twice(obstacles: tuple[str | int, ...], outside: tuple[str | int, ...]) -> Iterator[Mistake]:
    for label in sorted({*obstacles} & {*outside}, key=str):
        yield Mistake("outside", str(label), "is in obstacles too")


@dataclass(frozen=True)
class AnatomyRegions(ConfigTable, key="anatomy", error=ScenarioError, between=(_no_label_twice,)):
    """The volume, and the meaning of its labels. Regions are labels, or balls in RAS mm."""

    file: str = ruled(Text(filled=True))
    target: str | int | Sphere = ruled(_Region())
    entry: str | int | Sphere = ruled(_Region())
    labels: str | None = ruled(Maybe(Text(filled=True)), None)
    obstacles: tuple[str | int, ...] = ruled(_Labels(), ())
    outside: tuple[str | int, ...] = ruled(_Labels(), ())
    margin_mm: float = ruled(Number("mm", at_least=0, at_most=100), 0.0)
    curvature: tuple[TissueCurvature, ...] = ruled(TableList(TissueCurvature, at_most=200), ())


@dataclass(frozen=True)
class SpaceNeedle(ConfigTable, key="needle", error=ScenarioError):
    """The needle in space.

    `curvature_radius_mm` holds where no label has its own. `tip_noise_deg` is the standard deviation of each of the two
    angles of the tangent after 10 mm of insertion; it grows with the square root of the length. `straight_steps`
    permits straight steps, by duty cycling. Obstacles are grown by half of `diameter_mm`, beside their margin; the
    shaft follows the tip, so it needs no more room.
    """

    curvature_radius_mm: float = ruled(_RADIUS)
    tip_noise_deg: float = ruled(Number("degrees", above=0, at_most=20), 4.0)
    straight_steps: bool = ruled(Flag(), True)
    diameter_mm: float = ruled(Number("mm", at_least=0, at_most=10), 0.0)


def _whole_steps(spacing_mm: float, step_mm: float) -> Iterator[Mistake]:
    if abs(step_mm / spacing_mm - round(step_mm / spacing_mm)) > 1e-6 or step_mm < spacing_mm:
        yield Mistake("step_mm", f"{step_mm:g}", f"must be a multiple of spacing_mm = {spacing_mm:g}")


def _directions_in_cone(cone_deg: float, directions_deg: float) -> Iterator[Mistake]:
    if directions_deg > cone_deg:
        yield Mistake("directions_deg", f"{directions_deg:g}", f"must be at most cone_deg = {cone_deg:g}")


@dataclass(frozen=True)
class SpaceLattice(ConfigTable, key="lattice", error=ScenarioError, between=(_whole_steps, _directions_in_cone)):
    """Resolution of the lattice.

    `spacing_mm` is the distance of grid points, `step_mm` the advance of one insertion step along the axis, `cone_deg`
    the half angle of the cone of directions, `directions_deg` their spacing, and `rolls` the number of roll angles.
    """

    spacing_mm: float = ruled(Number("mm", at_least=0.1, at_most=20), 2.0)
    step_mm: float = ruled(_LENGTH, 4.0)
    cone_deg: float = ruled(Number("degrees", at_least=5, at_most=75), 40.0)
    directions_deg: float = ruled(Number("degrees", at_least=1, at_most=20), 5.0)
    rolls: int = ruled(Integer(3, 64), 8)


@dataclass(frozen=True)
class SpaceObjective(ConfigTable, key="objective", error=ScenarioError):
    """Costs whose expected sum is minimised. With the defaults success comes first, then length and rotations.

    Closer than `clearance_mm` to an obstacle, a mm costs up to `clearance_per_mm` more, in proportion to the shortfall.
    """

    insertion_per_mm: float = ruled(_COST, 1.0)
    rotation: float = ruled(_COST, 1.0)
    collision: float = ruled(_FAILURE, 10000.0)
    exit: float = ruled(_FAILURE, 10000.0)
    clearance_mm: float = ruled(Number("mm", at_least=0, at_most=100), 0.0)
    clearance_per_mm: float = ruled(_COST, 0.0)


def _radii_above_spacing(
    anatomy: AnatomyRegions, needle: SpaceNeedle, lattice: SpaceLattice
) -> Iterator[Mistake]:  # fmt: skip
    radii = [("needle.curvature_radius_mm", needle.curvature_radius_mm)]
    radii += [(f"anatomy.curvature[{n}].radius_mm", each.radius_mm) for n, each in enumerate(anatomy.curvature) if each]
    for key, radius in radii:
        if radius < lattice.spacing_mm:
            rule = f"must be at least lattice.spacing_mm = {lattice.spacing_mm:g}: the arc is smaller than a voxel"
            yield Mistake(key, f"{radius:g}", rule)


@dataclass(frozen=True)
class AnatomyFile(
    ConfigTable, error=ScenarioError, schema="needleplan.anatomy/1", between=(_radii_above_spacing,)
):  # fmt: skip
    """The contents of an anatomy file."""

    anatomy: AnatomyRegions = ruled(Subtable(AnatomyRegions))
    needle: SpaceNeedle = ruled(Subtable(SpaceNeedle))
    lattice: SpaceLattice = ruled(Subtable(SpaceLattice), SpaceLattice())
    objective: SpaceObjective = ruled(Subtable(SpaceObjective), SpaceObjective())
    title: str = ruled(Text(), "")

    @classmethod
    def from_toml(cls, text: str, source: str = "") -> AnatomyFile:
        """Return the contents of a file, called `source` in messages. Raises ScenarioError with all mistakes."""
        return parse_toml(text, cls, source)

    def to_toml(self) -> str:
        """Return the text of an anatomy file that reads back as exactly these contents."""
        return toml_text({"schema": self.schema, **raw_of(self)})
