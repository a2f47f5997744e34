"""Cases of many masks: SimpleITK writes them and says which structure a position belongs to."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import nibabel
import nrrd
import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

from needleplan.anatomy import AnatomyCase, CaseChoices, StructureRole, read_case, role_by_name, write_case
from needleplan.errors import ScenarioError
from tests.cli.commands import needleplan, refused

LPS = np.array([-1.0, -1.0, 1.0])
# Balls of the invented case: centre in RAS mm and radius.
BALLS = {
    "body": ((0.0, 0.0, 0.0), 40.0), "liver": ((10.0, 0.0, 0.0), 18.0), "tumor": ((12.0, 4.0, 2.0), 5.0),
    "portal_vein": ((0.0, -6.0, 0.0), 4.0), "rib_left_7": ((-20.0, 10.0, 0.0), 4.0),
    "spleen": ((-18.0, -14.0, 0.0), 8.0),
}  # fmt: skip


def mask(name: str, spacing: float = 2.0, turn_deg: float = 0.0, shift: float = 0.0) -> sitk.Image:
    """Return the mask of a ball on a grid of its own, which is turned about z."""
    angle, count = np.radians(turn_deg), round(100 / spacing)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    image = sitk.Image([count] * 3, sitk.sitkUInt8)
    image.SetSpacing([spacing] * 3)
    image.SetDirection(turn.ravel().tolist())
    image.SetOrigin((turn @ np.full(3, -spacing * (count - 1) / 2) + shift).tolist())
    places = np.stack(np.meshgrid(*[np.arange(count)] * 3, indexing="ij"), -1) * spacing
    center, radius = BALLS[name]
    lps = places @ turn.T + np.array(image.GetOrigin())
    inside = np.linalg.norm(lps - LPS * center, axis=-1) <= radius
    found = sitk.GetImageFromArray(inside.transpose(2, 1, 0).astype(np.uint8))
    found.CopyInformation(image)
    return found


def write_masks(folder: Path, names: tuple[str, ...] = tuple(BALLS), **grids: dict[str, float]) -> Path:
    folder.mkdir(exist_ok=True)
    for name in names:
        sitk.WriteImage(mask(name, **grids.get(name, {})), str(folder / f"{name}.nii.gz"))
    return folder


def in_mask(file: Path, ras: np.ndarray) -> np.ndarray:
    """Return whether positions lie in voxels of a mask, by SimpleITK."""
    image = sitk.ReadImage(str(file))
    size, found = np.array(image.GetSize()), []
    for point in LPS * ras:
        index = np.array(image.TransformPhysicalPointToIndex(point.tolist()))
        found.append(bool(((index >= 0) & (index < size)).all()) and image[index.tolist()] > 0)
    return np.array(found)


def names_at(case: AnatomyCase, rows: np.ndarray) -> list[str]:
    names = {number: name for name, number in case.volume.names.items()} | {0: ""}
    return [names[int(label)] for label in case.volume.labels[tuple(rows.T)]]


@pytest.mark.parametrize("turned", [False, True])
def test_a_voxel_belongs_to_what_is_at_its_centre(tmp_path: Path, turned: bool) -> None:
    """Grids of 2, 1.5 and 1 mm, turned against each other; obstacles before the target, tissue before the body."""
    grids = {"portal_vein": {"spacing": 1.0, "shift": 0.3}, "liver": {"spacing": 1.5}}
    if turned:
        grids = {
            "portal_vein": {"spacing": 1.0},
            "liver": {"spacing": 1.5, "turn_deg": 20.0},
            "tumor": {"turn_deg": -35.0},
        }
    folder = write_masks(tmp_path / "masks", **grids)
    case = read_case(folder)
    assert case.volume.sizes_mm == pytest.approx([1.0] * 3)
    random = np.random.default_rng(1)
    rows = np.stack([random.integers(0, size, 3000) for size in case.volume.labels.shape], -1)
    near = np.argwhere(case.volume.labels > 1)
    rows = np.concatenate([rows, near[random.integers(0, len(near), 1500)]])
    places = case.volume.world(rows)
    order = ("portal_vein", "rib_left_7", "spleen", "tumor", "liver", "body")
    held = {name: in_mask(folder / f"{name}.nii.gz", places) for name in order}
    wanted = [next((name for name in order if held[name][n]), "") for n in range(len(rows))]
    found = ["body" if name == "skin_entry" else name for name in names_at(case, rows)]
    wrong = [n for n in range(len(rows)) if found[n] != wanted[n]]
    # A centre on the face of a voxel belongs to one or the other.
    assert len(wrong) <= len(rows) // 500, [(found[n], wanted[n], places[n]) for n in wrong[:5]]


def test_the_finest_voxels_of_one_grid_are_kept(tmp_path: Path) -> None:
    folder = write_masks(tmp_path / "masks")
    case = read_case(folder)
    image = sitk.GetArrayFromImage(sitk.ReadImage(str(folder / "portal_vein.nii.gz")))
    assert np.count_nonzero(case.volume.labels == case.volume.names["portal_vein"]) == np.count_nonzero(image)
    assert [each for each in case.notes if "resampled" in each] == []


def test_masks_without_voxels_are_told(tmp_path: Path) -> None:
    folder = write_masks(tmp_path / "masks")
    sitk.WriteImage(mask("spleen") * 0, str(folder / "gallbladder.nii.gz"))
    assert "without voxels: gallbladder" in read_case(folder).notes


def test_roles_are_proposed_and_chosen(tmp_path: Path) -> None:
    folder = write_masks(tmp_path / "masks")
    roles = {each.name: each.role for each in read_case(folder).structures}
    assert roles == {
        "body": StructureRole.BODY, "liver": StructureRole.TISSUE, "tumor": StructureRole.TARGET,
        "portal_vein": StructureRole.OBSTACLE, "rib_left_7": StructureRole.OBSTACLE, "spleen": StructureRole.OBSTACLE,
    }  # fmt: skip
    chosen = CaseChoices(target="spleen", roles={"portal_vein": StructureRole.IGNORED})
    roles = {each.name: each.role for each in read_case(folder, chosen).structures}
    assert roles["spleen"] is StructureRole.TARGET
    assert roles["tumor"] is StructureRole.TISSUE
    assert roles["liver"] is StructureRole.OBSTACLE
    assert "portal_vein" not in read_case(folder, chosen).volume.names
    assert role_by_name("thing_9") == (StructureRole.OBSTACLE, "an unknown name")


def test_the_entry_is_the_skin_nearest_to_the_target(tmp_path: Path) -> None:
    case = read_case(write_masks(tmp_path / "masks"))
    assert case.entry == "skin_entry"
    places = case.volume.world(np.argwhere(case.volume.labels == case.volume.names["skin_entry"]))
    assert np.linalg.norm(places, axis=-1).min() > 40 - 2 * 3**0.5
    towards = places.mean(0) / np.linalg.norm(places.mean(0))
    assert towards @ (np.array(BALLS["tumor"][0]) / np.linalg.norm(BALLS["tumor"][0])) > 0.95
    assert np.linalg.norm(places - places.mean(0), axis=-1).max() < 32


def segments(layers: dict[str, tuple[int, int]]) -> dict[str, str]:
    header = {}
    for number, (name, (layer, label)) in enumerate(layers.items()):
        header |= {f"Segment{number}_Name": name, f"Segment{number}_Layer": str(layer),
                   f"Segment{number}_LabelValue": str(label)}  # fmt: skip
    return header


def layered(folder: Path, **changes: str) -> Path:
    """Write a segmentation of 3D Slicer with two layers, in LPS."""
    images = {name: sitk.GetArrayFromImage(mask(name)).transpose(2, 1, 0) for name in BALLS}
    data = np.zeros((2, 50, 50, 50), np.uint8)
    data[0][images["body"] > 0] = 1
    data[0][images["liver"] > 0] = 2
    data[1][images["portal_vein"] > 0] = 1
    data[1][images["tumor"] > 0] = 2
    directions = np.vstack([np.full(3, np.nan), 2.0 * np.eye(3)])
    names = {"body": (0, 1), "liver": (0, 2), "portal_vein": (1, 1), "tumor": (1, 2)}
    header = {
        "space": "left-posterior-superior", "space directions": directions, "space origin": [-49.0] * 3,
        "kinds": ["list", "domain", "domain", "domain"], "encoding": "gzip", **segments(names), **changes,
    }  # fmt: skip
    folder.mkdir(exist_ok=True)
    nrrd.write(str(folder / "all.seg.nrrd"), data, header)
    return folder


def test_layers_are_read_as_masks_are(tmp_path: Path) -> None:
    names = ("body", "liver", "portal_vein", "tumor")
    one, other = read_case(layered(tmp_path / "layers")), read_case(write_masks(tmp_path / "masks", names))
    assert {each.name: each.role for each in one.structures} == {each.name: each.role for each in other.structures}
    for name in ("liver", "portal_vein", "tumor", "skin_entry"):
        points = [
            case.volume.world(np.argwhere(case.volume.labels == case.volume.names[name])) for case in (one, other)
        ]
        # The layers have one label a voxel where masks overlap: the body ends at the liver.
        assert {*map(tuple, points[0].round(3).tolist())} == {*map(tuple, points[1].round(3).tolist())}, name


TABLES = {
    "all.ctbl": "1 body 1 2 3 255\n2 tumor 4 5 6 255\n",
    "all.csv": "LabelValue,Name,Color_R\n1,body,3\n2,tumor,4\n",
    "all.txt": '# ITK-SNAP\n0 0 0 0 0 0 0 "Clear Label"\n1 255 0 0 1 1 1 "body"\n2 0 255 0 1 1 1 "tumor"\n',
}


def two_labels(folder: Path) -> nibabel.Nifti1Image:
    folder.mkdir()
    labels = np.zeros((30, 30, 30), np.uint8)
    labels[5:25, 5:25, 5:25] = 1
    labels[14:17, 14:17, 14:17] = 2
    image = nibabel.Nifti1Image(labels, np.diag([2.0, 2.0, 2.0, 1.0]))
    nibabel.save(image, folder / "all.nii.gz")
    return image


@pytest.mark.parametrize("table", TABLES)
def test_names_of_labels_come_from_a_table(tmp_path: Path, table: str) -> None:
    two_labels(tmp_path / "in")
    (tmp_path / "in" / table).write_text(TABLES[table])
    (tmp_path / "in" / "notes.txt").write_text("left of the patient\n")
    assert {each.name for each in read_case(tmp_path / "in").structures} == {"body", "tumor"}


def test_names_of_labels_come_from_an_extension(tmp_path: Path) -> None:
    image = two_labels(tmp_path / "in")
    text = b'<LabelTable><Label Key="1" Red="1"><![CDATA[body]]></Label><Label Key="2">tumor</Label></LabelTable>'
    image.header.extensions.append(nibabel.nifti1.Nifti1Extension(0, text))
    nibabel.save(image, tmp_path / "in" / "all.nii.gz")
    assert {each.name for each in read_case(tmp_path / "in").structures} == {"body", "tumor"}


def markups(system: str, **points: list[float]) -> str:
    listed = [{"label": label, "position": position, "positionStatus": "defined"} for label, position in points.items()]
    return json.dumps({"markups": [{"type": "Fiducial", "coordinateSystem": system, "controlPoints": listed}]})


POINTS = {
    "p.mrk.json": markups("LPS", target=[-18.0, -14.0, 0.0], entry=[0.0, -39.0, 0.0]),
    "q.mrk.json": markups("RAS", target=[18.0, 14.0, 0.0], entry=[0.0, 39.0, 0.0]),
    "r.fcsv": "# CoordinateSystem = LPS\n# columns = id,x,y,z,label\n1,-18,-14,0,target\n2,0,-39,0,entry\n",
    "s.fcsv": "# CoordinateSystem = 0\n1,18,14,0,0,0,0,1,1,1,0,target,,\n2,0,39,0,0,0,0,1,1,1,0,entry,,\n",
}


@pytest.mark.parametrize("file", POINTS)
def test_marked_points_are_target_and_entry(tmp_path: Path, file: str) -> None:
    folder = write_masks(tmp_path / "in", ("body", "liver", "portal_vein"))
    (folder / file).write_text(POINTS[file])
    case = read_case(folder, CaseChoices(target_radius_mm=4.0, entry_radius_mm=12.0))
    assert not isinstance(case.target, str)
    assert case.target.center_mm == (18.0, 14.0, 0.0)
    places = case.volume.world(np.argwhere(case.volume.labels == case.volume.names["skin_entry"]))
    assert np.linalg.norm(places - [0.0, 39.0, 0.0], axis=-1).max() <= 12.0
    assert {each.name: each.role for each in case.structures}["liver"] is StructureRole.TISSUE


def moved(folder: Path) -> None:
    image = mask("rib_left_7")
    image.SetOrigin([500.0, 0.0, 0.0])
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
        (lambda _: None, {"target": (0.0, 0.0, 0.0)}, "target radius: is required"),
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


@pytest.mark.parametrize("changes", [{"Segment2_Layer": "2"}, {"Segment2_LabelValue": "x"}, {"space": "scanner-xyz"}])
def test_damaged_layers_are_refused(tmp_path: Path, changes: dict[str, str]) -> None:
    with pytest.raises(ScenarioError, match="|".join(changes)):
        read_case(layered(tmp_path / "in", **changes))


def test_a_folder_without_segmentations_is_refused(tmp_path: Path) -> None:
    (tmp_path / "1.dcm").write_bytes(b"DICM")
    with pytest.raises(ScenarioError, match=r"has no segmentation.*export DICOM SEG as"):
        read_case(tmp_path)
    with pytest.raises(ScenarioError, match="No such file"):
        read_case(tmp_path / "no")


@pytest.mark.slow
def test_a_folder_becomes_ranked_entries(tmp_path: Path) -> None:
    folder, file = write_masks(tmp_path / "in"), tmp_path / "case.toml"
    refused(needleplan("case", folder, "--radius", "60", "-o", file), "--gauge: is required without --margin")
    refused(needleplan("case", folder, "--gauge", "20", "-o", file), "--radius")
    needle = ("--radius", "60", "--gauge", "20", "-o", file)
    refused(needleplan("case", folder, *needle, "--role", "x=tissue"), "is no structure")
    refused(needleplan("case", folder, *needle, "--role", "x=y"), "must be NAME=ROLE")
    refused(needleplan("case", folder, *needle, "--role", "liver=target", "--target-point", "1,2,3"), "second target")
    words = (*needle, "--role", "spleen=tissue")
    done = needleplan("case", folder, *words, "--json")
    assert done.returncode == 0, done.stderr
    assert {each["name"]: each["role"] for each in json.loads(done.stdout)["structures"]}["spleen"] == "tissue"
    written = file.read_text()
    assert "spleen" in written
    assert "chosen (spleen.nii.gz)" in written
    refused(needleplan("case", folder, *words), "exists")
    listed = needleplan("entry", file, "--top", "1", "--json")
    assert listed.returncode == 0, listed.stderr
    assert json.loads(listed.stdout)["entries"][0]["success"] > 0.5


def test_a_case_is_written_alike_twice(tmp_path: Path) -> None:
    case = read_case(write_masks(tmp_path / "in", ("body", "liver", "tumor")))
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        write_case(case, tmp_path / name / "case.toml", curvature_radius_mm=60.0, gauge=20)
    for file in ("case.toml", "case.nii.gz", "case.ctbl"):
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()
