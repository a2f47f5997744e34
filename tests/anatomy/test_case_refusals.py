"""Cases that are wrong or unclear: each is refused with a message that says what to do."""

import math
from collections.abc import Callable
from pathlib import Path

import nibabel
import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

from needleplan.anatomy import CaseChoices, StructureRole, read_case, write_case
from needleplan.cli import main
from needleplan.errors import ScenarioError
from tests.anatomy.cases import (
    TABLES,
    case_of_labels,
    layered,
    markups,
    mask,
    two_labels,
    write_masks,
)


def names(first: str, second: str) -> dict[str, str]:
    return {"all.csv": f'LabelValue,Name\n1,"{first}"\n2,"{second}"\n'}


@pytest.mark.parametrize(
    ("files", "message"),
    [
        (names("body", "outside"), "outside: is the name of what lies between structures"),
        (names("body", "between"), "between: is the name of what lies between structures"),
        (names("left rib", "left_rib"), "left_rib: is in .*all.nii.gz, as left_rib"),
        (names("body", "a\x7f"), "must have letters and no control"),
        (names("body", " "), "must have letters and no control"),
        ({"all.csv": "LabelValue,Name\n1,body\n2\n"}, "must have letters and no control"),
        ({"all.csv": "LabelValue,Name\n1,body\n2,tumor\n2,vein\n"}, "vein = 2: is the label of tumor too"),
        ({"all.csv": f"LabelValue,Name\n{'9' * 5000},body\n"}, "must begin with the number of a label"),
        ({"all.csv": f"LabelValue,Name\n1,{'x' * 140_000}\n"}, "all.csv: cannot be read: field larger"),
        ({"all.ctbl": f"{'9' * 5000} body\n"}, "line 1 = 99999.*must be NUMBER NAME"),
    ],
)  # fmt: skip
def test_wrong_tables_of_names_are_refused(tmp_path: Path, files: dict[str, str], message: str) -> None:
    two_labels(tmp_path / "in")
    for name, content in files.items():
        (tmp_path / "in" / name).write_text(content)
    with pytest.raises(ScenarioError, match=message):
        read_case(tmp_path / "in")


@pytest.mark.parametrize("name", ["a\x1bb", "r\udcff"])
def test_names_of_files_that_are_no_text_are_refused(tmp_path: Path, name: str) -> None:
    two_labels(tmp_path / "in")
    labels = np.ones((4, 4, 4), np.uint8)
    nibabel.save(nibabel.Nifti1Image(labels, np.eye(4)), tmp_path / "mask.nii")
    (tmp_path / "mask.nii").rename(tmp_path / "in" / f"{name}.nii")
    (tmp_path / "in" / "all.ctbl").write_text(TABLES["all.ctbl"])
    with pytest.raises(ScenarioError, match="must have letters and no control"):
        read_case(tmp_path / "in")


def test_a_damaged_extension_is_refused(tmp_path: Path) -> None:
    image = two_labels(tmp_path / "in")
    image.header.extensions.append(nibabel.nifti1.Nifti1Extension(0, b"text"))
    data = bytearray(image.to_bytes())
    data[352:356] = (0).to_bytes(4, "little")  # size of the extension
    (tmp_path / "in" / "all.nii.gz").unlink()
    (tmp_path / "in" / "all.nii").write_bytes(data)
    with pytest.raises(ScenarioError, match=r"all\.nii: has a damaged NIfTI extension"):
        read_case(tmp_path / "in")


def test_what_the_anatomy_refuses_is_not_written(tmp_path: Path) -> None:
    case = case_of_labels(tmp_path / "in", CaseChoices(target=(30.5, 30.5, 30.5), target_radius_mm=0.01))
    with pytest.raises(ScenarioError, match="no voxel has its centre in this ball"):
        write_case(case, tmp_path / "case.toml", curvature_radius_mm=60.0, gauge=20)
    assert [each.name for each in tmp_path.iterdir()] == ["in"]


def test_a_target_outside_of_the_body_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"body: .*does not hold the target"):
        case_of_labels(tmp_path / "in", CaseChoices(target=(8.0, 8.0, 8.0), target_radius_mm=1.0))


@pytest.mark.parametrize("output", ["in/case.toml", "in/../in/case.toml", "/dev/null"])
def test_outputs_do_not_lie_beside_the_masks(
    tmp_path: Path, output: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "in").mkdir()
    monkeypatch.chdir(tmp_path)
    assert main(["case", "in", "--radius", "60", "--gauge", "20", "--force", "-o", output]) == 2
    assert "must be a file outside of in" in capsys.readouterr().err


ROW = "1,-18,-14,0,0,0,0,1,1,1,0"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("p.mrk.json", markups("LPS", target=[10**400, 0, 0]), "must be three numbers"),
        ("p.mrk.json", markups("LPS", target="123"), "must be three numbers"),  # type: ignore[arg-type]
        ("p.mrk.json", markups("LPS", target=[1.0, 2.0, math.nan]), "must be finite"),
        ("p.mrk.json", markups("LPS").replace('"type"', '"coordinateUnits": ["um"], "type"'), "must be mm"),
        ("p.fcsv", f"# CoordinateSystem = 2\n{ROW},a\n", "must be RAS or LPS"),
        ("p.fcsv", f"# CoordinateSystem = LPS\n{ROW},{'a' * 140_000}\n", "line 2 = .*cannot be read"),
    ],
)
def test_wrong_points_are_refused(tmp_path: Path, name: str, content: str, message: str) -> None:
    two_labels(tmp_path / "in")
    (tmp_path / "in" / "all.ctbl").write_text(TABLES["all.ctbl"])
    (tmp_path / "in" / name).write_text(content)
    with pytest.raises(ScenarioError, match=message):
        read_case(tmp_path / "in")


@pytest.mark.parametrize(
    ("points", "choices", "message"),
    [
        ({"entry to target": [0.0, 0.0, 0.0]}, {}, "names target and entry"),
        ({"a": [1.0, 0.0, 0.0], "b": [0.0, 0.0, 0.0]}, {"entry": "b", "target": "tumor"}, "is the label of 2"),
        ({}, {"entry": "tumor", "target": "tumor"}, "entry = tumor: is the target too"),
    ],
)
def test_an_unclear_choice_is_refused(
    tmp_path: Path, points: dict[str, list[float]], choices: dict[str, str], message: str
) -> None:
    two_labels(tmp_path / "in")
    (tmp_path / "in" / "all.ctbl").write_text(TABLES["all.ctbl"].replace("tumor", "tumor" if choices else "liver"))
    for system in ("LPS", "RAS") if len(points) == 2 else ("LPS",):
        (tmp_path / "in" / f"{system}.mrk.json").write_text(markups(system, **points), encoding="utf-8-sig")
    with pytest.raises(ScenarioError, match=message):
        read_case(tmp_path / "in", CaseChoices(target_radius_mm=3.0, **choices))  # type: ignore[arg-type]


def test_a_hollow_body_is_refused(tmp_path: Path) -> None:
    """A shell of the skin, with the target, as a mask or as a point, in what would be outside of the body."""
    place = np.stack(np.meshgrid(*[np.arange(40)] * 3, indexing="ij"), -1)
    distance = np.linalg.norm(place - 20, axis=-1)
    for name, inside in (("skin", abs(distance - 15) < 1.5), ("tumor", distance < 3)):
        nibabel.save(nibabel.Nifti1Image(inside.astype(np.uint8), np.diag([2.0, 2, 2, 1])), tmp_path / f"{name}.nii")
    with pytest.raises(ScenarioError, match="skin: is hollow"):
        read_case(tmp_path)
    (tmp_path / "tumor.nii").unlink()
    with pytest.raises(ScenarioError, match="skin: is hollow"):
        read_case(tmp_path, CaseChoices(target=(40.0, 40.0, 40.0), target_radius_mm=3.0))
    organ = nibabel.Nifti1Image((distance < 14).astype(np.uint8), np.diag([2.0, 2, 2, 1]))
    nibabel.save(organ, tmp_path / "liver.nii")
    assert read_case(tmp_path, CaseChoices(target=(40.0, 40.0, 40.0), target_radius_mm=3.0)).entry == "skin_entry"


def test_a_structure_between_the_voxels_is_refused(tmp_path: Path) -> None:
    two_labels(tmp_path / "in")
    (tmp_path / "in" / "all.ctbl").write_text(TABLES["all.ctbl"])
    fine = np.ones((20, 20, 4), np.uint8)
    nibabel.save(nibabel.Nifti1Image(fine, np.diag([0.5, 0.5, 6.0, 1.0])), tmp_path / "in" / "bone.nii")
    thin = np.zeros((8, 8, 8), np.uint8)
    thin[:, :, 1] = 1  # at z = 3 mm, between 0 and 6 mm
    nibabel.save(nibabel.Nifti1Image(thin, np.diag([1.3, 1.3, 3.0, 1.0])), tmp_path / "in" / "vein.nii")
    with pytest.raises(ScenarioError, match="vein: lies between the voxels"):
        read_case(tmp_path / "in")
    assert read_case(tmp_path / "in", CaseChoices(roles={"vein": StructureRole.IGNORED})).target == "tumor"


def moved(folder: Path) -> None:
    image = mask("rib_left_7")
    image.SetOrigin([500.0, 0.0, 0.0])
    sitk.WriteImage(image, str(folder / "rib_left_7.nii.gz"))


def moved_and_fine(folder: Path) -> None:
    image = mask("rib_left_7")
    image.SetOrigin([500.0, 0.0, 0.0])
    image.SetSpacing([size / 2 for size in image.GetSpacing()])
    sitk.WriteImage(image, str(folder / "rib_left_7.nii.gz"))


def without_orientation(folder: Path) -> None:
    image = nibabel.load(folder / "spleen.nii.gz")
    image.header["qform_code"] = image.header["sform_code"] = 0
    nibabel.save(nibabel.Nifti1Image(np.asarray(image.dataobj), None, image.header), folder / "spleen.nii.gz")


def twice(folder: Path) -> None:
    sitk.WriteImage(mask("liver"), str(folder / "liver.nrrd"))


def overlapping(folder: Path) -> None:
    image = mask("tumor")
    sitk.WriteImage(image, str(folder / "hepatic_artery.nii.gz"))


def five_axes(folder: Path) -> None:
    nibabel.save(nibabel.Nifti1Image(np.ones((4, 4, 4, 2, 2), np.uint8), np.eye(4)), folder / "many.nii.gz")


def unnamed(folder: Path) -> None:
    nibabel.save(nibabel.Nifti1Image(np.arange(64, dtype=np.uint8).reshape(4, 4, 4), np.eye(4)), folder / "many.nii.gz")


def text(name: str, content: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).write_text(content) and None


@pytest.mark.parametrize(
    ("change", "choices", "message"),
    [
        (moved, {}, "does not overlap"),
        (moved_and_fine, {}, "rib_left_7.nii.gz: its grid does not overlap with that of any other file"),
        (without_orientation, {}, "spleen.nii.gz: orientation"),
        (twice, {}, "liver: is in "),
        (overlapping, {}, r"hepatic_artery: overlaps the target tumor by 0\.\d+ ml"),
        (five_axes, {}, "many.nii.gz: dim"),
        (unnamed, {}, "has 63 labels and no names"),
        (text("many.nii.gz", "no volume"), {}, "many.nii.gz"),
        (text("p.mrk.json", "{}"), {}, "is no markups file"),
        (text("p.fcsv", "1,2,3,4\n"), {}, "coordinate system"),
        (text("p.mrk.json", markups("LPS", target=[0.0, 0.0, 0.0])), {"target_radius_mm": 3.0}, "are several: choose"),
        (lambda _: None, {"target": (500.0, 0.0, 0.0), "target_radius_mm": 3.0}, "lies outside of all"),
        (lambda _: None, {"target": (0.0, 0.0, 0.0)}, "target_radius_mm: is required"),
        (lambda _: None, {"target": "tumour"}, 'did you mean "tumor"'),
        (lambda _: None, {"roles": {"livr": StructureRole.TISSUE}}, 'did you mean "liver"'),
        (lambda _: None, {"entry": (0.0, 0.0, 0.0), "entry_radius_mm": 2.0}, "no skin within 2 mm"),
        (lambda _: None, {"roles": {"tumor": StructureRole.TISSUE}}, "target: is not known"),
        (lambda _: None, {"roles": {"body": StructureRole.IGNORED}}, "entry: is not known"),
    ],
)
def test_what_is_wrong_is_said(
    tmp_path: Path, change: Callable[[Path], None], choices: dict[str, object], message: str
) -> None:
    folder = write_masks(tmp_path / "in")
    change(folder)
    with pytest.raises(ScenarioError, match=message):
        read_case(folder, CaseChoices(**choices))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "changes",
    [
        {"Segment2_Layer": "2"}, {"Segment2_LabelValue": "x"}, {"space": "scanner-xyz"}, {"Segment2_Layer": "9" * 5000},
        {"Segment2_LabelValue": "9" * 5000}, {"Segment2_Name": "body"},
    ],
)  # fmt: skip
def test_damaged_layers_are_refused(tmp_path: Path, changes: dict[str, str]) -> None:
    with pytest.raises(ScenarioError, match="|".join(changes)):
        read_case(layered(tmp_path / "in", **changes))


def test_layers_without_directions_are_refused(tmp_path: Path) -> None:
    file = layered(tmp_path / "in") / "all.seg.nrrd"
    file.write_bytes(file.read_bytes().replace(b"space directions", b"x directions"))
    with pytest.raises(ScenarioError, match="space directions: is missing"):
        read_case(tmp_path / "in")


def test_a_folder_without_segmentations_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="has no segmentation"):
        read_case(tmp_path)
    with pytest.raises(ScenarioError, match="No such file"):
        read_case(tmp_path / "no")
