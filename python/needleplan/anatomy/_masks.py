"""Structures of segmentation files: one mask a file, several labels with names, or layers that overlap.

A structure is a box of the grid of its file that has all of its voxels, so that forty masks of a chest CT fit into the
memory together.

DICOM segmentation objects (DICOM SEG, PS3.3 A.51), by way of pydicom.

A frame is a slice of one segment: rows, columns, place and direction in LPS are those of the functional groups of the
object itself, so that the series that was segmented is not needed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy._labels import read_labels
from needleplan.anatomy._nifti import extension_names
from needleplan.anatomy._nrrd import is_layered, read_layers
from needleplan.anatomy._volume import counted_bytes, labels_present, orientation_mistakes, require_size
from needleplan.errors import Mistake, ScenarioError
from needleplan.extras import require

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["MASK_ENDINGS", "Structure", "dicom_segments", "read_structures", "stem_of"]


_SEGMENTATION = "1.2.840.10008.5.1.4.1.1.66.4"
# Transfer syntaxes without compression: implicit and explicit little endian.
_PLAIN = ("1.2.840.10008.1.2", "1.2.840.10008.1.2.1")
# Largest distance of a frame from its slice, in slices.
_OFF_SLICE = 0.1
_RAS_OF_LPS = np.array([-1.0, -1.0, 1.0])


def dicom_segments(file: Path) -> Iterator[tuple[str, NDArray[np.float64], NDArray[np.uint16]]]:
    """Yield name, matrix from voxels to RAS mm, and mask of each segment. Raises ScenarioError."""
    source = str(file)
    require("pydicom")
    import pydicom

    try:
        meta: Any = pydicom.filereader.read_file_meta_info(source)
        if str(meta.get("TransferSyntaxUID", "")) not in _PLAIN:
            rule = "must be without compression, explicit or implicit little endian"
            raise ScenarioError(Mistake("TransferSyntaxUID", str(meta.get("TransferSyntaxUID", "")), rule), source)
        data: Any = pydicom.dcmread(source)
        if data.SOPClassUID != _SEGMENTATION:
            rule = f"is no DICOM SEG but {pydicom.uid.UID(data.SOPClassUID).name}: keep the series in another folder"
            raise ScenarioError(rule, source)
        if data.SegmentationType != "BINARY":
            raise ScenarioError(Mistake("SegmentationType", str(data.SegmentationType), "must be BINARY"), source)
        names = {int(segment.SegmentNumber): str(segment.SegmentLabel).strip() for segment in data.SegmentSequence}
        affine, slices = _places(data, source)
        shape = (int(data.Columns), int(data.Rows), int(max(slices)) + 1)
        counted_bytes(shape, 2, "Rows, Columns, frames", source)
        require_size(len(slices) * shape[0] * shape[1] // 8, len(data.PixelData), False, "NumberOfFrames", source)
        frames = np.asarray(data.pixel_array).reshape(len(slices), shape[1], shape[0])
        numbers = [
            int(group.SegmentIdentificationSequence[0].ReferencedSegmentNumber)
            for group in data.PerFrameFunctionalGroupsSequence
        ]
    except ScenarioError:
        raise
    except Exception as error:  # a damaged object fails in its own way
        raise ScenarioError(f"is a damaged DICOM file, or lacks a part: {error}", source) from None
    if unknown := sorted({*numbers} - {*names}):
        rule = "is in no SegmentSequence"
        raise ScenarioError(Mistake("ReferencedSegmentNumber", str(unknown[0]), rule), source)
    for number, name in names.items():
        mask = np.zeros(shape, np.uint16)
        for frame, place, of_segment in zip(frames, slices, numbers, strict=True):
            if of_segment == number:
                mask[:, :, place] = frame.T > 0
        yield name, affine, mask


def _places(data: Any, source: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the matrix from voxels (column, row, slice) to RAS mm, and the slice of each frame."""
    shared, groups = data.SharedFunctionalGroupsSequence[0], data.PerFrameFunctionalGroupsSequence

    def group(name: str) -> Any:
        return getattr(shared if hasattr(shared, name) else groups[0], name)[0]

    row, column = np.array(group("PlaneOrientationSequence").ImageOrientationPatient, np.float64).reshape(2, 3)
    measures, normal = group("PixelMeasuresSequence"), np.cross(row, column)
    between_rows, between_columns = (float(number) for number in measures.PixelSpacing)
    corners = np.array([group.PlanePositionSequence[0].ImagePositionPatient for group in groups], np.float64)
    along = corners @ normal
    levels = np.unique(np.round(along, 3))
    stated = measures.get("SpacingBetweenSlices", measures.get("SliceThickness", 1.0))
    spacing = float(np.diff(levels).min()) if len(levels) > 1 else float(stated)
    slices = np.round((along - along.min()) / spacing)
    off = abs((along - along.min()) / spacing - slices)
    first = corners[along.argmin()]
    aside = abs((corners - first) - np.outer(along - along.min(), normal)).max()
    if off.max() > _OFF_SLICE or aside > _OFF_SLICE * spacing:
        rule = "frames must lie in equally spaced parallel slices"
        raise ScenarioError(Mistake("ImagePositionPatient", f"{max(float(off.max()), aside):.3g}", rule), source)
    affine = np.eye(4)
    affine[:3, :3] = np.column_stack([row * between_columns, column * between_rows, normal * spacing])
    affine[:3, 3] = first
    affine[:3] *= _RAS_OF_LPS[:, None]
    if mistakes := orientation_mistakes(affine):
        raise ScenarioError(mistakes, source)
    return affine, slices.astype(np.int64)


# Endings of the names of segmentation files.
MASK_ENDINGS = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".dcm")
# Longer endings that are no part of a structure's name.
_STEMS = (".seg.nrrd", *sorted(MASK_ENDINGS, key=len, reverse=True))


@dataclass(frozen=True, eq=False)
class Structure:
    """One structure of a segmentation.

    `inside` are the voxels of the box that begins at the voxel `corner` of the grid, which has `shape` voxels, and the
    matrix `affine` from voxels to RAS mm.
    """

    name: str
    source: str
    affine: NDArray[np.float64]
    shape: tuple[int, int, int]
    corner: NDArray[np.int64]
    inside: NDArray[np.bool_]

    @property
    def voxel_mm3(self) -> float:
        """Volume of a voxel."""
        return float(abs(np.linalg.det(self.affine[:3, :3])))

    @property
    def volume_ml(self) -> float:
        """Volume of the structure."""
        return float(np.count_nonzero(self.inside)) * self.voxel_mm3 / 1000


def stem_of(file: Path) -> str:
    """Return the name of a segmentation file without its ending."""
    ending = next((end for end in _STEMS if file.name.lower().endswith(end)), "")
    return file.name[: len(file.name) - len(ending)]


def read_structures(file: Path, tables: Mapping[str, Mapping[str, int]]) -> list[Structure]:
    """Return the structures of a segmentation file; some may have no voxels.

    Names come from the segments or a NIfTI extension; else from the table in `tables` with the stem of the file, or
    from the only table. Else a mask with one label has the stem of its file as its name. Raises ScenarioError if the
    file cannot be read, or has several labels without names.
    """
    if file.name.lower().endswith(".dcm"):
        structures: list[Structure] = []
        for segment, matrix, mask in dicom_segments(file):  # one at a time, for the memory
            if any(segment == structure.name for structure in structures):
                raise ScenarioError(Mistake("SegmentLabel", segment, "is the name of two segments"), str(file))
            structures += _structures([mask], matrix, {segment: (0, 1)}, str(file))
        return structures
    if is_layered(file):
        layers, affine, layered = read_layers(file)
        return list(_structures(layers, affine, layered, str(file)))
    volume = read_labels(file)
    present = labels_present(volume.labels)
    present = present[present > 0]
    names = volume.names or extension_names(file)
    names = names or dict(tables.get(stem_of(file), {}))
    if not names and present.size > 1:
        names = dict(next(iter(tables.values()))) if len(tables) == 1 else {}
        if not names:
            rule = f"has {present.size} labels and no names: put a colour table ({stem_of(file)}.ctbl) beside it"
            raise ScenarioError(Mistake("labels", ", ".join(map(str, present[:5])), rule), str(file))
    if not names:
        names = {stem_of(file): int(present[0]) if present.size else 1}
    unnamed = [int(label) for label in present if label not in names.values()]
    if unnamed:
        raise ScenarioError(Mistake("labels", ", ".join(map(str, unnamed[:5])), "have no names"), str(file))
    segments = {name: (0, label) for name, label in names.items() if label > 0}
    return list(_structures([volume.labels], volume.affine, segments, str(file)))


def _structures(
    layers: list[NDArray[np.uint16]],
    affine: NDArray[np.float64],
    segments: Mapping[str, tuple[int, int]],
    source: str,
) -> Iterator[Structure]:
    """Yield the structures; `segments` has layer and label by name. Raises ScenarioError if two names have the same."""
    known: dict[tuple[int, int], str] = {}
    for name, place in segments.items():
        if known.setdefault(place, name) != name:
            raise ScenarioError(Mistake(name, f"{place[1]}", f"is the label of {known[place]} too"), source)
    for name, (layer, label) in segments.items():
        inside = layers[layer] == label
        filled = [np.flatnonzero(inside.any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
        first, last = ([int(indices[end]) if indices.size else 0 for indices in filled] for end in (0, -1))
        box = tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))
        ni, nj, nk = inside.shape
        yield Structure(name, source, affine, (ni, nj, nk), np.array(first), inside[box].copy(order="K"))
