"""Transform files are read by ITK, and mean in 3D Slicer what they should."""

from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from needleplan.anatomy import TRANSFORM_ENDINGS, Anatomy, pose_matrix, transform_bytes
from needleplan.errors import InputError
from needleplan.estimation import Registration
from needleplan.planning import rank_entries
from tests.anatomy.test_entries import box, write
from tests.cli.commands import needleplan, refused
from tests.estimation.registrations import write_points, write_poses

pytestmark = pytest.mark.usefixtures("few_executions")

LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


def in_slicer(file: Path) -> NDArray[np.float64]:
    """Return the matrix to RAS that 3D Slicer shows for a file: the inverse of what ITK reads, from LPS to RAS."""
    read = SimpleITK.AffineTransform(SimpleITK.ReadTransform(str(file)))
    matrix = np.eye(4)
    matrix[:3, :3] = np.reshape(read.GetMatrix(), (3, 3))
    # ITK turns about a centre, which is the origin here.
    assert read.GetCenter() == (0.0, 0.0, 0.0)
    matrix[:3, 3] = read.GetTranslation()
    return LPS @ np.linalg.inv(matrix) @ LPS


@pytest.mark.parametrize("ending", TRANSFORM_ENDINGS)
def test_itk_reads_the_motion(ending: str, tmp_path: Path) -> None:
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.8, 2.0]).as_matrix()
    motion[:3, 3] = [12.5, -40.0, 3.0]
    (tmp_path / f"a{ending}").write_bytes(transform_bytes(motion, ending))
    np.testing.assert_allclose(in_slicer(tmp_path / f"a{ending}"), motion, atol=1e-12)


@pytest.mark.parametrize("direction", [(1, 0, 0), (0, -1, 0), (0, 0, 3.0), (0.2, -0.5, 0.7)])
def test_a_needle_points_along_the_direction(direction: tuple[float, ...]) -> None:
    matrix = pose_matrix((1.0, 2.0, 3.0), direction)
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    np.testing.assert_allclose(matrix[:3, 0], np.array(direction) / np.linalg.norm(direction), atol=1e-12)
    assert matrix[:3, 3].tolist() == [1.0, 2.0, 3.0]


def test_what_is_no_rigid_motion_is_refused() -> None:
    with pytest.raises(InputError, match="must be the matrix of a rigid motion"):
        transform_bytes(np.diag([2.0, 1.0, 1.0, 1.0]), ".tfm")


def test_the_best_entry_is_written(tmp_path: Path) -> None:
    file, out = write(tmp_path, box()), tmp_path / "best.h5"
    done = needleplan("entry", file, "--top", 1, "--transform", out)
    assert done.returncode == 0, done.stderr
    entries = rank_entries(Anatomy.read(file))
    best, matrix = entries.entry(entries.best(1)[0]), in_slicer(out)
    np.testing.assert_allclose(matrix[:3, 3], best.position_mm, atol=1e-9)
    np.testing.assert_allclose(matrix[:3, 0], best.direction, atol=1e-9)
    refused(needleplan("entry", file, "--transform", tmp_path / "best.txt"), "--transform", "must end in .tfm or .h5")


def test_a_registration_is_written(tmp_path: Path) -> None:
    poses, points = write_poses(tmp_path / "poses.csv"), write_points(tmp_path / "points.csv")
    toml, out = tmp_path / "needle.toml", tmp_path / "tracker.tfm"
    done = needleplan(
        "register", "--pivot", poses, "--points", points, "--noise-mm", 0.5, "-o", toml, "--transform", out
    )
    assert done.returncode == 0, done.stderr
    found = Registration.read(toml)
    place = in_slicer(out) @ [10.0, -20.0, 30.0, 1.0]
    coil = found.place((10.0, -20.0, 30.0), (1.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(place[:3], coil.position_mm, atol=1e-6)
