"""DICOM segmentation objects (DICOM SEG, PS3.3 A.51), by way of pydicom.

A frame is a slice of one segment: rows, columns, place and direction in LPS are those of the functional groups of the
object itself, so that the series that was segmented is not needed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.anatomy._bytes import counted_bytes, require_size
from needleplan.anatomy._volume import orientation_mistakes
from needleplan.errors import Mistake, ScenarioError
from needleplan.extras import require

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["dicom_segments"]

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
