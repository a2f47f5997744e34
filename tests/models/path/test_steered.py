from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.models import Bicycle, SpatialBicycle, TipFrame, simulate
from needleplan.models.effects import effect_named
from needleplan.models.path import axes_of, quaternion_of, quaternions_along
from needleplan.signals import Array, Motion, lspb


def turned(start_rad: float, angles_rad: Array) -> Motion:
    motion = lspb([0, 30, 60], [6, 9], dwells_s=[2, 0], rate_hz=40)
    return replace(motion, angle_rad=start_rad + np.interp(motion.time_s, np.arange(len(angles_rad)) * 3.0, angles_rad))


@settings(max_examples=15, deadline=None)
@given(st.floats(-0.02, 0.02), st.floats(-3, 3), st.lists(st.floats(-4, 4), min_size=1, max_size=5))
def test_it_goes_arc_after_arc_as_the_frame_does(slope: float, start: float, angles: list[float]) -> None:
    model = SpatialBicycle(1 / 80, heading_y_rad=slope, entry_z_mm=1.0)
    motion = turned(start, np.array(angles))
    states = simulate(model, motion).states
    first = states[:, 0]
    frame = TipFrame(*(tuple(first[3 * k : 3 * k + 3]) for k in range(3)), tuple(np.cross(first[3:6], first[6:9])))  # type: ignore[arg-type]
    places = [frame.position_mm]
    middle = (motion.angle_rad[1:] + motion.angle_rad[:-1]) / 2
    for angle, step in zip(middle.tolist(), np.diff(motion.depth_mm).tolist(), strict=True):
        frame = frame.arc(np.cos(angle) / 80, np.sin(angle) / 80, step)
        places.append(frame.position_mm)
    np.testing.assert_allclose(states[:3].T, places, atol=1e-9)
    np.testing.assert_allclose(states[3:6, -1], frame.tangent, atol=1e-12)


def test_in_the_plane_it_is_the_bicycle() -> None:
    motion = turned(0.0, np.zeros(1))
    motion = replace(motion, angle_rad=np.where((motion.depth_mm < 29.9) | (motion.time_s < 6), 0.0, np.pi))
    place = simulate(SpatialBicycle(1 / 150), motion).output
    np.testing.assert_allclose(place[1], simulate(Bicycle(1 / 150), motion).output, atol=1e-9)
    np.testing.assert_allclose(place[2], 0, atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-3, 3)] * 3), min_size=1, max_size=20))
def test_quaternions_joined_in_passes_are_those_one_after_another(turns: list[tuple[float, ...]]) -> None:
    start = np.array([1.0, 0, 0, 0])
    whole = quaternions_along(np.array(turns).T, start)
    slow = start
    for turn in turns:
        slow = quaternions_along(np.array(turn)[:, None], slow)[:, 1]
    np.testing.assert_allclose(whole[:, -1], slow, atol=1e-12)
    tangent, normal, _ = axes_of(slow)
    again = quaternion_of(tangent, normal)
    np.testing.assert_allclose(again * np.sign(again @ slow), slow, atol=1e-7)


def test_a_tip_behind_the_base_leaves_the_plane() -> None:
    motion = turned(0.0, np.array([0.0, 0.0, 0.0, np.pi]))
    motion = replace(motion, angle_rad=np.clip(motion.time_s - 5.5, 0, 1) * np.pi)
    plain = SpatialBicycle(1 / 150)
    behind = effect_named("torsional_lag").apply(plain, {"size": 0.4 / 30})
    run = simulate(behind, motion)
    assert run.states[9, -1] == pytest.approx(np.pi - 0.4 * 60 / 30, abs=0.45)
    assert run.output[2, -1] > 1.0
    assert abs(simulate(plain, motion).output[2, -1]) < 0.2
