"""Poses as a table with named columns: columns count by name, in any order."""

import numpy as np
import pandas as pd
import pytest

import needleplan as npl
from needleplan.errors import PoseError
from needleplan.planning._poses import number_rows
from needleplan.planning._space_pose import SpacePose

POSES = pd.DataFrame({"x_mm": [2.0, 6.0], "y_mm": [3.0, 4.0], "heading_rad": [0.1, -0.2], "bevel": [1, -1]})


def test_the_order_of_columns_does_not_count(table: npl.PolicyTable) -> None:
    expected = table.lookup_many(POSES.to_numpy())
    for frame in (POSES[["bevel", "y_mm", "x_mm", "heading_rad"]], POSES.assign(trial="a")):
        found = table.lookup_many(frame)
        np.testing.assert_array_equal(found.value, expected.value)
        np.testing.assert_array_equal(found.action, expected.action)


def test_columns_with_other_names_are_refused(table: npl.PolicyTable) -> None:
    with pytest.raises(PoseError, match="columns x, y, heading_rad, bevel: must have the columns x_mm, y_mm") as raised:
        table.lookup_many(POSES.rename(columns={"x_mm": "x", "y_mm": "y"}))
    assert "x_mm, y_mm: missing" in str(raised.value)


def test_poses_in_3d_have_names_too() -> None:
    rows = np.arange(12.0).reshape(2, 6)
    frame = pd.DataFrame(rows, columns=list(SpacePose._fields))
    np.testing.assert_array_equal(number_rows(frame[frame.columns[::-1]], SpacePose._fields), rows)
    with pytest.raises(PoseError, match="dz: missing"):
        number_rows(frame.drop(columns="dz"), SpacePose._fields)


def test_complex_numbers_are_refused(table: npl.PolicyTable) -> None:
    with pytest.raises(PoseError, match="must be an array of numbers: complex numbers"):
        table.lookup_many(POSES.to_numpy() + 0j)


def test_a_pose_in_3d_is_none_of_a_table_in_the_plane(table: npl.PolicyTable) -> None:
    pose = SpacePose(1.0, 2.0, 3.0, 1.0, 0.0, 0.0)
    for start in (pose, npl.planning.Entry(pose, 0.9, 10.0)):  # type: ignore[arg-type]
        with pytest.raises(PoseError, match="a pose is x_mm, y_mm, heading_rad and bevel"):
            table.path(start)  # type: ignore[arg-type]


def test_axes_of_a_plot_are_axes(table: npl.PolicyTable) -> None:
    with pytest.raises(npl.InputError, match="ax = <int>: must be the axes of a matplotlib figure"):
        table.plot(3)  # type: ignore[arg-type]
