"""Curvature sensors and images in the message of an insertion: curvatures, shape, positions in the plan."""

import json

import numpy as np
import pytest

import needleplan as npl
from needleplan.models import arc_step
from needleplan.models.deflection import FibreSensors
from needleplan.models.path import ImagePlane
from needleplan.page._recorded import packed_track
from needleplan.page._sensed import Sensed

FIBRE, PLANE = FibreSensors((10.0, 30.0)), ImagePlane(origin_mm=(5.0, 1.0, 0.0))
BEND_PER_MM, HEADING_RAD = 0.01, 0.3


def sensed() -> Sensed:
    """An arc of 60 mm to the left by a needle that is rolled by pi/2, with the sensors' readings in its own axes."""
    time, depth = np.arange(0.0, 6.0, 0.01), np.arange(0.0, 60.0, 0.1)
    x, y, heading = arc_step(0.0, 2.0, HEADING_RAD, BEND_PER_MM, depth)
    nothing, roll = np.zeros_like(depth), np.full_like(depth, np.pi / 2)
    tip = np.stack([time, x, y, nothing, heading, nothing, roll, depth], axis=1)
    readings = np.where(depth[:, None] > FIBRE.from_tip_mm, BEND_PER_MM, 0.0)
    # At a roll of pi/2 a bend to the left is -z of the needle.
    columns = np.stack([np.zeros_like(readings), -readings], axis=2).reshape(len(time), -1)
    images = np.array([[1.0, 2.0, 3.0], [2.0, np.nan, np.nan]])
    return Sensed(tip, FIBRE, np.column_stack([time, columns]), PLANE, images)


def test_the_shape_is_the_path_between_entry_and_first_sensor() -> None:
    header, arrays = sensed().packed(in_space=False)
    assert header == {"sensors_mm": [10.0, 30.0]}
    assert arrays["sensed_per_m"][-1] == pytest.approx([10.0, 10.0])
    assert arrays["sensed_per_m"][0] == pytest.approx([0.0, 0.0])
    last = arrays["shape_mm"][-1]
    points = last[np.isfinite(last[:, 0])]
    x, y, _ = arc_step(0.0, 2.0, HEADING_RAD, BEND_PER_MM, np.arange(len(points)))
    assert len(points) == 50
    assert points == pytest.approx(np.stack([x, y], axis=1), abs=1e-3)
    assert not np.isfinite(arrays["shape_mm"][0]).any()


def test_positions_in_images_are_in_the_frame_of_the_plan() -> None:
    _, arrays = sensed().packed(in_space=True)
    assert arrays["image_mm"][0] == pytest.approx([7.0, 4.0, 0.0])
    assert np.isnan(arrays["image_mm"][1]).all()
    assert arrays["shape_mm"].shape[2] == 3
    assert (arrays["sensed_per_m"] >= 0).all()


def test_a_message_without_sensors_has_none_of_this(small: npl.Scenario) -> None:
    bare = Sensed(np.empty((0, 8)), None, np.empty((0, 1)), None, np.empty((0, 3)))
    assert bare.packed(in_space=False) == ({}, {})
    message = packed_track({"events": []}, small, np.zeros((2, 4)), np.empty((0, 2)), sensed())
    header = json.loads(message[4 : 4 + int.from_bytes(message[:4], "little")])
    assert {"sensed_per_m", "shape_mm", "image_mm"} <= header["arrays"].keys()
