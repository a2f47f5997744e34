"""The anatomy file: a segmented volume, its regions, the needle, the lattice and the costs.

The file is a kind of its own beside the scenario file: a scenario describes a plane by polygons, and its digest and the
shape of its policy table follow from the keys of the plane (`workspace`, `headings`, `transition`), none of which exist
here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from needleplan.anatomy._breathing import Breathing
from needleplan.anatomy._labels import LabelRule, LabelsRule
from needleplan.anatomy._limits import SpaceLimits
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
    toml_text,
)
from needleplan.errors import Mistake, ScenarioError

__all__ = [
    "GAUGES_MM",
    "SPACINGS_MM",
    "AnatomyFile",
    "AnatomyRegions",
    "NamedEntry",
    "NamedTarget",
    "Region",
    "SpaceLattice",
    "SpaceNeedle",
    "SpaceObjective",
    "Sphere",
    "TissueCurvature",
]

# Largest number of targets, and of entry regions, of an anatomy.
_MOST_TARGETS = 20
# Words of `entry --rank` that cannot be names of targets.
_RANKS = ("expected", "all")
# Nominal outer diameters (mm) of needles by Birmingham wire gauge (Stubs' iron wire gauge).
GAUGES_MM = {
    10: 3.404, 11: 3.048, 12: 2.769, 13: 2.413, 14: 2.108, 15: 1.829, 16: 1.651, 17: 1.473, 18: 1.270, 19: 1.067,
    20: 0.908, 21: 0.819, 22: 0.718, 23: 0.641, 24: 0.565, 25: 0.514, 26: 0.464, 27: 0.413, 28: 0.362, 29: 0.337,
    30: 0.311,
}  # fmt: skip
# Distances of grid points (mm) among which a lattice chooses. Tables are nearer to executions with finer ones.
SPACINGS_MM = (1.0, 1.5, 2.0)
# Advance of a step (mm) unless a file says otherwise; with 8 mm, some points of success are lost.
_STEP_MM = 4.0
_LENGTH = Number("mm", above=0, at_most=1000)
_RADIUS = Number("mm", at_least=1, at_most=1e6)
_COST = Number(at_least=0, at_most=1e9)
_FAILURE = Number(above=0, at_most=1e9)


_MARGIN = Number("mm", at_least=0, at_most=100)


@dataclass(frozen=True)
class _MarginRule:
    """Rule for margins by label: a table whose keys are names of labels, or their numbers."""

    def read(self, value: object) -> Mapping[str, float]:
        """Return the margins (mm) by label. Raises Violation."""
        if not isinstance(value, Mapping):
            raise Violation("must be a table of labels and their margins in mm", value)
        margins = {}
        for label, margin in value.items():
            try:
                margins[str(label)] = _MARGIN.read(margin)
            except Violation as broken:
                raise Violation(f"the margin of {label} {broken}", margin) from None
        return margins


@dataclass(frozen=True)
class Sphere(ConfigTable, error=ScenarioError):
    """A ball as target or entry region: centre in RAS mm, radius in mm."""

    center_mm: tuple[float, float, float] = ruled(Numbers(3))
    radius_mm: float = ruled(_LENGTH)

    def __str__(self) -> str:
        return f"{[round(number, 1) for number in self.center_mm]}, radius {self.radius_mm:g}"


Region = str | int | Sphere
"""A region: name or number of a label, or a ball."""


@dataclass(frozen=True)
class _Region:
    """Rule for a region: a label, or a ball `{center_mm = [R, A, S], radius_mm = 3.0}`."""

    def read(self, value: object) -> Region:
        """Return the label or the ball. Raises Violation."""
        if isinstance(value, Sphere):
            return value
        return build(Sphere, value) if isinstance(value, Mapping) else LabelRule().read(value)


@dataclass(frozen=True)
class NamedTarget(ConfigTable, key="anatomy.targets", error=ScenarioError):
    """One of several targets: its name, and a label or a ball."""

    name: str = ruled(Text(80, filled=True, one_line=True))
    region: Region = ruled(_Region())


@dataclass(frozen=True)
class NamedEntry(ConfigTable, key="anatomy.entries", error=ScenarioError):
    """One of several entry regions: its name, and a label or a ball."""

    name: str = ruled(Text(80, filled=True, one_line=True))
    region: Region = ruled(_Region())


@dataclass(frozen=True)
class TissueCurvature(ConfigTable, key="anatomy.curvature", error=ScenarioError):
    """Radius of the needle's arc (mm) in the voxels of a label."""

    label: str | int = ruled(LabelRule())
    radius_mm: float = ruled(_RADIUS)


def _margins_of_obstacles(obstacles: tuple[str | int, ...], margins_mm: Mapping[str, float]) -> Iterator[Mistake]:
    for label in margins_mm:
        if label not in map(str, obstacles):
            yield Mistake(f"margins_mm.{label}", f"{margins_mm[label]:g}", "is no label in obstacles, as written there")


def _no_label_twice(obstacles: tuple[str | int, ...], outside: tuple[str | int, ...]) -> Iterator[Mistake]:
    for label in sorted({*obstacles} & {*outside}, key=str):
        yield Mistake("outside", str(label), "is in obstacles too")


def _one_or_several(target: Region | None, targets: tuple[NamedTarget | None, ...]) -> Iterator[Mistake]:
    if target is None and not targets:
        yield Mistake("target", "", "is missing")
    if target is not None and targets:
        yield Mistake("targets", f"{len(targets)} tables", "anatomy.target is given, too: leave out one of them")


def _one_entry_or_several(entry: Region | None, entries: tuple[NamedEntry | None, ...]) -> Iterator[Mistake]:
    if entry is None and not entries:
        yield Mistake("entry", "", "is missing")
    if entry is not None and entries:
        yield Mistake("entries", f"{len(entries)} tables", "anatomy.entry is given, too: leave out one of them")
    names = [each.name for each in entries if each is not None]
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield Mistake("entries.name", name, "is the name of two entry regions: names must differ")


def _different_targets(targets: tuple[NamedTarget | None, ...]) -> Iterator[Mistake]:
    for place, target in enumerate(targets):
        for number, other in enumerate(targets[:place], start=1):
            if target is None or other is None:
                continue
            if target.name == other.name:
                rule = f"is the name of [[anatomy.targets]] {number} too: names must differ"
                yield Mistake(f"targets {place + 1}.name", target.name, rule)
            elif target.region == other.region:
                rule = f'is the region of [[anatomy.targets]] {number} ("{other.name}") too'
                yield Mistake(f'targets {place + 1} ("{target.name}").region', str(target.region), rule)
        if target is not None and target.name in _RANKS:
            yield Mistake(f"targets {place + 1}.name", target.name, "is a word of `entry --rank`: take another name")


@dataclass(frozen=True)
class AnatomyRegions(
    ConfigTable,
    key="anatomy",
    error=ScenarioError,
    between=(_no_label_twice, _margins_of_obstacles, _one_or_several, _different_targets, _one_entry_or_several),
):
    """The volume, and the meaning of its labels. Regions are labels, or balls in RAS mm.

    There is one `target`, or there are several `targets`; the same holds for `entry` and `entries`. `margin_mm` is the
    margin of the obstacles that are not in `margins_mm`.
    """

    file: str = ruled(Text(filled=True))
    target: Region | None = ruled(Maybe(_Region()), None)
    entry: Region | None = ruled(Maybe(_Region()), None)
    labels: str | None = ruled(Maybe(Text(filled=True)), None)
    obstacles: tuple[str | int, ...] = ruled(LabelsRule(), ())
    outside: tuple[str | int, ...] = ruled(LabelsRule(), ())
    margin_mm: float = ruled(_MARGIN, 0.0)
    margins_mm: Mapping[str, float] = ruled(_MarginRule(), factory=dict)
    curvature: tuple[TissueCurvature, ...] = ruled(TableList(TissueCurvature, at_most=200), ())
    targets: tuple[NamedTarget, ...] = ruled(TableList(NamedTarget, at_most=_MOST_TARGETS), ())
    entries: tuple[NamedEntry, ...] = ruled(TableList(NamedEntry, at_most=_MOST_TARGETS), ())

    @property
    def entrances(self) -> dict[str, NamedEntry]:
        """Entry regions by their keys in messages (without "anatomy."); a single region has the name "entry"."""
        if self.entry is not None:
            return {"entry": NamedEntry("entry", self.entry)}
        return {f'entries {place} ("{entry.name}").region': entry for place, entry in enumerate(self.entries, start=1)}

    @property
    def entry_text(self) -> str:
        """The entry region, or the names of several, for messages."""
        return ", ".join(entry.name for entry in self.entries) or str(self.entry)

    @property
    def aims(self) -> tuple[NamedTarget, ...]:
        """The targets; a single one has the name "target"."""
        return self.targets if self.target is None else (NamedTarget("target", self.target),)

    @property
    def aim_keys(self) -> tuple[str, ...]:
        """The key of each target in messages, without "anatomy."."""
        several = enumerate(self.targets, start=1)
        return tuple(f'targets {place} ("{target.name}").region' for place, target in several) or ("target",)

    @property
    def largest_margin_mm(self) -> float:
        """Largest margin (mm) of an obstacle."""
        return max([self.margin_mm, *self.margins_mm.values()])


def _one_thickness(diameter_mm: float | None, gauge: int | None) -> Iterator[Mistake]:
    if diameter_mm is not None and gauge is not None:
        rule = f"diameter_mm is given, too: leave out one of them ({gauge} gauge is {GAUGES_MM[gauge]:g} mm)"
        yield Mistake("gauge", str(gauge), rule)


@dataclass(frozen=True)
class SpaceNeedle(ConfigTable, key="needle", error=ScenarioError, between=(_one_thickness,)):
    """The needle in 3D.

    `curvature_radius_mm` is the radius in tissues without one of their own. `tip_noise_deg` is the standard deviation
    of each of the two angles of the tangent after 10 mm of insertion; it grows with the square root of the length.
    `straight_steps` permits straight steps, by duty cycling. Obstacles are grown by half of `thickness_mm`, beside
    their margin; the shaft follows the tip, so it needs no more room. The thickness is `diameter_mm`, or the outer
    diameter of `gauge`. `length_mm`: the part that can be inserted; entries with a longer path are left out.
    """

    curvature_radius_mm: float = ruled(_RADIUS)
    tip_noise_deg: float = ruled(Number("degrees", above=0, at_most=20), 4.0)
    straight_steps: bool = ruled(Flag(), True)
    diameter_mm: float | None = ruled(Maybe(Number("mm", at_least=0, at_most=10)), None)
    gauge: int | None = ruled(Maybe(Integer(min(GAUGES_MM), max(GAUGES_MM))), None)
    length_mm: float | None = ruled(Maybe(_LENGTH), None)

    @property
    def thickness_mm(self) -> float | None:
        """Outer diameter of the needle; None if the file says nothing about it."""
        return GAUGES_MM[self.gauge] if self.gauge is not None else self.diameter_mm


def _is_whole(step_mm: float, spacing_mm: float) -> bool:
    return step_mm >= spacing_mm and abs(step_mm / spacing_mm - round(step_mm / spacing_mm)) <= 1e-6


def _whole_steps(spacing_mm: float | None, step_mm: float | None) -> Iterator[Mistake]:
    if step_mm is None:
        return
    if spacing_mm is not None and not _is_whole(step_mm, spacing_mm):
        yield Mistake("step_mm", f"{step_mm:g}", f"must be a multiple of spacing_mm = {spacing_mm:g}")
    if spacing_mm is None and not any(_is_whole(step_mm, spacing) for spacing in SPACINGS_MM):
        yield Mistake("step_mm", f"{step_mm:g}", "must be a multiple of 1, 1.5 or 2 mm, or spacing_mm must be given")


def _directions_in_cone(cone_deg: float, directions_deg: float) -> Iterator[Mistake]:
    if directions_deg > cone_deg:
        yield Mistake("directions_deg", f"{directions_deg:g}", f"must be at most cone_deg = {cone_deg:g}")


@dataclass(frozen=True)
class SpaceLattice(ConfigTable, key="lattice", error=ScenarioError, between=(_whole_steps, _directions_in_cone)):
    """Resolution of the lattice.

    `spacing_mm` is the distance of grid points, `step_mm` the advance of one insertion step along the axis, `cone_deg`
    the half angle of the cone of directions, `directions_deg` their spacing, and `rolls` the number of roll angles.
    Without `spacing_mm`, the finest of `SPACINGS_MM` is taken that the number of states and the memory permit.
    """

    spacing_mm: float | None = ruled(Maybe(Number("mm", at_least=0.1, at_most=20)), None)
    step_mm: float | None = ruled(Maybe(_LENGTH), None)
    cone_deg: float = ruled(Number("degrees", at_least=5, at_most=75), 40.0)
    directions_deg: float = ruled(Number("degrees", at_least=1, at_most=20), 5.0)
    rolls: int = ruled(Integer(3, 64), 8)

    @property
    def spacings_mm(self) -> tuple[float, ...]:
        """The spacings that may be taken, finest first."""
        if self.spacing_mm is not None:
            return (self.spacing_mm,)
        return tuple(spacing for spacing in SPACINGS_MM if self.step_mm is None or _is_whole(self.step_mm, spacing))

    def step_of(self, spacing_mm: float) -> float:
        """Return the advance of a step (mm): `step_mm`, by default the multiple of the spacing nearest to 4 mm."""
        return self.step_mm or spacing_mm * max(round(_STEP_MM / spacing_mm), 1)


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
    radii += [
        (f"anatomy.curvature[{n}].radius_mm", tissue.radius_mm) for n, tissue in enumerate(anatomy.curvature) if tissue
    ]
    spacing = lattice.spacing_mm or SPACINGS_MM[0]
    for key, radius in radii:
        if radius < spacing:
            rule = f"must be at least lattice.spacing_mm = {spacing:g}: the arc is smaller than a voxel"
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
    limits: SpaceLimits | None = ruled(Maybe(Subtable(SpaceLimits)), None)
    breathing: Breathing | None = ruled(Maybe(Subtable(Breathing)), None)

    @classmethod
    def from_toml(cls, text: str, source: str = "") -> AnatomyFile:
        """Parse the text of an anatomy file.

        Parameters
        ----------
        text : str
            Text of the file.
        source : str, optional
            Name of the text in messages.

        Returns
        -------
        AnatomyFile

        Raises
        ------
        ScenarioError
            The text is not TOML, or has mistakes. The error lists all of them.
        """
        return parse_toml(text, cls, source)

    def to_toml(self) -> str:
        """Return the text of an anatomy file that reads back as exactly these contents."""
        return toml_text({"schema": self.schema, **raw_of(self)})
