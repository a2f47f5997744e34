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
from needleplan.anatomy._nrrd import read_displacements
from needleplan.artifacts import short_html, short_repr
from needleplan.config import ConfigTable, Maybe, Number, Numbers, Text, ruled
from needleplan.errors import Mistake, ScenarioError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from needleplan.anatomy._volume import LabelVolume

__all__ = ["Breathing", "TissueMotion"]

# Margin (mm) around a lattice within which its anatomy matters: that of the distances to obstacles.
_AROUND_MM = 30.0
# Repetitions that find the place of a point that moves; each shrinks the error at least by full_mm / fade_mm.
_REPETITIONS = 50


def _a_shape(still: tuple[str | int, ...] | None, field: str | None) -> Iterator[Mistake]:
    if not still and field is None:
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
    - `field`: file with a displacement field in place of `toward`.
    - `period_s`, `rest`: period, and dwell as of the effect `respiration`: 1 dwells at exhalation, 0 is a sine.
    - `level`: level of inspiration that is planned for.
    """

    full_mm: float = ruled(Number("mm", above=0, at_most=100))
    still: tuple[str | int, ...] = ruled(LabelsRule(), ())
    fade_mm: float = ruled(Number("mm", above=0, at_most=300), 40.0)
    toward: tuple[float, float, float] = ruled(Numbers(3, unit_length=True), (0.0, 0.0, -1.0))
    field: str | None = ruled(Maybe(Text(filled=True)), None)
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
class TissueMotion:
    """The displacement of tissue at full inspiration.

    `labels`: numbers of the labels at rest. `field`: displacements in RAS mm, shape (3, ni, nj, nk), the largest of
    length 1, and their affine; None for the direction of `breathing`.
    """

    breathing: Breathing
    labels: tuple[int, ...]
    field: tuple[NDArray[np.float32], NDArray[np.float64]] | None = None

    __repr__ = short_repr
    _repr_html_ = short_html

    @classmethod
    def read(cls, breathing: Breathing, names: Mapping[str, int], folder: str | os.PathLike[str]) -> TissueMotion:
        """Return the motion that `breathing` describes; its file `field` is in `folder`. Raises ScenarioError."""
        labels = tuple(label_number(label, names, "breathing.still") for label in breathing.still)
        if breathing.field is None:
            return cls(breathing, labels)
        file = Path(folder) / breathing.field
        values, affine = read_displacements(file)
        largest = float(np.sqrt((values**2).sum(0).max()))
        if not 0 < largest < np.inf:
            rule = "must be finite displacements in mm, not all of them 0"
            raise ScenarioError(Mistake("breathing.field", f"{largest:g}", rule), os.fspath(file))
        return cls(breathing, labels, (np.asarray(values / largest, np.float32), affine))

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
            source = part.voxels(part.world(index) - level * share[i][..., None] * self._directions(part, index))
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

    def _directions(self, part: LabelVolume, index: NDArray[np.int64] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the displacements (RAS mm) at full inspiration without bones, at voxels, shape (..., 3)."""
        from scipy import ndimage

        if self.field is None:
            return self.breathing.full_mm * np.array(self.breathing.toward)
        values, affine = self.field
        places = np.moveaxis((part.world(index) - affine[:3, 3]) @ np.linalg.inv(affine[:3, :3]).T, -1, 0)
        sampled = [ndimage.map_coordinates(part, places, np.float64, order=1, mode="nearest") for part in values]
        return self.breathing.full_mm * np.stack(sampled, -1)

    def _place(
        self, part: LabelVolume, share: NDArray[np.float32], level: float, center_mm: tuple[float, float, float]
    ) -> tuple[float, float, float]:
        """Return where a point c is: it solves p = c + level U(p)."""
        from scipy import ndimage

        place = np.array(center_mm)
        for _ in range(_REPETITIONS):
            index = part.voxels(place)
            along = float(ndimage.map_coordinates(share, index[:, None], np.float64, order=1, mode="nearest")[0])
            place = center_mm + level * along * self._directions(part, index[None]).reshape(3)
        r, a, s = place.tolist()
        return r, a, s
