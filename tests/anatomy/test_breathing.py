"""Breathing: where the tissue is, what executions in the moved anatomy show, and the files that describe it."""

import json
import math
from dataclasses import replace
from pathlib import Path

import nibabel
import nrrd
import numpy as np
import pytest

from needleplan.anatomy import Anatomy, AnatomyFile, Breathing, LabelVolume, SpaceScenario, Sphere
from needleplan.errors import ScenarioError
from needleplan.planning import SpaceTable, plan_space, success_in_breath
from needleplan.planning._promise import Truths
from needleplan.planning._space_truth import reached_in_space
from needleplan.sweep import Sweep
from tests.anatomy.volumes import NAMES, TEXT, anatomy, box, write
from tests.cli.commands import needleplan

BREATH = '\n[breathing]\nfull_mm = 8.0\nfade_mm = 20.0\nstill = ["vessel"]\ntoward = [1.0, 0.0, 0.0]\n'


def field(folder: Path, vector: tuple[float, ...], space: str = "left-posterior-superior") -> None:
    """Write a displacement field that is the same everywhere."""
    values = np.zeros((len(vector), 4, 4, 4), np.float32) + np.array(vector, np.float32)[:, None, None, None]
    header = {
        "space": space, "kinds": ["vector", "domain", "domain", "domain"], "space origin": [-10.0, -10.0, -10.0],
        "space directions": [[np.nan] * 3, [20.0, 0, 0], [0, 20.0, 0], [0, 0, 30.0]],
    }  # fmt: skip
    nrrd.write(str(folder / "field.nrrd"), values, header)


def moving(folder: Path, breath: str, text: str = TEXT) -> Anatomy:
    return Anatomy.read(write(folder, box(), text + breath))


def test_bone_is_at_rest_and_tissue_moves_in_proportion_to_its_distance(tmp_path: Path) -> None:
    labels = np.zeros((40, 6, 6), np.uint16)
    labels[:4] = NAMES["vessel"]
    labels[30] = NAMES["target"]  # 26 voxels of 1 mm from the face of the bone: beyond fade_mm
    labels[12:15] = NAMES["body"]
    volume = LabelVolume(labels, np.eye(4))
    write(tmp_path, box(), TEXT + BREATH)
    motion = Anatomy.read(tmp_path / "anatomy.toml").motion
    assert motion is not None
    moved, (place,) = motion.moved(volume, 0.5, [(13.5, 3.0, 3.0)], None)  # 10 mm from the face
    line = moved.labels[:, 3, 3]
    assert (line[:4] == NAMES["vessel"]).all()
    assert np.flatnonzero(line == NAMES["target"]).tolist() == [34]
    assert place[0] - 4 * (place[0] - 3.5) / 20 == pytest.approx(13.5, abs=1e-3)
    assert place[1:] == (3.0, 3.0)


def test_the_level_is_that_of_lujan() -> None:
    times = np.linspace(-3, 9, 50)
    breathing = Breathing(full_mm=10.0, still=(1,), period_s=4.0)
    assert breathing.level_at(times) == pytest.approx(np.cos(math.pi * times / 4 - math.pi / 2) ** 4)
    sine = replace(breathing, rest=0.0)
    assert sine.level_at(times) == pytest.approx((1 - np.cos(2 * math.pi * times / 4)) / 2)
    assert [breathing.level_for(each) for each in (0, 2.5, 11)] == [0, 0.25, None]
    assert replace(breathing, level=0.9).level_for(5.0) == pytest.approx(0.4)


def test_a_field_moves_as_its_space_says(tmp_path: Path) -> None:
    field(tmp_path, (-3.0, 0.0, 0.0))  # to the left in LPS: R
    text = '\n[breathing]\nfull_mm = 8.0\nfield = "field.nrrd"\n'
    anatomy = moving(tmp_path, text)
    moved = anatomy.inspired(1.0)
    assert np.array_equal(moved.volume.labels[4:], anatomy.volume.labels[:-4])
    planned = moving(tmp_path, text + "level = 1.0\n")
    assert np.array_equal(planned.volume.labels, moved.volume.labels)
    assert planned.exhaled is not None
    assert np.array_equal(planned.exhaled.volume.labels, anatomy.volume.labels)


def test_a_field_of_simpleitk_is_in_lps_and_one_of_displacements_in_ras(tmp_path: Path) -> None:
    itk = pytest.importorskip("SimpleITK")
    values = np.zeros((4, 5, 6, 3))  # k, j, i, and a vector to the left in LPS: R
    values[..., 0], values[..., 2] = -3.0, 0.5
    image = itk.GetImageFromArray(values.astype(np.float32), isVector=True)
    image.SetSpacing((20.0, 20.0, 30.0))
    image.SetOrigin((-100.0, -100.0, -10.0))
    itk.WriteImage(image, str(tmp_path / "field.nii"))
    same = nibabel.load(tmp_path / "field.nii")
    same.header.set_intent(1006)
    nibabel.save(same, tmp_path / "other.nii")
    for name, right in (("field.nii", 3.0), ("other.nii", -3.0)):
        motion = moving(tmp_path, f'\n[breathing]\nfull_mm = 8.0\nfield = "{name}"\n').motion
        assert motion is not None
        (phase,) = motion.phases
        assert phase.values.shape == (3, 6, 5, 4)
        assert phase.at(np.array([[5.0, 5.0, 5.0]]))[0] * math.hypot(3.0, 0.5) == pytest.approx([right, 0.0, 0.5])
        assert phase.affine[:3, 3] == pytest.approx([100.0, 100.0, -10.0])


def test_phases_have_the_levels_of_their_largest_displacement(tmp_path: Path) -> None:
    """Three phases in one 5-D file, the first at rest: forwards, then to the right, as tissue that loops."""
    values = np.zeros((3, 3, 3, 3, 3), np.float32)
    values[..., 1, :], values[..., 2, :] = [0.0, -2.0, 0.0], [-6.0, -2.0, 0.0]  # LPS
    image = nibabel.Nifti1Image(values, np.diag([30.0, 30.0, 40.0, 1.0]))
    image.header.set_intent(1007)
    image.set_sform(image.affine, 1)
    nibabel.save(image, tmp_path / "phases.nii")
    motion = moving(tmp_path, '\n[breathing]\nfull_mm = 10.0\nfield = ["phases.nii"]\n').motion
    assert motion is not None
    first, second = (phase.level for phase in motion.phases)
    assert (first, second) == (pytest.approx(2 / math.hypot(6, 2)), 1.0)
    scale = 10 / math.hypot(6, 2)
    for level, wanted in ((first / 2, [0, 1, 0]), (first, [0, 2, 0]), ((1 + first) / 2, [3, 2, 0]), (1.0, [6, 2, 0])):
        _, (place,) = motion.moved(anatomy(box()).volume, level, [(10.0, 10.0, 10.0)], None)
        assert np.array(place) - 10 == pytest.approx(scale * np.array(wanted), abs=1e-5)
    with pytest.raises(ScenarioError, match="from exhalation to full inspiration"):
        moving(tmp_path, '\n[breathing]\nfull_mm = 10.0\nfield = ["phases.nii", "phases.nii"]\n')


def test_balls_move_with_their_tissue(tmp_path: Path) -> None:
    field(tmp_path, (-3.0, 0.0, 0.0))
    ball = TEXT.replace('target = "target"', "target = { center_mm = [18.0, 18.0, 50.0], radius_mm = 5.0 }")
    anatomy = moving(tmp_path, '\n[breathing]\nfull_mm = 8.0\nfield = "field.nrrd"\nlevel = 0.5\n', ball)
    scenario = SpaceScenario.of(anatomy)
    assert scenario.grid.frame.world(scenario.target_mm) == pytest.approx([22.0, 18.0, 50.0])
    assert scenario.file.anatomy.target == Sphere((18.0, 18.0, 50.0), 5.0)


@pytest.fixture(scope="module")
def shifted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Anatomy, SpaceTable]:
    folder = tmp_path_factory.mktemp("shifted")
    field(folder, (0.0, -1.0, 0.0))
    anatomy = moving(folder, '\n[breathing]\nfull_mm = 8.0\nfield = "field.nrrd"\n')
    return anatomy, plan_space(SpaceScenario.of(anatomy), threads=1)


@pytest.mark.usefixtures("few_executions")
def test_a_motion_of_everything_is_an_error_of_the_registration(shifted: tuple[Anatomy, SpaceTable]) -> None:
    """Executions in an anatomy that moves by whole voxels equal those in the plan's by a rigid motion."""
    anatomy, table = shifted
    scenario, pose = table.scenario, np.array(table.best_entry().pose)
    found = success_in_breath(table, anatomy, [pose], (0.0, 4.0, 8.0, 20.0), executions=400)
    assert [(each.residual_mm, each.level) for each in found] == [(0.0, 0.0), (4.0, 0.5), (8.0, 1.0)]
    for each in found:
        shift = scenario.grid.frame.axes @ [0.0, each.residual_mm, 0.0]
        rows = np.repeat(np.column_stack([np.eye(3), -shift])[None], 400, 0)
        truths = Truths(rows, np.ones(400))
        reached = reached_in_space(table.solved, scenario, np.repeat(pose[None], 400, 0), truths, 0)
        assert each.entries[0].value == pytest.approx(reached.mean(), abs=0.03)
    assert found[0].entries[0].value > 0.8 > 0.1 > found[2].entries[0].value


@pytest.mark.slow
@pytest.mark.usefixtures("few_executions")
def test_entry_says_how_success_falls(tmp_path: Path) -> None:
    file = write(tmp_path, box(), TEXT + BREATH)
    said = json.loads(needleplan("entry", file, "--top", 1, "--json").stdout)
    (entry,) = said["entries"]
    assert [each["residual_mm"] for each in entry["breathing"]] == [0.0, 2.5, 5.0, 7.5]
    assert entry["breathing"][-1]["success"] < entry["breathing"][0]["success"]
    assert "breathing moves the tissue by up to" in needleplan("entry", file, "--top", 1).stdout
    ball = "{ center_mm = [16.0, 20.0, 50.0], radius_mm = 4.0 }"
    targets = "".join(
        f'[[anatomy.targets]]\nname = "{name}"\nregion = {region}\n'
        for name, region in (("lesion", '"target"'), ("core", ball))
    )
    text = TEXT.replace('target = "target"\n', "").replace("[needle]", f"{targets}[needle]")
    said = json.loads(needleplan("entry", write(tmp_path, box(), text + BREATH), "--top", 2, "--json").stdout)
    first, second = said["entries"]
    assert all("breathing" not in each for each in second["targets"].values())
    for each in first["targets"].values():
        at_rest, *_, moved = each["breathing"]
        assert at_rest["success"] == pytest.approx(each["success"], abs=0.05)
        assert moved["success"] < at_rest["success"]


def test_a_sweep_over_levels_finds_the_field(tmp_path: Path) -> None:
    field(tmp_path, (0.0, -1.0, 0.0))
    write(tmp_path, box(), TEXT + '\n[breathing]\nfull_mm = 8.0\nfield = "field.nrrd"\n')
    text = 'schema = "needleplan.sweep/1"\nanatomy = "anatomy.toml"\n[[parameter]]\nkey = "breathing.level"\n'
    (tmp_path / "sweep.toml").write_text(text + "values = [0.0, 0.5, 1.0]\n")
    (problem,) = Sweep.read(tmp_path / "sweep.toml").problems().by_file.values()
    half = problem.changed({**problem.raw, "breathing": {**problem.raw["breathing"], "level": 0.5}})
    assert isinstance(half, AnatomyFile)
    assert half.breathing is not None
    assert half.breathing.field == (str(tmp_path / "field.nrrd"),)
    assert problem.identity(half) != problem.identity(problem.changed(problem.raw))


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ("full_mm = 8.0", "breathing.still: is missing"),
        ('full_mm = 8.0\nfade_mm = 8.0\nstill = ["vessel"]', "breathing.fade_mm = 8: must be above full_mm"),
        ('full_mm = 8.0\nstill = ["vesel"]', 'did you mean "vessel"'),
        ('full_mm = 8.0\nstill = ["vessel"]\nlevel = 2.0', "breathing.level = 2"),
        ('full_mm = 8.0\nstill = ["vesel"]', "anatomy.toml: breathing.still"),
        ('full_mm = 8.0\nfield = "none.nrrd"', "none.nrrd"),
        ('full_mm = 8.0\nfield = "box.nii.gz"', "dim = 20 x 20 x 30: must be voxels"),
        ('full_mm = 8.0\nfield = "field.nrrd"', "= 0: must be the largest displacements"),
    ],
)
def test_what_is_wrong_is_refused(tmp_path: Path, lines: str, says: str) -> None:
    field(tmp_path, (0.0, 0.0, 0.0))
    with pytest.raises(ScenarioError, match=says):
        moving(tmp_path, f"\n[breathing]\n{lines}\n")


def test_a_level_that_moves_a_region_out_of_the_volume_is_refused(tmp_path: Path) -> None:
    field(tmp_path, (0.0, -1.0, 0.0))
    away = r"anatomy.toml: breathing.level = 1: moves a region away: anatomy.target \(no voxel is left in the volume\)"
    with pytest.raises(ScenarioError, match=away):
        moving(tmp_path, '\n[breathing]\nfull_mm = 60.0\nlevel = 1.0\nfield = "field.nrrd"\n')


def test_vectors_have_three_components(tmp_path: Path) -> None:
    field(tmp_path, (1.0, 0.0))
    with pytest.raises(ScenarioError, match="must begin with 3"):
        moving(tmp_path, '\n[breathing]\nfull_mm = 8.0\nfield = "field.nrrd"\n')
