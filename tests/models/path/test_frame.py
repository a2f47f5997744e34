import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from needleplan.models import TipFrame, arc_step
from needleplan.signals import Array

BENDS = st.floats(-0.05, 0.05)


def rows(frame: TipFrame) -> Array:
    return np.array([frame.position_mm, frame.tangent, frame.normal, frame.binormal])


@given(bend=BENDS, heading=st.floats(-3.1, 3.1), length=st.floats(-80, 80))
def test_in_the_plane_it_is_the_arc_step(bend: float, heading: float, length: float) -> None:
    end = TipFrame.planar(1.0, -2.0, heading).arc(bend, 0.0, length)
    x, y, turned = arc_step(1.0, -2.0, heading, bend, length)
    assert np.allclose(rows(end), rows(TipFrame.planar(float(x), float(y), float(turned))), atol=1e-11)


@given(n=BENDS, b=BENDS, length=st.floats(0.1, 80))
def test_in_space_it_is_the_equation(n: float, b: float, length: float) -> None:
    def equation(_: float, state: Array) -> Array:
        _, t, normal, binormal = state.reshape(4, 3)
        return np.concatenate([t, n * normal + b * binormal, -n * t, -b * t])

    start = TipFrame.planar(0.0, 0.0, 0.3)
    slow = solve_ivp(equation, (0, length), rows(start).ravel(), rtol=1e-10, atol=1e-11).y[:, -1]
    assert np.allclose(rows(start.arc(n, b, length)).ravel(), slow, atol=1e-7)


@given(n=BENDS, b=BENDS, there=st.floats(0, 60), on=st.floats(-60, 60))
def test_arcs_add_up_and_stay_orthonormal(n: float, b: float, there: float, on: float) -> None:
    start = TipFrame.planar(0.0, 0.0, 0.0)
    end = start.arc(n, b, there).arc(n, b, on)
    assert np.allclose(rows(end), rows(start.arc(n, b, there + on)), atol=1e-9)
    axes = rows(end)[1:]
    assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)


def test_a_quarter_turn_of_the_bevel_bends_out_of_the_plane() -> None:
    end = TipFrame.planar(0.0, 0.0, 0.0).arc(0.0, 1 / 40, 40 * math.pi / 2)
    assert end.position_mm == pytest.approx((40, 0, 40))
    assert end.moved((1.0, 2.0, 3.0)).position_mm == pytest.approx((41, 2, 43))
