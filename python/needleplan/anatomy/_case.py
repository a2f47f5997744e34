"""A case: the structures of a folder as one labelled volume, with the role of each.

*Overlaps.* Each voxel has one label. Where structures overlap, the first of this list holds: obstacle, target, entry,
tissue, body; of two with the same role the smaller one. A target that overlaps an obstacle is refused.

*Organs.* An organ that holds voxels of the target, or next to it, is tissue, any other one an obstacle.

*Body.* What is in no structure is outside of the body. A mask of the body that is hollow around the target, such as a
shell of the skin, is refused.

*Entry.* Without an entry structure it is the skin, the outermost voxels of the body, around a point: the marked one, or
the skin nearest to the target.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from needleplan.anatomy._case_grid import CommonGrid, TargetVoxels
from needleplan.anatomy._file import Sphere
from needleplan.anatomy._labels import TABLE_ENDINGS, name_mistakes, read_label_names
from needleplan.anatomy._markups import POINT_ENDINGS, MarkedPoint, read_points
from needleplan.anatomy._masks import MASK_ENDINGS, Structure, read_structures, stem_of
from needleplan.anatomy._roles import StructureRole, role_by_name
from needleplan.anatomy._volume import LabelVolume
from needleplan.artifacts import CallRepr
from needleplan.config import suggestion
from needleplan.errors import Mistake, ScenarioError, reading

__all__ = ["AnatomyCase", "CaseChoices", "CaseStructure", "read_case"]

_Position = tuple[float, float, float]

# Later ones replace earlier ones in a voxel.
_ORDER = (StructureRole.BODY, StructureRole.TISSUE, StructureRole.ENTRY, StructureRole.TARGET, StructureRole.OBSTACLE)
# Name of the entry region that is painted on the skin.
_SKIN = "skin_entry"
# Overlaps of less are not told (ml).
_TOLD_ML = 0.05


@dataclass(frozen=True)
class CaseChoices(CallRepr):
    """Decisions of a person about a folder of segmentations.

    Parameters
    ----------
    target, entry : str or tuple of float, optional
        Name of a structure or of a marked point, or a position in RAS mm. Default: the only one that is named so.
    target_radius_mm : float, optional
        Radius of the target around a point. Required for a point.
    entry_radius_mm : float, optional
        Radius of the entry region around a point. Default: 25 mm.
    roles : dict, optional
        Roles by name of the structure. Default: those proposed by name.
    """

    target: str | _Position | None = None
    entry: str | _Position | None = None
    target_radius_mm: float | None = None
    entry_radius_mm: float = 25.0
    roles: dict[str, StructureRole] = field(default_factory=dict)


@dataclass(frozen=True)
class CaseStructure(CallRepr):
    """A structure of a case: name, file, volume (ml), role and the reason for it."""

    name: str
    file: str
    volume_ml: float
    role: StructureRole
    reason: str


@dataclass(frozen=True, eq=False)
class AnatomyCase(CallRepr):
    """A merged volume with names of its labels, its structures, target and entry region, and notes on the merging."""

    volume: LabelVolume
    structures: tuple[CaseStructure, ...]
    target: str | Sphere
    entry: str | Sphere
    notes: tuple[str, ...]

    def named(self, role: StructureRole) -> list[str]:
        """Return the names of the structures with a role.

        Parameters
        ----------
        role : StructureRole
            The role.

        Returns
        -------
        list of str

        Examples
        --------
        `read_case` has one.
        """
        return [structure.name for structure in self.structures if structure.role is role]


def read_case(folder: str | os.PathLike[str], choices: CaseChoices | None = None) -> AnatomyCase:
    """Read the segmentations and the marked points of a folder.

    Parameters
    ----------
    folder : str or path
        Folder with segmentations (.nii, .nii.gz, .nrrd, .nhdr), label names for files with several labels without names
        (.ctbl, .csv, .txt), and marked points (.mrk.json, .fcsv).
    choices : CaseChoices, optional
        Decisions that are already made. Default: none.

    Returns
    -------
    AnatomyCase

    Raises
    ------
    ScenarioError
        If a file is wrong, or decisions are missing; the message lists them.
    """
    choices, place = choices or CaseChoices(), Path(folder)
    everything, points = _read_all(place)
    structures, source = [structure for structure in everything if structure.inside.any()], str(place)
    if not structures:
        raise ScenarioError("no segmentation has a voxel of a structure", source)
    grid = CommonGrid.of(structures)
    proposed = _proposed(structures, choices, source)
    target = _region("target", choices.target, choices.target_radius_mm, proposed, points, source)
    entry = _region("entry", choices.entry, choices.entry_radius_mm, proposed, points, source)
    if target is None:
        rule = "is not known: no structure or marked point is named so; choose one"
        raise ScenarioError(Mistake("target", "", rule), source)
    for key, region in (("target", target), ("entry", entry)):
        if isinstance(region, Sphere) and not grid.contains(region.center_mm):
            raise ScenarioError(Mistake(key, str(region), "lies outside of all segmentations"), source)
    merged = _Merge(grid, source)
    held = merged.holder(next((structure for structure in structures if structure.name == target), None), target)
    decided = {structure.name: _decided(structure, *proposed[structure.name], held) for structure in structures}
    for role in _ORDER:
        of_role = [structure for structure in structures if decided[structure.name][0] is role]
        for structure in sorted(of_role, key=lambda structure: -structure.volume_ml):
            merged.paint(structure, role)
    if merged.has_body:
        merged.require_within(held)
    if merged.mistakes:
        raise ScenarioError(merged.mistakes, source)
    empty = [structure.name for structure in everything if not structure.inside.any()]
    notes = [
        *_resampled(grid, structures),
        *merged.notes(),
        *([f"without voxels: {', '.join(empty)}"] if empty else []),
    ]
    if not isinstance(entry, str) and merged.has_body:
        notes.append(merged.paint_skin(entry, choices.entry_radius_mm))
        entry = _SKIN
    if entry is None:
        rule = "is not known: no structure or marked point is named so, and there is no mask of the body; choose one"
        raise ScenarioError(Mistake("entry", "", rule), source)
    volume = LabelVolume(merged.labels, grid.affine, merged.numbers, source)
    listed = tuple(
        CaseStructure(structure.name, Path(structure.source).name, structure.volume_ml, *decided[structure.name])
        for structure in structures
    )
    return AnatomyCase(volume, listed, target, entry, tuple(notes))


def _read_all(folder: Path) -> tuple[list[Structure], list[MarkedPoint]]:
    """Return the structures and the points of a folder. Raises ScenarioError with the mistakes of all files."""
    with reading(folder, ScenarioError):
        files = sorted(each for each in folder.iterdir() if each.is_file() and not each.name.startswith("."))
    masks = [each for each in files if each.name.lower().endswith(MASK_ENDINGS)]
    if not masks:
        raise ScenarioError(f"has no segmentation: files {', '.join(MASK_ENDINGS)}", str(folder))
    stems, mistakes = {stem_of(mask) for mask in masks}, list[Mistake]()
    structures: list[Structure] = []
    points: list[MarkedPoint] = []
    tables: dict[str, dict[str, int]] = {}
    for file in files:
        name = file.name.lower()
        try:
            # Other texts and tables may lie in the folder, too.
            if name.endswith(TABLE_ENDINGS) and (file.stem in stems or file.suffix.lower() == ".ctbl"):
                tables[file.stem] = read_label_names(file)
            elif name.endswith(POINT_ENDINGS):
                points += read_points(file)
        except ScenarioError as error:
            mistakes += [Mistake(file.name, "", str(mistake)) for mistake in error.mistakes]
    for file in masks:
        try:
            structures += read_structures(file, tables)
        except ScenarioError as error:
            mistakes += [Mistake(file.name, "", str(mistake)) for mistake in error.mistakes]
    mistakes += name_mistakes((structure.name, structure.source) for structure in structures)
    if mistakes:
        raise ScenarioError(mistakes, str(folder))
    return structures, points


def _proposed(
    structures: Sequence[Structure], choices: CaseChoices, source: str
) -> dict[str, tuple[StructureRole, str]]:
    """Return role and reason of each structure. Raises ScenarioError for names that no structure has."""
    names = [structure.name for structure in structures]
    unknown = [
        Mistake(role.value, name, f"is no structure of the folder{suggestion(name, names)}")
        for name, role in choices.roles.items()
        if name not in names
    ]
    if choices.target == choices.entry and choices.target in names:
        unknown.append(Mistake("entry", str(choices.entry), "is the target too"))
    if unknown:
        raise ScenarioError(unknown, source)
    proposals = {name: role_by_name(name) for name in names}
    proposals |= {name: (role, "chosen") for name, role in choices.roles.items()}
    for key, role in ((choices.target, StructureRole.TARGET), (choices.entry, StructureRole.ENTRY)):
        if key is not None:
            other = (StructureRole.TISSUE, f"another {role} was chosen")
            others = {name for name, (proposed, _) in proposals.items() if proposed is role and name != key}
            proposals |= dict.fromkeys(others, other)
        if isinstance(key, str) and key in proposals:
            proposals[key] = (role, "chosen")
    return proposals


def _region(
    key: str,
    choice: str | _Position | None,
    radius_mm: float | None,
    proposed: dict[str, tuple[StructureRole, str]],
    points: Sequence[MarkedPoint],
    source: str,
) -> str | Sphere | None:
    """Return the name of the structure or the ball of a region; None if nothing says it. Raises ScenarioError."""
    position = choice if isinstance(choice, tuple) else None
    if position is None:
        role = StructureRole(key)
        named = [name for name, (proposed_role, _) in proposed.items() if proposed_role is role]
        marked = [point for point in points if point.label == choice or (choice is None and key in point.label.lower())]
        if isinstance(choice, str) and choice not in proposed and len(marked) != 1:
            names = [*proposed, *(point.label for point in points)]
            rule = f"is no structure or marked point{suggestion(choice, names)}"
            rule = f"is the label of {len(marked)} marked points: choose one by R,A,S" if marked else rule
            raise ScenarioError(Mistake(key, choice, rule), source)
        texts = [point.label.lower() for point in marked]
        if choice is None and any("target" in text and "entry" in text for text in texts):
            raise ScenarioError(Mistake(key, marked[0].label, "names target and entry: rename the point"), source)
        if len(named) + len(marked) > 1:
            several = ", ".join([*named, *(point.label for point in marked)])
            raise ScenarioError(Mistake(key, several, "are several: choose one"), source)
        if named:
            return named[0]
        if not marked:
            return None
        position = marked[0].position_mm
    if radius_mm is None:
        raise ScenarioError(Mistake(f"{key}_radius_mm", "", f"is required: the {key} is a point"), source)
    return Sphere(position, radius_mm)


def _decided(structure: Structure, role: StructureRole, reason: str, held: TargetVoxels) -> tuple[StructureRole, str]:
    """Return role and reason, where an organ is tissue or an obstacle."""
    if role is not StructureRole.ORGAN:
        return role, reason
    if held.is_in(structure):
        return StructureRole.TISSUE, f"{reason} that holds the target"
    return StructureRole.OBSTACLE, f"{reason} without the target"


def _resampled(grid: CommonGrid, structures: Sequence[Structure]) -> list[str]:
    """Return a note on the structures that have another grid."""
    other = sorted({Path(structure.source).name for structure in structures if not grid.same(structure)})
    sizes = " x ".join(f"{size:.3g}" for size in np.linalg.norm(grid.affine[:3, :3], axis=0))
    told = [f"voxels: {sizes} mm, those of the finest file"]
    return told + ([f"resampled by the nearest voxel: {', '.join(other)}"] if other else [])


class _Merge:
    """The labels of a case while structures are painted, later ones over earlier ones."""

    def __init__(self, grid: CommonGrid, source: str) -> None:
        self.grid, self.source = grid, source
        self.labels = np.zeros(grid.shape, np.uint16, order="F")
        self.numbers: dict[str, int] = {}
        self.has_body = False
        self.mistakes: list[Mistake] = []
        self._roles: dict[int, StructureRole] = {}
        self._overlaps: list[tuple[float, str, str]] = []
        self._voxel_ml = float(abs(np.linalg.det(grid.affine[:3, :3]))) / 1000

    def holder(self, structure: Structure | None, target: str | Sphere) -> TargetVoxels:
        """Return the positions of the target: of the voxels of its structure, or the centre of its ball."""
        if structure is None:
            assert isinstance(target, Sphere)
            self._target_mm = np.array(target.center_mm)
            return TargetVoxels(self._target_mm[None])
        voxels = np.argwhere(structure.inside) + structure.corner
        # Voxels beside those of the target, too: a segmentation may have cut the target out of the organ.
        steps = np.concatenate([np.zeros((1, 3), int), np.eye(3, dtype=int), -np.eye(3, dtype=int)])
        neighbours = voxels[:, None] + steps
        points = neighbours.reshape(-1, 3) @ structure.affine[:3, :3].T + structure.affine[:3, 3]
        self._target_mm = points.mean(0)
        return TargetVoxels(points)

    def paint(self, structure: Structure, role: StructureRole) -> None:
        """Give the voxels of a structure its label."""
        number = len(self.numbers) + 1
        box, inside = self.grid.box(structure)
        if not inside.any():
            rule = "lies between the voxels of the finest file: resample a file, or give it the role ignored"
            self.mistakes.append(Mistake(structure.name, "", rule))
        labels = self.labels[box]
        counts = np.bincount(labels[inside], minlength=number)
        for other, name in ((each, name) for name, each in self.numbers.items()):
            shared_ml = float(counts[other]) * self._voxel_ml
            if role is StructureRole.OBSTACLE and self._roles[other] is StructureRole.TARGET and shared_ml > 0:
                rule = f"overlaps the target {name} by {shared_ml:.3g} ml: correct one of them, or choose another role"
                self.mistakes.append(Mistake(structure.name, "", rule))
            elif self._roles[other] is not StructureRole.BODY and shared_ml >= _TOLD_ML:
                self._overlaps.append((shared_ml, structure.name, name))
        labels[inside] = number
        self.numbers[structure.name], self._roles[number] = number, role
        self.has_body |= role is StructureRole.BODY

    def require_within(self, target: TargetVoxels) -> None:
        """Note a mistake if what is around the target is in no structure, as in a mask of the skin that is a shell."""
        voxels = np.floor(self.grid.voxels(target.points_mm) + 0.5).astype(np.int64)
        labels = self.labels[tuple(voxels[((voxels >= 0) & (voxels < self.grid.shape)).all(-1)].T)]
        around = labels[[self._roles.get(label) is not StructureRole.TARGET for label in labels.tolist()]]
        if 2 * int((around == 0).sum()) > len(around):
            bodies = (name for name, number in self.numbers.items() if self._roles[number] is StructureRole.BODY)
            rule = (
                "is hollow, or does not hold the target, around which there is no structure: fill the mask, add the "
                "organ around the target, or give the mask the role ignored"
            )
            self.mistakes.append(Mistake(", ".join(bodies), "", rule))

    def notes(self) -> list[str]:
        """Return the overlaps, largest first."""
        overlaps = sorted(self._overlaps, reverse=True)
        return [f"overlap: {name} over {other}, {ml:.3g} ml" for ml, name, other in overlaps]

    def paint_skin(self, entry: Sphere | None, radius_mm: float) -> str:
        """Give the skin near the entry point, or nearest to the target, a label of its own; return the note on it."""
        # A mask of the body may have left out its organs.
        body = self.labels > 0
        deep, inner = np.pad(body, 1, constant_values=True), body.copy()
        for axis in range(3):
            for shift in (-1, 1):
                inner &= np.roll(deep, shift, axis)[1:-1, 1:-1, 1:-1]
        closed = [number for number, role in self._roles.items() if role is not StructureRole.BODY]
        skin = np.argwhere(body & ~inner & ~np.isin(self.labels, closed))
        if not len(skin):
            rule = "the body has no skin within the files that is free of other structures"
            raise ScenarioError(Mistake("entry", "", rule), self.source)
        places = self.grid.world(skin)
        if entry is None:
            centre = places[np.linalg.norm(places - self._target_mm, axis=-1).argmin()]
            way = "around the skin nearest to the target"
        else:
            centre, way = np.array(entry.center_mm), "around the chosen point"
        near = np.linalg.norm(places - centre, axis=-1) <= radius_mm
        shown = ", ".join(f"{x:.1f}" for x in centre)
        if not near.any():
            rule = f"no skin within {radius_mm:g} mm"
            raise ScenarioError(Mistake("entry", shown, rule), self.source)
        if _SKIN in self.numbers:
            rule = "is the name of the entry region on the skin: rename the structure"
            raise ScenarioError(Mistake(_SKIN, "", rule), self.source)
        number = len(self.numbers) + 1
        self.labels[tuple(skin[near].T)] = number
        self.numbers[_SKIN] = number
        return f"entry: skin within {radius_mm:g} mm {way}, R {shown.replace(', ', ', A ', 1)}"
