"""Cases of many masks: SimpleITK says which structure a position belongs to."""

import json
from pathlib import Path

import nibabel
import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813

from needleplan.anatomy import Anatomy, AnatomyCase, CaseChoices, StructureRole, read_case, role_by_name, write_case
from needleplan.errors import OutputError, ScenarioError
from tests.anatomy.cases import (
    BALLS,
    LPS,
    TABLES,
    case_of_labels,
    layered,
    markups,
    mask,
    two_labels,
    write_masks,
)
from tests.cli.commands import needleplan, refused


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


@pytest.mark.parametrize(
    ("role", "names"),
    [
        ("body", "body_trunc body_extremities"),
        ("target", "liver_tumor"),
        ("organ", "spleen kidney_right liver pancreas adrenal_gland_left lung_upper_lobe_left thyroid_gland prostate "
         "brain kidney_cyst_left lung_left"),
        ("obstacle", "gallbladder stomach esophagus trachea small_bowel duodenum colon urinary_bladder sacrum "
         "vertebrae_L5 heart aorta pulmonary_vein brachiocephalic_trunk subclavian_artery_right "
         "common_carotid_artery_left atrial_appendage_left superior_vena_cava "
         "portal_vein_and_splenic_vein iliac_vena_left humerus_left scapula_left clavicula_left "
         "femur_left hip_left spinal_cord skull rib_left_1 sternum costal_cartilages lung_vessels "
         "lung_trachea_bronchia liver_vessels coronary_arteries vertebrae_body intervertebral_discs "
         "hip_implant"),
        ("tissue", "gluteus_maximus_left autochthon_left iliopsoas_right subcutaneous_fat torso_fat skeletal_muscle"),
    ],
)  # fmt: skip
def test_classes_of_a_segmentation_program_have_their_roles(role: str, names: str) -> None:
    assert {name: role_by_name(name)[0].value for name in names.split()} == dict.fromkeys(names.split(), role)


def test_the_entry_is_the_skin_nearest_to_the_target(tmp_path: Path) -> None:
    case = read_case(write_masks(tmp_path / "masks"))
    assert case.entry == "skin_entry"
    places = case.volume.world(np.argwhere(case.volume.labels == case.volume.names["skin_entry"]))
    assert np.linalg.norm(places, axis=-1).min() > 40 - 2 * 3**0.5
    towards = places.mean(0) / np.linalg.norm(places.mean(0))
    assert towards @ (np.array(BALLS["tumor"][0]) / np.linalg.norm(BALLS["tumor"][0])) > 0.95
    assert np.linalg.norm(places - places.mean(0), axis=-1).max() < 32


def test_the_body_has_no_skin_where_the_file_ends(tmp_path: Path) -> None:
    """The body fills the slices of a scan; the target is nearest to the first slice."""
    labels = np.zeros((30, 30, 30), np.uint8)
    labels[5:25, 5:25] = 1
    labels[14:17, 14:17, 3:6] = 2
    nibabel.save(nibabel.Nifti1Image(labels, np.diag([2.0, 2.0, 2.0, 1.0])), tmp_path / "all.nii")
    (tmp_path / "all.ctbl").write_text(TABLES["all.ctbl"])
    case = read_case(tmp_path, CaseChoices(entry_radius_mm=8.0))
    places = np.argwhere(case.volume.labels == case.volume.names["skin_entry"])
    world = case.volume.world(places) / 2
    assert (np.isin(world[:, :2], (5, 24)).any(axis=-1)).all()
    nibabel.save(nibabel.Nifti1Image(labels[5:25, 5:25], np.eye(4)), tmp_path / "all.nii")
    with pytest.raises(ScenarioError, match="no skin within the files"):
        read_case(tmp_path)


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


@pytest.mark.parametrize("table", TABLES)
def test_names_of_labels_come_from_a_table(tmp_path: Path, table: str) -> None:
    two_labels(tmp_path / "in")
    (tmp_path / "in" / table).write_text(TABLES[table])
    (tmp_path / "in" / "notes.txt").write_text("left of the patient\n")
    assert {each.name for each in read_case(tmp_path / "in").structures} == {"body", "tumor"}


def test_any_printable_name_of_folder_and_file_is_written(tmp_path: Path) -> None:
    case = case_of_labels(tmp_path / "Leber \U0001fac0 'a' \"b\"=\x7f")
    file = tmp_path / 'größe \U0001fac0 ".toml'
    write_case(case, file, curvature_radius_mm=60.0, gauge=20)
    anatomy = Anatomy.read(file)
    assert anatomy.file.title == "Leber \U0001fac0 'a' \"b\"=?"
    with pytest.raises(OutputError, match="control characters"):
        write_case(case, tmp_path / "a\nb.toml", curvature_radius_mm=60.0, gauge=20)


def test_one_label_has_its_name_in_the_table_too(tmp_path: Path) -> None:
    image = two_labels(tmp_path / "in")
    labels = np.asarray(image.dataobj)
    nibabel.save(nibabel.Nifti1Image(labels * (labels == 2), image.affine), tmp_path / "in" / "all.nii.gz")
    nibabel.save(nibabel.Nifti1Image((labels > 0).astype(np.uint8), image.affine), tmp_path / "in" / "body_1.nii.gz")
    (tmp_path / "in" / "all.ctbl").write_text("1 vein 1 2 3 255\n2 tumor 4 5 6 255\n")
    assert read_case(tmp_path / "in").target == "tumor"


def test_names_of_labels_come_from_an_extension(tmp_path: Path) -> None:
    image = two_labels(tmp_path / "in")
    text = b'<LabelTable><Label Key="1" Red="1"><![CDATA[body]]></Label><Label Key="2">tumor</Label></LabelTable>'
    image.header.extensions.append(nibabel.nifti1.Nifti1Extension(0, text))
    nibabel.save(image, tmp_path / "in" / "all.nii.gz")
    assert {each.name for each in read_case(tmp_path / "in").structures} == {"body", "tumor"}


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


@pytest.mark.parametrize("name", ["vertebrae_body", "pancreas_body", "body of stomach", "carotid body"])
def test_a_part_with_body_in_its_name_is_not_the_body(name: str) -> None:
    assert role_by_name(name)[0] is not StructureRole.BODY
    assert all(role_by_name(each)[0] is StructureRole.BODY for each in ("body", "body_trunc", "Skin", "whole body"))


@pytest.mark.slow
@pytest.mark.usefixtures("few_executions")
def test_a_folder_becomes_ranked_entries(tmp_path: Path) -> None:
    folder, file = write_masks(tmp_path / "in"), tmp_path / "case.toml"
    refused(needleplan("case", folder, "--radius", "60", "-o", file), "--gauge: is required without --margin")
    point = needleplan("case", folder, "--target-point", "0,0,0", "--radius", "60", "--gauge", "18", "-o", file)
    refused(point, "--target-radius: is required: the target is a point")
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
