"""The frame of the lattice, resampling beside SimpleITK, and anatomies that contradict themselves."""

import math
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import SimpleITK

from needleplan.anatomy import (
    TARGET,
    Anatomy,
    LabelVolume,
    SpaceFrame,
    SpaceScenario,
    _frame,
    frame_of,
    grid_of,
    nearest_labels,
    read_volume,
)
from needleplan.errors import ScenarioError
from tests.anatomy.volumes import NAMES, TEXT, anatomy, box, rotation, write

# Two radii for one label, which the second names in another way.
_TWICE = (
    '[[anatomy.curvature]]\nlabel = "vessel"\nradius_mm = 50.0\n[[anatomy.curvature]]\nlabel = {}\nradius_mm = 80.0\n'
    "[needle]"
)

SIZES = np.array([1.0, 1.5, 3.0])


def blobs(shape: tuple[int, ...]) -> np.ndarray:
    """Return labels 0 to 3 in smooth blobs."""
    waves = sum(np.sin((2 + axis) * np.linspace(0, 3, n)) for axis, n in enumerate(shape[:1]))
    i, j, k = np.meshgrid(*[np.linspace(0, 3, n) for n in shape], indexing="ij")
    return (np.sin(2 * i + j) + np.cos(3 * k - i) + 2 + 0 * waves[:, None, None]).astype(np.uint16)


def itk_image(values: np.ndarray, affine: np.ndarray) -> SimpleITK.Image:
    """Return an image of SimpleITK, which has LPS coordinates, at the same place."""
    image = SimpleITK.GetImageFromArray(np.ascontiguousarray(values.transpose(2, 1, 0)))
    flip, sizes = np.diag([-1.0, -1.0, 1.0]), np.linalg.norm(affine[:3, :3], axis=0)
    image.SetSpacing(sizes.tolist())
    image.SetDirection((flip @ affine[:3, :3] / sizes).ravel().tolist())
    image.SetOrigin((flip @ affine[:3, 3]).tolist())
    return image


def itk_resampled(image: SimpleITK.Image, frame: SpaceFrame, linear: bool, beyond: float) -> np.ndarray:
    """Return an image at the grid points of a frame, resampled by SimpleITK."""
    flip = np.diag([-1.0, -1.0, 1.0])
    how = SimpleITK.sitkLinear if linear else SimpleITK.sitkNearestNeighbor
    found = SimpleITK.Resample(
        image, frame.shape, SimpleITK.Transform(), how, (flip @ frame.origin_mm).tolist(),
        [frame.spacing_mm] * 3, (flip @ frame.axes.T).ravel().tolist(), beyond,
    )  # fmt: skip
    return np.asarray(SimpleITK.GetArrayFromImage(found)).transpose(2, 1, 0)


@pytest.mark.parametrize("name", ["a.nii.gz", "a.nrrd"])
@pytest.mark.parametrize(("turned", "mirrored"), [(False, False), (True, False), (True, True)])
def test_resampling_agrees_with_itk(tmp_path: Path, name: str, turned: bool, mirrored: bool) -> None:
    affine = np.eye(4)
    affine[:3, :3] = (rotation(3) if turned else np.eye(3)) @ np.diag(SIZES)
    affine[:3, 0] *= -1 if mirrored else 1
    affine[:3, 3] = [-12.0, 5.0, 40.0]
    labels = blobs((30, 24, 14))
    SimpleITK.WriteImage(itk_image(labels, affine), str(tmp_path / name))
    volume = read_volume(tmp_path / name)
    middle = volume.world((np.array(labels.shape) - 1) / 2)
    axes = rotation(5)
    frame = SpaceFrame(middle - np.array([12.0, 14.0, 13.0]) @ axes, axes, 1.3, (18, 21, 20))
    found = nearest_labels(volume, volume.labels.astype(np.uint8), frame, 9)
    expected = itk_resampled(SimpleITK.ReadImage(str(tmp_path / name)), frame, False, 9)
    assert (found == expected).mean() > 0.9995  # points halfway between voxels may differ by rounding
    assert 0.01 < (found == 9).mean() < 0.9
    distance = _frame.file_distances(volume, volume.labels == 3, frame).at_points(volume, frame)
    map_ = SimpleITK.SignedMaurerDistanceMap(
        SimpleITK.Cast(SimpleITK.ReadImage(str(tmp_path / name)) == 3, SimpleITK.sitkUInt8),
        squaredDistance=False, useImageSpacing=True, insideIsPositive=False,
    )  # fmt: skip
    other = itk_resampled(map_, frame, True, np.nan)
    outside = np.isfinite(other) & (distance > 4) & (distance < 25)
    assert outside.sum() > 200
    # ITK measures from the surface voxels, scipy from all: they differ by at most a voxel.
    assert abs(distance - other)[outside].max() < SIZES.max()
    assert abs(distance - other)[outside].mean() < 0.8


def test_linear_interpolation_of_distances_is_that_of_itk(monkeypatch: pytest.MonkeyPatch) -> None:
    affine = np.eye(4)
    affine[:3, :3] = rotation(4) @ np.diag(SIZES)
    volume = LabelVolume(blobs((30, 24, 14)), affine)
    axes = rotation(6)
    frame = SpaceFrame(volume.world([14.5, 11.5, 6.5]) - np.array([5.0, 5.0, 5.0]) @ axes, axes, 1.1, (10, 9, 8))
    values = np.random.default_rng(1).random(volume.labels.shape)
    monkeypatch.setattr("scipy.ndimage.distance_transform_edt", lambda part, **_: transform(part, values))
    found = _frame.file_distances(volume, np.ones(values.shape, bool), frame).at_points(volume, frame)
    expected = itk_resampled(itk_image(SIZES.min() / 2 - values, affine), frame, True, np.nan)
    np.testing.assert_allclose(found, expected, atol=2e-5)


def transform(part: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return these values in place of distances; the volume is not cropped, and may be padded."""
    return np.pad(values, (np.array(part.shape) - values.shape)[0] // 2)


def test_distances_of_a_ball_are_right() -> None:
    center, radius = np.array([30.0, 28.0, 26.0]), 10.0
    affine = np.diag([1.0, 1.5, 2.0, 1.0])
    volume = LabelVolume(np.zeros((60, 40, 30), np.uint16), affine)
    points = volume.world(np.stack(np.meshgrid(*[np.arange(n) for n in (60, 40, 30)], indexing="ij"), -1))
    ball = np.linalg.norm(points - center, axis=-1) <= radius
    frame = SpaceFrame(np.array([5.0, 5.0, 5.0]), np.eye(3), 2.5, (20, 18, 18))
    truth = [np.linalg.norm(frame.slice_points(number) - center, axis=-1) - radius for number in range(20)]
    error = _frame.file_distances(volume, ball, frame).at_points(volume, frame) - np.array(truth)
    assert abs(error).max() < 1.5
    assert abs(error.mean()) < 0.5


def test_the_frame_leads_from_entry_to_target() -> None:
    case = anatomy(box())
    frame = frame_of(case)
    np.testing.assert_allclose(frame.axes @ frame.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame.axes) == pytest.approx(1)
    along = case.points("target").mean(0) - case.points("entry").mean(0)
    np.testing.assert_allclose(frame.axes[0], along / np.linalg.norm(along), atol=1e-12)
    for region in ("entry", "target"):
        local = frame.local(case.points(region))
        assert (local >= -1e-9).all()
        assert (local <= (np.array(frame.shape) - 1) * frame.spacing_mm + 1e-9).all()
    np.testing.assert_allclose(frame.local(frame.world([[3.0, 4.0, 5.0]])), [[3.0, 4.0, 5.0]], atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_no_path_within_cone_and_curvature_leaves_the_lattice(seed: int) -> None:
    case = anatomy(box(), TEXT.replace("radius_mm = 60.0", "radius_mm = 25.0"))
    frame = frame_of(case)
    random = np.random.default_rng(seed)
    entry, target = frame.local(case.points("entry")), frame.local(case.points("target"))
    cone, radius = math.radians(case.file.lattice.cone_deg), 25.0
    reached = 0
    for _ in range(150):
        tangent = np.array([1.0, *(math.tan(cone) * 0.7 * (2 * random.random(2) - 1))])
        tangent, at = tangent / np.linalg.norm(tangent), random.permutation(entry)[0].copy()
        trail = [at.copy()]
        turn = random.normal(size=3)
        while at[0] < target[:, 0].max():
            if random.random() < 0.1:
                turn = random.normal(size=3)
            turn -= (turn @ tangent) * tangent
            new = tangent + 0.5 / radius * turn / np.linalg.norm(turn)
            new /= np.linalg.norm(new)
            tangent = new if math.acos(new[0]) <= cone else tangent
            at += 0.5 * tangent
            trail.append(at.copy())
        if np.linalg.norm(target - at, axis=-1).min() > 3:
            continue
        reached += 1
        assert (np.array(trail)[:, 1:] >= -0.5 * frame.spacing_mm).all()
        assert (np.array(trail)[:, 1:] <= (np.array(frame.shape[1:]) - 0.5) * frame.spacing_mm).all()
    assert reached > 5


@pytest.mark.parametrize(("memory", "is_refused"), [(2**30, False), (2**20, True)])
def test_a_lattice_is_refused_if_the_slices_of_a_step_exceed_half_of_the_memory(
    monkeypatch: pytest.MonkeyPatch, memory: int, is_refused: bool
) -> None:
    monkeypatch.setattr(_frame, "largest_bytes", lambda: memory // 4)
    fine = anatomy(box(), TEXT.replace("spacing_mm = 4.0", "spacing_mm = 1.0"))
    refused = pytest.raises(ScenarioError, match="more than half of the memory: take a larger spacing")
    with refused if is_refused else nullcontext():
        frame_of(fine)


def test_a_margin_closes_what_is_near_obstacles() -> None:
    plain, wide = (
        grid_of(anatomy(box())),
        grid_of(anatomy(box(), TEXT.replace("[needle]", "margin_mm = 3.0\n[needle]"))),
    )
    assert (wide.codes == 2).sum() > (plain.codes == 2).sum() > 0
    assert (wide.clearance_mm[wide.codes == 0] > 3.0).all()
    np.testing.assert_array_equal(wide.clearance_mm, plain.clearance_mm)


def test_balls_are_regions() -> None:
    text = TEXT.replace('"target"', "{ center_mm = [19.0, 19.0, 50.0], radius_mm = 5.0 }")
    grid = grid_of(anatomy(box(), text))
    there = grid.frame.spacing_mm * np.argwhere(grid.codes == 1)
    assert len(there) > 3
    assert np.linalg.norm(grid.frame.world(there) - [19.0, 19.0, 50.0], axis=-1).max() < 5 + 2.0


def only_once(text: str) -> str:
    """Return a text in which `directions_deg` stands once: a second line is left out."""
    return text.replace("directions_deg = 8.0\n", "") if text.count("directions_deg") > 1 else text


def painted(label: str, low: int, high: int) -> np.ndarray:
    labels = box()
    labels[:, :, low:high] = NAMES[label]
    return labels


@pytest.mark.parametrize(
    ("old", "new", "labels", "message"),
    [
        ('target = "target"', 'target = "targt"', box(), 'anatomy.target = "targt": is not the name of a label'),
        ('target = "target"', 'target = "targt"', box(), 'did you mean "target"?'),
        ('["vessel"]', '["bones"]', box(), 'anatomy.obstacles = "bones"'),
        ('["vessel"]', "[17]", box(), "anatomy.obstacles = 17: no voxel of the volume has this label"),
        ("", "", np.where(box() == 3, 1, box()), "anatomy.target = target: no voxel of the volume has this label"),
        (
            '["vessel"]',
            '["vessel", "target"]',
            box(),
            "anatomy.target = target: all of its voxels belong to anatomy.obst",
        ),
        ('["air"]', '["air", "entry"]', box(), "anatomy.entry = entry: all of its voxels belong to anatomy.outside"),
        ('["air"]', '["air", "vessel"]', box(), "is in obstacles too"),
        ("", "", painted("air", 10, 14), "lies in another body than anatomy.target"),
        (
            '"target"',
            "{ center_mm = [900.0, 0.0, 0.0], radius_mm = 3.0 }",
            box(),
            "no voxel has its centre in this ball",
        ),
        ('"target"', "{ center_mm = [22.0, 11.0, 27.0], radius_mm = 2.0 }", box(), "belong to anatomy.obstacles"),
        ('entry = "entry"', 'entry = "target"', box(), "must be at least two lattice.spacing_mm"),
        ("[needle]", "margin_mm = 60.0\n[needle]", box(), "no voxel of the lattice lies in it"),
        ("spacing_mm = 4.0", "directions_deg = 1.0\nspacing_mm = 0.1", box(), "take a larger spacing"),
        ("cone_deg = 24.0", "cone_deg = 5.0", box(), "lattice.directions_deg = 8: must be at most cone_deg = 5"),
        (
            "[needle]",
            _TWICE.format('"vessel"'),
            box(),
            "anatomy.toml: anatomy.curvature 2.label = vessel: is the label of [[anatomy.curvature]] 1 too",
        ),
        ("[needle]", _TWICE.format(4), box(), "curvature 2.label = 4: is the label of [[anatomy.curvature]] 1 too"),
        ('outside = ["air"]', "outside = [4]", box(), "anatomy.outside = 4: is in anatomy.obstacles too"),
        ("spacing_mm = 4.0", "spacing_mm = 3.0", box(), "must be a multiple of spacing_mm = 3"),
        ("rolls = 4", "rols = 4", box(), 'did you mean "rolls"?'),
        ("cone_deg = 24.0", "cone_deg = 90.0", box(), "lattice.cone_deg = 90"),
        ("radius_mm = 60.0", "radius_mm = 0.5", box(), "needle.curvature_radius_mm = 0.5"),
        ("radius_mm = 60.0", "radius_mm = 3.9", box(), "the arc is smaller than a voxel"),
        ('file = "box.nii.gz"', 'file = "bax.nii.gz"', box(), "No such file"),
        ('"labels.ctbl"', '"labels.txt"', box(), "No such file"),
        ('"needleplan.anatomy/1"', '"needleplan.scenario/1"', box(), "schema"),
    ],
)
def test_anatomies_that_contradict_themselves(
    tmp_path: Path, old: str, new: str, labels: np.ndarray, message: str
) -> None:
    file = write(tmp_path, labels, only_once(TEXT.replace(old, new)))
    with pytest.raises(ScenarioError) as caught:
        grid_of(Anatomy.read(file))
    assert message in str(caught.value)
    assert str(tmp_path) in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1 or "margin" in new  # a margin closes entry and target


def test_the_radius_of_a_target_is_that_of_equal_volume() -> None:
    labels = box()
    labels[labels == NAMES["target"]] = NAMES["body"]
    text = TEXT.replace('"target"', "{ center_mm = [19.0, 19.0, 46.0], radius_mm = 8.0 }")
    text = text.replace("spacing_mm = 4.0", "spacing_mm = 1.0").replace("step_mm = 8.0", "step_mm = 4.0")
    scenario = SpaceScenario.of(anatomy(labels, text))
    assert scenario.target_radius_mm == pytest.approx(8.0, abs=0.2)
    cells = np.argwhere(scenario.grid.codes == TARGET) * scenario.grid.frame.spacing_mm
    assert scenario.target_reach_mm > scenario.target_radius_mm
    assert np.linalg.norm(cells - scenario.target_mm, axis=1).max() < scenario.target_reach_mm
