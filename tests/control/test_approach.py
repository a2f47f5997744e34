"""The last steps, against the same questions asked at a thousand points of the arcs."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.control._scene import Approach, ScenarioGeometry
from needleplan.models import arc_step
from needleplan.planning import Pose
from tests.control.scenes import small_table

SCENARIO = small_table().scenario
CENTRE, RADIUS, STEP = SCENARIO.target.center_mm, SCENARIO.target.radius_mm, SCENARIO.step_mm
APPROACH = Approach(ScenarioGeometry(SCENARIO), 1 / 40)

poses = st.builds(
    lambda away, where, heading, bevel: Pose(
        CENTRE[0] + away * math.cos(where), CENTRE[1] + away * math.sin(where), heading, bevel
    ),
    st.floats(0, 9), st.floats(-3.1, 3.1), st.floats(-3.1, 3.1), st.sampled_from([-1, 1]),
)  # fmt: skip


def distances(pose: Pose, bevel: int) -> list[float]:
    x, y, _ = arc_step(pose.x_mm, pose.y_mm, pose.heading_rad, bevel / 40, np.linspace(0, STEP, 1000))
    return list(np.hypot(x - CENTRE[0], y - CENTRE[1]).tolist())


@settings(deadline=None)
@given(poses)
def test_the_closest_point_of_the_next_step(pose: Pose) -> None:
    off = distances(pose, pose.bevel)
    found, distance = APPROACH.closest(pose)
    assert distance == pytest.approx(min(off), abs=0.03)
    assert 0 <= found <= STEP
    assert APPROACH.inside(pose) == (off[0] <= RADIUS)
    if APPROACH.done(pose):
        assert off[0] <= RADIUS
        assert off[0] - min(off) <= 0.11


@settings(deadline=None)
@given(poses, st.floats(0, 2 * STEP))
def test_a_step_ends_in_the_target_where_it_can(pose: Pose, room: float) -> None:
    length, last = APPROACH.length_mm(pose, room)
    assert 0 <= length <= min(STEP, room) + 1e-12
    if length < min(STEP, room):
        assert last
        x, y, _ = arc_step(pose.x_mm, pose.y_mm, pose.heading_rad, pose.bevel / 40, length)
        assert math.dist((x, y), CENTRE) <= RADIUS + 1e-9


@settings(deadline=None)
@given(poses)
def test_beside_the_target_it_goes_as_near_as_it_can(pose: Pose) -> None:
    start = math.dist(pose[:2], CENTRE)
    best = min(min(distances(pose, bevel)) for bevel in (-1, 1))
    found = APPROACH.beside(pose)
    if found is None:
        assert start > RADIUS + 2 * STEP - 1e-9 or start - best < 0.14
        return
    turned, length = found
    x, y, _ = arc_step(turned.x_mm, turned.y_mm, turned.heading_rad, turned.bevel / 40, length)
    assert math.dist((x, y), CENTRE) == pytest.approx(best, abs=0.03)
    assert turned[:3] == pose[:3]


def test_it_does_not_go_through_an_obstacle_to_be_nearer() -> None:
    scene = ScenarioGeometry(SCENARIO)
    assert scene.touches(25.0, 20.0) == "vessel"
    assert scene.blocked(20.0, 20.0, 0.0, 0.0, 5.0)
    assert not scene.blocked(20.0, 20.0, math.pi, 0.0, 5.0)
    assert scene.blocked(58.0, 20.0, 0.0, 0.0, 5.0)  # out of the workspace
