"""Breathing: where the tissue is at a level of inspiration. The equations are those of docs/explanation/promise.md.

The segmentation shows the end of an exhalation, level 0. Full inspiration is level 1.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy._labels import LabelsRule, label_number
from needleplan.anatomy._nifti import read_nifti_vectors
from needleplan.anatomy._nrrd import read_displacements
from needleplan.artifacts import ShortRepr
from needleplan.config import ConfigTable, Number, Numbers, Violation, ruled, sequence
from needleplan.errors import Mistake, ScenarioError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from needleplan.anatomy._volume import LabelVolume

__all__ = ["Breathing", "DisplacementField", "TissueMotion"]

# Margin (mm) around a lattice within which its anatomy matters: that of the distances to obstacles.
_AROUND_MM = 30.0
# Largest number of files of phases.
_MOST_PHASES = 20
# Repetitions that find the place of a point that moves; each shrinks the error at least by full_mm / fade_mm.
_REPETITIONS = 50


@dataclass(frozen=True)
class _FilesRule:
    """Rule for the name of a file, or a list of names, one for each phase; an empty tuple without files."""

    def read(self, value: object) -> tuple[str, ...]:
        """Return the names. Raises Violation."""
        if value is None:
            return ()
        names = (value,) if isinstance(value, str) else sequence(value)
        if names is None or len(names) > _MOST_PHASES or not all(isinstance(name, str) and name for name in names):
            raise Violation(f"must be the name of a file, or a list of 1 to {_MOST_PHASES} names", value)
        return tuple(map(str, names))


def _a_shape(still: tuple[str | int, ...] | None, field: tuple[str, ...] | None) -> Iterator[Mistake]:
    if not still and not field:
        yield Mistake("still", "", "is missing: name the labels that are at rest, as bones, or give a field")


def _no_folds(full_mm: float, fade_mm: float, still: tuple[str | int, ...] | None) -> Iterator[Mistake]:
    if still and full_mm >= fade_mm:
        rule = f"must be above full_mm = {full_mm:g}: tissue near bone would fold"
        yield Mistake("fade_mm", f"{fade_mm:g}", rule)


@dataclass(frozen=True)
class Breathing(ConfigTable, key="breathing", error=ScenarioError, between=(_a_shape, _no_folds)):
    """Motion of the tissue by breathing.

    - `full_mm`: largest displacement of tissue at full inspiration.
    - `toward`: its direction, a unit vector in RAS.
    - `still`: labels at rest; the displacement grows linearly up to the distance `fade_mm` from them.
    - `field`: file with displacements in place of `toward`, or files, one for each phase of the inspiration.
    - `period_s`, `rest`: period, and dwell as of the effect `respiration`: 1 dwells at exhalation, 0 is a sine.
    - `level`: level of inspiration that is planned for.
    """

    full_mm: float = ruled(Number("mm", above=0, at_most=100))
    still: tuple[str | int, ...] = ruled(LabelsRule(), ())
    fade_mm: float = ruled(Number("mm", above=0, at_most=300), 40.0)
    toward: tuple[float, float, float] = ruled(Numbers(3, unit_length=True), (0.0, 0.0, -1.0))
    field: tuple[str, ...] = ruled(_FilesRule(), ())
    period_s: float = ruled(Number("s", at_least=0.2, at_most=60), 4.0)
    rest: float = ruled(Number(at_least=-1, at_most=1), 1.0)
    level: float = ruled(Number(at_least=0, at_most=1), 0.0)

    def level_at(self, time_s: ArrayLike) -> NDArray[np.float64]:
        """Return the level of inspiration, equation (5).

        Parameters
        ----------
        time_s : array_like
            Times (s) after the end of an exhalation.

        Returns
        -------
        numpy.ndarray
            Levels from 0 to 1, of the shape of `time_s`.
        """
        from needleplan.models.effects import breathing  # needs the extra `lab`, as insertions do

        moved, _ = breathing(np.asarray(time_s, np.float64), 1 / self.period_s, -np.pi / 2, self.rest)
        return np.asarray(moved + (1 - self.rest) / 2)

    def level_for(self, residual_mm: float) -> float | None:
        """Return a level at which the largest displacement of tissue from the plan is `residual_mm`.

        Parameters
        ----------
        residual_mm : float
            Largest displacement (mm) of tissue from its place in the plan.

        Returns
        -------
        float or None
            The level above the planned one; the level below it if the former is above 1; None if neither is from 0 to
            1.
        """
        away = residual_mm / self.full_mm
        return next((level for level in (self.level + away, self.level - away) if 0 <= level <= 1), None)


@dataclass(frozen=True, eq=False)
class DisplacementField(ShortRepr):
    """Displacements in RAS at a level of inspiration, shape (3, ni, nj, nk).

    `affine` leads from their voxels to RAS mm. The unit is the largest displacement at full inspiration.
    """

    level: float
    values: NDArray[np.float32]
    affine: NDArray[np.float64]

    def at(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the displacements at points, shape (n, ..., 3); beyond the field those of its nearest voxel."""
        from scipy import ndimage

        places = np.moveaxis((points_mm - self.affine[:3, 3]) @ np.linalg.inv(self.affine[:3, :3]).T, -1, 0)
        along = [ndimage.map_coordinates(axis, places, np.float64, order=1, mode="nearest") for axis in self.values]
        return np.stack(along, -1)


def _read_fields(file: Path) -> list[tuple[NDArray[np.float32], NDArray[np.float64]]]:
    """Return the fields of a file: displacements in RAS mm, shape (3, ni, nj, nk), and the matrix to RAS mm."""
    name = file.name.lower()
    if name.endswith((".nrrd", ".nhdr")):
        return [read_displacements(file)]
    if name.endswith((".nii", ".nii.gz")):
        fields, affine = read_nifti_vectors(file)
        return [(values, affine) for values in fields]
    rule = "must be NIfTI (.nii, .nii.gz) or NRRD (.nrrd) with vectors; ITK, ANTs and 3D Slicer export one"
    raise ScenarioError(Mistake("breathing.field", file.name, rule), os.fspath(file))


@dataclass(frozen=True, eq=False)
class TissueMotion(ShortRepr):
    """The displacement of tissue by breathing.

    `labels`: numbers of the labels at rest. `phases`: the fields of displacement by their levels, which increase up to
    1; without one, the displacement has the direction of `breathing`.
    """

    breathing: Breathing
    labels: tuple[int, ...]
    phases: tuple[DisplacementField, ...] = ()

    @classmethod
    def read(cls, breathing: Breathing, names: Mapping[str, int], folder: str | os.PathLike[str]) -> TissueMotion:
        """Return the motion that `breathing` describes; its file `field` is in `folder`. Raises ScenarioError."""
        labels = tuple(label_number(label, names, "breathing.still") for label in breathing.still)
        fields = [each for name in breathing.field for each in _read_fields(Path(folder) / name)]
        largest = [float(np.sqrt((values**2).sum(0).max())) for values, _ in fields]
        for number, size in enumerate(largest):
            if not (size > max(largest[:number], default=-1.0) and np.isfinite(size)) or largest[-1] == 0:
                sizes = ", ".join(f"{each:.3g}" for each in largest)
                rule = (
                    "must be the largest displacements (mm) of phases from exhalation to full inspiration, increasing"
                )
                raise ScenarioError(
                    Mistake("breathing.field", sizes, rule), os.fspath(Path(folder) / breathing.field[-1])
                )
        phases = (
            DisplacementField(size / largest[-1], np.asarray(values / largest[-1], np.float32), affine)
            for size, (values, affine) in zip(largest, fields, strict=True)
            if size > 0
        )
        return cls(breathing, labels, tuple(phases))

    def moved(
        self,
        volume: LabelVolume,
        level: float,
        centers_mm: Sequence[tuple[float, float, float]],
        near_mm: NDArray[np.float64] | None,
    ) -> tuple[LabelVolume, list[tuple[float, float, float]]]:
        """Move a volume and points (RAS mm) from the end of an exhalation to a level of inspiration.

        Equation (3): a voxel has the label of the voxel in which its tissue was. The volume is cropped to the
        surroundings of the points `near_mm`, shape (n, 3).
        """
        part = volume
        if near_mm is not None:
            first, box = volume.near(near_mm, _AROUND_MM + self.breathing.full_mm + self.breathing.fade_mm)
            affine = volume.affine.copy()
            affine[:3, 3] = volume.world(first)
            part = replace(volume, labels=volume.labels[box], affine=affine)
        labels = part.labels
        share = self._shares(part)
        moved = np.empty_like(labels)
        for i in range(len(labels)):  # slice by slice, for the memory
            index = np.stack(np.meshgrid([i], *map(np.arange, labels.shape[1:]), indexing="ij"), -1)[0]
            source = part.voxels(part.world(index) - share[i][..., None] * self._displacements(part, index, level))
            at = np.clip(np.floor(source + 0.5).astype(np.int64), 0, np.array(labels.shape) - 1)
            moved[i] = labels[tuple(np.moveaxis(at, -1, 0))]
        return replace(part, labels=moved), [self._place(part, share, level, center) for center in centers_mm]

    def _shares(self, part: LabelVolume) -> NDArray[np.float32]:
        """Return the displacement of voxels as a share of the one without bones, equation (4)."""
        from scipy import ndimage

        still = np.isin(part.labels, self.labels)
        if not still.any():
            return np.ones(still.shape, np.float32)
        apart = ndimage.distance_transform_edt(~still, sampling=part.sizes_mm) - part.sizes_mm.min() / 2
        return np.asarray(np.clip(apart / self.breathing.fade_mm, 0, 1), np.float32)

    def _displacements(
        self, part: LabelVolume, index: NDArray[np.int64] | NDArray[np.float64], level: float
    ) -> NDArray[np.float64]:
        """Return the displacements (RAS mm) at a level without bones, at voxels, shape (..., 3).

        Between the levels of two phases, and between exhalation and the first one, the displacement is linear.
        """
        if not self.phases:
            return level * self.breathing.full_mm * np.array(self.breathing.toward)
        levels = [0.0, *(phase.level for phase in self.phases)]
        parts = np.interp(level, levels, np.arange(len(levels)))
        below = min(int(parts), len(levels) - 2)
        shares = {below: 1 - (parts - below), below + 1: parts - below}
        return self.breathing.full_mm * np.asarray(
            sum(share * self.phases[number - 1].at(part.world(index)) for number, share in shares.items() if number)
        )

    def _place(
        self, part: LabelVolume, share: NDArray[np.float32], level: float, center_mm: tuple[float, float, float]
    ) -> tuple[float, float, float]:
        """Return where a point c is: it solves p = c + level U(p)."""
        from scipy import ndimage

        place = np.array(center_mm)
        for _ in range(_REPETITIONS):
            index = part.voxels(place)
            along = float(ndimage.map_coordinates(share, index[:, None], np.float64, order=1, mode="nearest")[0])
            place = center_mm + along * self._displacements(part, index[None], level).reshape(3)
        r, a, s = place.tolist()
        return r, a, s
