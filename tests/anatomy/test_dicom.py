"""DICOM SEG as structures of a case: places, segments that overlap, and what is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from needleplan.anatomy import read_case
from needleplan.errors import ScenarioError

pydicom = pytest.importorskip("pydicom", reason="pydicom is not installed: `pip install needleplan[dicom]`")
from pydicom.dataset import Dataset, FileMetaDataset  # noqa: E402
from pydicom.pixels import pack_bits  # noqa: E402
from pydicom.sequence import Sequence  # noqa: E402

SHAPE = (12, 10, 8)  # columns, rows, slices
SIZE = (1.0, 1.5, 2.0)


def nested(**values: Any) -> Sequence:
    dataset = Dataset()
    for name, value in values.items():
        setattr(dataset, name, value)
    return Sequence([dataset])


def segmentation(masks: dict[str, np.ndarray], **changes: Any) -> Dataset:
    """Return a SEG of masks, (columns, rows, slices), at the LPS place (5, 6, 7); empty slices have no frame."""
    data = Dataset()
    data.SOPClassUID, data.SOPInstanceUID = "1.2.840.10008.5.1.4.1.1.66.4", "1.2.3"
    data.SegmentationType, data.Columns, data.Rows = "BINARY", SHAPE[0], SHAPE[1]
    data.BitsAllocated = data.BitsStored = data.SamplesPerPixel = 1
    data.HighBit = data.PixelRepresentation = 0
    data.PhotometricInterpretation = "MONOCHROME2"
    plane = nested(ImageOrientationPatient=[1, 0, 0, 0, 1, 0])
    measures = nested(PixelSpacing=[SIZE[1], SIZE[0]], SliceThickness=SIZE[2])
    data.SharedFunctionalGroupsSequence = nested(PlaneOrientationSequence=plane, PixelMeasuresSequence=measures)
    data.SegmentSequence, data.PerFrameFunctionalGroupsSequence, frames = Sequence(), Sequence(), []
    for number, (name, mask) in enumerate(masks.items(), start=1):
        data.SegmentSequence += nested(SegmentNumber=number, SegmentLabel=name)
        for place in np.flatnonzero(mask.any((0, 1))):
            data.PerFrameFunctionalGroupsSequence += nested(
                PlanePositionSequence=nested(ImagePositionPatient=[5.0, 6.0, 7.0 + SIZE[2] * place]),
                SegmentIdentificationSequence=nested(ReferencedSegmentNumber=number),
            )
            frames.append(mask[:, :, place].T)
    data.NumberOfFrames = len(frames)
    data.PixelData = pack_bits(np.stack(frames).astype(np.uint8).ravel())
    for name, value in changes.items():
        setattr(data, name, value)
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
    data.file_meta.MediaStorageSOPClassUID, data.file_meta.MediaStorageSOPInstanceUID = data.SOPClassUID, "1.2.3"
    return data


def masks() -> dict[str, np.ndarray]:
    found = {name: np.zeros(SHAPE, bool) for name in ("body", "target lesion", "entry")}
    found["body"][1:11, 1:9, 1:7] = True  # overlaps both others
    found["target lesion"][7:9, 3:5, 3:5] = True
    found["entry"][1:3, 3:7, 2:6] = True
    return found


def written(folder: Path, data: Dataset) -> Path:
    data.save_as(folder / "case.dcm", enforce_file_format=True)
    return folder


def test_segments_are_where_the_object_says(tmp_path: Path) -> None:
    case = read_case(written(tmp_path, segmentation(masks())))
    volumes = {each.name: each.volume_ml for each in case.structures}
    assert volumes == pytest.approx(
        {"body": 10 * 8 * 6 * 0.003, "target lesion": 8 * 0.003, "entry": 2 * 4 * 4 * 0.003}
    )
    inside = case.volume.world(np.argwhere(case.volume.labels == case.volume.names["target lesion"]))
    # LPS (5 + 7.5 * 1, 6 + 3.5 * 1.5, 7 + 3.5 * 2), in RAS
    assert inside.mean(0) == pytest.approx([-12.5, -11.25, 14.0])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"SOPClassUID": "1.2.840.10008.5.1.4.1.1.2"}, "is no DICOM SEG but CT Image Storage"),
        ({"SegmentationType": "FRACTIONAL"}, "must be BINARY"),
        ({"PixelData": b"\0\0"}, "NumberOfFrames"),
        ({"PerFrameFunctionalGroupsSequence": Sequence([Dataset()])}, "or lacks a part"),
        ({"SegmentSequence": nested(SegmentNumber=9, SegmentLabel="x")}, "ReferencedSegmentNumber"),
    ],
)
def test_what_is_no_segmentation_is_refused(tmp_path: Path, changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ScenarioError, match=says):
        read_case(written(tmp_path, segmentation(masks(), **changes)))


def test_a_file_that_is_no_dicom_is_refused(tmp_path: Path) -> None:
    (tmp_path / "1.dcm").write_bytes(b"DICM")
    with pytest.raises(ScenarioError, match=r"1\.dcm"):
        read_case(tmp_path)
