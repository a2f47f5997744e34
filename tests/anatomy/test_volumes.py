"""Volumes are read with their orientation; wrong, damaged and hostile files are refused by one clear error."""

import gzip
import struct
from pathlib import Path
from typing import Any

import nibabel
import nrrd
import numpy as np
import pytest
import SimpleITK

from needleplan.anatomy import LabelVolume, nifti_bytes, read_color_table, read_volume
from needleplan.errors import ScenarioError
from tests.anatomy.volumes import rotation

LABELS = np.arange(4 * 5 * 6, dtype=np.uint16).reshape(4, 5, 6)
# Offsets in the header of NIfTI-1.
DIM, BITPIX, VOX_OFFSET, XYZT, QFORM, SFORM, QOFFSET_X, SROW_X, MAGIC = 40, 72, 108, 123, 252, 254, 268, 280, 344


def oblique(seed: int = 1) -> np.ndarray:
    affine = np.eye(4)
    affine[:3, :3] = rotation(seed) @ np.diag([1.0, 2.0, 3.5])
    affine[:3, 3] = [-20.0, 7.0, 90.0]
    return affine


def nifti(**changes: Any) -> bytearray:
    """Return an uncompressed NIfTI file."""
    return bytearray(gzip.decompress(nifti_bytes(LabelVolume(LABELS, changes.get("affine", oblique())))))


def refusal(file: Path, content: bytes) -> str:
    """Return the message with which a file is refused, without the name of the file."""
    file.write_bytes(content)
    with pytest.raises(ScenarioError) as caught:
        read_volume(file)
    assert caught.value.source.startswith(str(file.parent))
    return str(caught.value).removeprefix(f"{file}: ")


def write_itk(file: Path, affine: np.ndarray) -> None:
    """Write the labels with SimpleITK, which has LPS coordinates."""
    image = SimpleITK.GetImageFromArray(LABELS.transpose(2, 1, 0))
    flip = np.diag([-1.0, -1.0, 1.0])
    sizes = np.linalg.norm(affine[:3, :3], axis=0)
    image.SetSpacing(sizes.tolist())
    image.SetDirection((flip @ affine[:3, :3] / sizes).ravel().tolist())
    image.SetOrigin((flip @ affine[:3, 3]).tolist())
    SimpleITK.WriteImage(image, str(file), useCompression=file.suffix in (".gz", ".nrrd"))


@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz", "a.nrrd", "a.nhdr"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_files_of_itk_are_read_with_their_place(tmp_path: Path, name: str, mirrored: bool) -> None:
    affine = oblique() @ np.diag([-1.0 if mirrored else 1.0, 1.0, 1.0, 1.0])
    write_itk(tmp_path / name, affine)
    volume = read_volume(tmp_path / name)
    np.testing.assert_array_equal(volume.labels, LABELS)
    np.testing.assert_allclose(volume.affine, affine, atol=2e-5)
    np.testing.assert_allclose(volume.voxels(volume.world([[1.5, 2.0, 3.0]])), [[1.5, 2.0, 3.0]], atol=1e-9)


@pytest.mark.parametrize("space", ["right-anterior-superior", "left-posterior-superior", "left-anterior-superior"])
def test_spaces_of_nrrd_become_ras(tmp_path: Path, space: str) -> None:
    signs = {"right": 1, "left": -1}[space.split("-")[0]], {"anterior": 1, "posterior": -1}[space.split("-")[1]], 1
    directions = np.array([[1.0, 0, 0], [0, 2.0, 0], [0, 0, 3.0]])
    header = {"space": space, "space directions": directions, "space origin": [10.0, 20.0, 30.0]}
    nrrd.write(str(tmp_path / "a.nrrd"), LABELS, header)
    affine = read_volume(tmp_path / "a.nrrd").affine
    np.testing.assert_allclose(affine[:3, 3], np.array([10.0, 20.0, 30.0]) * signs)
    np.testing.assert_allclose(np.diag(affine)[:3], np.array([1.0, 2.0, 3.0]) * signs)


def test_segments_have_names(tmp_path: Path) -> None:
    header = {
        "space": "left-posterior-superior", "space directions": np.eye(3), "space origin": [0.0, 0.0, 0.0],
        "Segment0_Name": "portal vein", "Segment0_LabelValue": "7", "Segment0_Layer": "0",
    }  # fmt: skip
    nrrd.write(str(tmp_path / "a.seg.nrrd"), LABELS, header)
    assert read_volume(tmp_path / "a.seg.nrrd").names == {"portal vein": 7}


def test_scaled_and_real_values_must_be_labels(tmp_path: Path) -> None:
    real = nibabel.Nifti1Image(LABELS.astype(np.float32), oblique())
    (tmp_path / "a.nii").write_bytes(real.to_bytes())
    assert read_volume(tmp_path / "a.nii").labels.dtype == np.uint16
    for values, found in ((LABELS + 0.5, "voxels = 0.5: must be labels"), (LABELS - 3.0, "voxels = -3 to 116")):
        image = nibabel.Nifti1Image(values.astype(np.float32), oblique())
        assert found in refusal(tmp_path / "a.nii", image.to_bytes())
    image = nibabel.Nifti1Image(np.where(LABELS == 3, np.nan, LABELS).astype(np.float32), oblique())
    assert "must be labels" in refusal(tmp_path / "a.nii", image.to_bytes())


@pytest.mark.parametrize(
    ("offset", "form", "value", "message"),
    [
        (DIM + 6, "h", -4, "dim = 4 x 5 x -4: must be positive"),
        (DIM + 2, "hhh", (30000, 30000, 30000), "GiB fit here: crop or resample it"),
        (DIM + 2, "h", 9, "truncated"),
        (DIM + 2, "h", 3, "holds more than"),
        (DIM, "hhhhh", (4, 4, 5, 3, 2), "must be a volume of 3 dimensions, not 4"),
        (VOX_OFFSET, "f", 2.0, "vox offset 2 too low"),
        (XYZT, "B", 1, "xyzt_units = meter: must be mm"),
        (XYZT, "B", 240 + 5, "xyzt_units = 5: must be mm"),
        (SROW_X, "I", 0x7F800001, "must be finite"),  # a signalling NaN, at which NumPy warns
        (SROW_X, "12f", (0,) * 12, "voxel sizes must be from 0.01 to 100 mm"),
        (SROW_X, "ffff", (1, 1, 1, 1), "the axes must be perpendicular"),
        (SROW_X, "ffff", (float("nan"), 1, 1, 1), "must be finite"),
        (MAGIC, "4s", b"ni1\0", "belongs to a pair"),
        (0, "i", 12, "is not a NIfTI file"),
    ],
)
def test_headers_of_nifti(tmp_path: Path, offset: int, form: str, value: Any, message: str) -> None:
    content = nifti()
    struct.pack_into("<h", content, QFORM, 0)
    struct.pack_into(f"<{form}", content, offset, *(value if isinstance(value, tuple) else (value,)))
    assert message in refusal(tmp_path / "a.nii", bytes(content))
    assert message in refusal(tmp_path / "a.nii.gz", gzip.compress(bytes(content)))


def test_missing_and_contradicting_orientation(tmp_path: Path) -> None:
    content = nifti()
    struct.pack_into("<hh", content, QFORM, 0, 0)
    found = refusal(tmp_path / "a.nii", bytes(content))
    assert found.startswith("orientation: is missing: sform_code and qform_code are 0")
    content = nifti()
    struct.pack_into("<f", content, SROW_X + 12, 500.0)
    assert "sform and qform place voxels up to" in refusal(tmp_path / "a.nii", bytes(content))
    content = nifti()
    struct.pack_into("<f", content, SROW_X, float("nan"))
    assert "must be finite: the file does not say where" in refusal(tmp_path / "a.nii", bytes(content))
    content = nifti()
    struct.pack_into("<f", content, QOFFSET_X, float("inf"))
    assert "qform: must be finite" in refusal(tmp_path / "a.nii", bytes(content))
    header: dict[str, Any] = {"space": "RAS", "space directions": np.eye(3), "space origin": np.zeros(3)}
    for key in header:
        rest = {name: value for name, value in header.items() if name != key}
        nrrd.write(str(tmp_path / "a.nrrd"), LABELS, rest)
        assert "is missing" in refusal(tmp_path / "a.nrrd", (tmp_path / "a.nrrd").read_bytes())
    nrrd.write(str(tmp_path / "a.nrrd"), LABELS, {**header, "space": "scanner-xyz"})
    assert "space = scanner-xyz" in refusal(tmp_path / "a.nrrd", (tmp_path / "a.nrrd").read_bytes())


def test_headers_of_nrrd(tmp_path: Path) -> None:
    header = {"space": "RAS", "space directions": np.eye(3), "space origin": np.zeros(3)}
    nrrd.write(str(tmp_path / "a.nrrd"), LABELS, header)
    good = (tmp_path / "a.nrrd").read_bytes()
    for old, new, message in (
        (b"sizes: 4 5 6", b"sizes: 4 5 60000000", "sizes"),
        (b"sizes: 4 5 6", b"sizes: 4 5 7", "truncated"),
        (b"sizes: 4 5 6", b"sizes: 4 5 5", "holds more than"),
        (b"encoding: gzip", b"encoding: bzip2", "encoding = bzip2: must be raw or gzip"),
        (b"type: uint16", b"type: block", "type = block"),
        (b"endian: little\n", b"", "endian = None: must be little or big"),
        (b"dimension: 3", b"dimension: x", "damaged NRRD header"),
        (b"NRRD000", b"HELLO00", "is not an NRRD file"),
        (b"(1,0,0)", b"(nan,0,0)", "affine"),
        (b"encoding: gzip", b"encoding: gzip\ndata file: ../etc/passwd", "one file beside the header"),
    ):
        if old == b"(1,0,0)" and old not in good:
            old, new = b"(1.0,0.0,0.0)", b"(nan,0.0,0.0)"
        assert old in good, old
        assert message in refusal(tmp_path / "a.nrrd", good.replace(old, new))


def test_bombs_are_refused_before_they_are_unpacked(tmp_path: Path) -> None:
    bomb = gzip.compress(bytes(nifti()) + bytes(50_000_000))
    assert "holds more than" in refusal(tmp_path / "a.nii.gz", bomb)
    content = nifti()
    struct.pack_into("<hhh", content, DIM + 2, 600, 600, 600)
    small = gzip.compress(bytes(content))
    assert "the file holds at most" in refusal(tmp_path / "a.nii.gz", small)


def test_every_truncation_and_flipped_bit_is_an_error_or_a_volume(tmp_path: Path) -> None:
    random = np.random.default_rng(7)
    nrrd.write(
        str(tmp_path / "source.nrrd"), LABELS,
        {"space": "LPS", "space directions": np.eye(3), "space origin": np.zeros(3)},
    )  # fmt: skip
    sources = {"a.nii": bytes(nifti()), "b.nii.gz": gzip.compress(bytes(nifti()), mtime=0)}
    sources["c.nrrd"] = (tmp_path / "source.nrrd").read_bytes()
    refused = dict.fromkeys(sources, 0)
    for case in range(210):
        name = list(sources)[case % 3]
        content = bytearray(sources[name])
        if case % 2:
            content = content[: random.integers(len(content))]
        else:
            content[random.integers(len(content))] ^= 1 << random.integers(8)
        (tmp_path / name).write_bytes(content)
        try:
            volume = read_volume(tmp_path / name)
        except ScenarioError as error:
            refused[name] += 1
            assert "\n" not in str(error)
        else:
            assert not case % 2, "a truncated file was read"
            assert volume.labels.ndim == 3
            assert name != "b.nii.gz" or (volume.labels == LABELS).all()
    assert all(35 <= count <= 70 for count in refused.values()), refused


def test_other_files_are_refused(tmp_path: Path) -> None:
    assert "must end in .nii, .nii.gz" in refusal(tmp_path / "a.dcm", b"x")
    for name in ("a.nii", "a.nii.gz", "a.nrrd"):
        assert refusal(tmp_path / name, b"")
    with pytest.raises(ScenarioError, match="No such file"):
        read_volume(tmp_path / "missing.nii")
    (tmp_path / "folder.nii").mkdir()
    with pytest.raises(ScenarioError, match="cannot be read"):
        read_volume(tmp_path / "folder.nii")


def test_nibabel_prints_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    content = nifti()
    struct.pack_into("<f", content, 76, 3.0)  # a wrong qfac, about which nibabel would print a line
    (tmp_path / "a.nii").write_bytes(content)
    try:
        read_volume(tmp_path / "a.nii")
    except ScenarioError as error:
        assert "header" in str(error) or "sform" in str(error)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "contains no labels"),
        ("one liver 0 0 0 0\n", "line 1 = one liver 0 0 0 0: must be NUMBER NAME R G B A"),
        ("1 liver 0 0 0 0\n2 liver 0 0 0 0\n", "line 2 = liver: is also the name of label 1"),
        ("3 vessel 0 0 0 0\n3 gut 0 0 0 0\n", "line 2 = gut: label 3 has the name vessel already"),
        (
            "9 skin entry 1 1 1 255\n",
            "line 1 = 9 skin entry 1 1 1 255: must be NUMBER NAME R G B A; write _ for blanks",
        ),
        ('7 "a lesion" 1 1 1 255\n', "write _ for blanks in the name"),
        ("7 lesion 1 1 1 255 0\n", "write _ for blanks in the name"),
    ],
)
def test_color_tables(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "labels.ctbl").write_text(text)
    with pytest.raises(ScenarioError) as caught:
        read_color_table(tmp_path / "labels.ctbl")
    assert message in str(caught.value)
