"""Files of poses and points: own columns, maps, decimal commas, and exports of NDI ToolBox and of ROS."""

from pathlib import Path

import numpy as np
import pytest

from needleplan.errors import DataError, InputError
from needleplan.estimation.registration import read_points, read_poses
from needleplan.signals import Array
from tests.estimation.registrations import write_points, write_poses


@pytest.fixture
def poses(tmp_path: Path) -> Array:
    """Positions and quaternions with w first, shape (10, 7)."""
    found = read_poses(write_poses(tmp_path / "own.csv", poses=10))
    return np.column_stack([found.positions_mm, found.quaternions])


def text(header: str, rows: Array, before: str = "", separator: str = ",") -> str:
    body = "\n".join(before + separator.join(f"{cell:.9f}" for cell in row) for row in rows)
    return f"{header}\n{body}\n" if header else f"{body}\n"


def read(folder: Path, content: str, columns: str | None = None) -> Array:
    (folder / "poses.txt").write_text(content)
    found = read_poses(folder / "poses.txt", columns)
    return np.column_stack([found.positions_mm, found.quaternions])


def in_metres(poses: Array) -> Array:
    """Return x, y, z in metres and x, y, z, w of the quaternion."""
    return np.column_stack([poses[:, :3] / 1e3, poses[:, [4, 5, 6, 3]]])


def test_an_export_of_ndi_toolbox(poses: Array, tmp_path: Path) -> None:
    header = "Tools,Port,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error"
    rows = np.column_stack([poses[:, 3:], poses[:, :3], np.zeros(10)])
    content = text(header, rows, "1,0A,17,0,OK,") + "1,0A,27,0,Missing,,,,,,,,\n"
    np.testing.assert_allclose(read(tmp_path, content), poses, atol=1e-8)
    assert read_poses(tmp_path / "poses.txt").missing == 1


@pytest.mark.parametrize(
    ("head", "names"),
    [
        ("%time,field.header.seq,field.header.stamp,", "field.pose.position.{} field.pose.orientation.{}"),
        ("__time,a,b,", "/aurora/pose/pose/position/{} /aurora/pose/pose/orientation/{}"),
        ("time,a,b,", "transform.translation.{} transform.rotation.{}"),
    ],
)
def test_exports_of_ros_are_in_metres(head: str, names: str, poses: Array, tmp_path: Path) -> None:
    place, turn = names.split()
    header = head + ",".join([*(place.format(axis) for axis in "xyz"), *(turn.format(axis) for axis in "xyzw")])
    np.testing.assert_allclose(read(tmp_path, text(header, in_metres(poses), "1.5,3,4,")), poses, atol=1e-6)


def test_an_export_of_ros_with_two_poses_is_ambiguous(poses: Array, tmp_path: Path) -> None:
    names = [f"{part}.{axis}" for part, axes in (("position", "xyz"), ("orientation", "xyzw")) for axis in axes]
    header = ",".join(f"{frame}.{name}" for frame in "ab" for name in names)
    with pytest.raises(DataError, match="are several poses: choose one with --columns"):
        read(tmp_path, text(header, np.tile(in_metres(poses), 2)))


def test_columns_by_number_and_decimal_commas(poses: Array, tmp_path: Path) -> None:
    content = "Logger 3000\n" + text("", in_metres(poses), "7;", ";").replace(".", ",")
    found = read(tmp_path, content, "x=2[m],y=3[m],z=4[m],qw=8,qx=5,qy=6,qz=7")
    np.testing.assert_allclose(found, poses, atol=1e-6)


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ("x=2[m],y=3[m],z=4[m]", "column is missing: a rotation needs all four columns"),
        ("qw=1,qx=2,qy=3,qz=4,x=5", "y_mm, z_mm: column is missing: all coordinates are needed"),
        ("x=2[N]", "must be one of mm, m, cm, um, inch"),
        ("depth=2", "must be one of x, y, z, qw"),
        ("time=1", "must be one of x, y, z, qw"),
    ],
)
def test_wrong_maps_are_refused(columns: str, says: str, poses: Array, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says):
        read(tmp_path, text("", poses, separator=" "), columns)


def test_points_of_another_program(tmp_path: Path) -> None:
    own = read_points(write_points(tmp_path / "own.csv"))
    rows = np.column_stack([own.plan_mm, own.tracker_mm / 10])
    body = "\n".join(f"F{k};" + ";".join(f"{cell:.6f}" for cell in row) for k, row in enumerate(rows))
    (tmp_path / "points.txt").write_text(f"label;R;A;S;Tx;Ty;Tz\n{body}\n".replace(".", ","))
    mapped = read_points(
        tmp_path / "points.txt",
        "name=label,plan_x=R[mm],plan_y=A,plan_z=S,tracker_x=Tx[cm],tracker_y=Ty[cm],tracker_z=Tz[cm]",
    )
    np.testing.assert_allclose(mapped.tracker_mm, own.tracker_mm, atol=1e-4)
    np.testing.assert_allclose(mapped.plan_mm, own.plan_mm, atol=1e-4)
    assert mapped.names[:2] == ("F0", "F1")
    assert mapped.quaternions is None
