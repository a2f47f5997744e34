"""The displaced target against the equations of elasticity, quadrature and limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from needleplan.errors import ModelError
from needleplan.models.tissue import NeedlePush

G, RADIUS, FORCE = 0.02, 0.6, 0.4
PUSH = NeedlePush(G, RADIUS)


def axial(x: float, y: float, z: float) -> float:
    return PUSH.shift_mm(FORCE, 0.0, 0.0, ahead_mm=z, aside_mm=math.hypot(x, y))


def kelvin(force: float, z: float, rho: float) -> float:
    """Axial displacement by a point force in a medium with Poisson's ratio 1/2, as in textbooks."""
    r, poisson = math.hypot(z, rho), 0.5
    return force / (16 * math.pi * G * (1 - poisson) * r) * (3 - 4 * poisson + (z / r) ** 2)


def test_the_sphere_moves_as_a_rigid_body_and_stokes_force_moves_it() -> None:
    for angle in np.linspace(0, math.pi, 9):
        at = PUSH.shift_mm(
            FORCE, 0, 0, ahead_mm=1.000001 * RADIUS * math.cos(angle), aside_mm=1.000001 * RADIUS * math.sin(angle)
        )
        assert at == pytest.approx(FORCE / (6 * math.pi * G * RADIUS), rel=1e-5)
    assert axial(0, 0, 0.1) == pytest.approx(PUSH.at_tip_mm(FORCE))


def test_the_field_is_in_equilibrium() -> None:
    # Without body forces every component is biharmonic. A uniform factor would pass, so the test above fixes it.
    h, at = 0.03, (1.3, 0.9, 1.7)
    steps = [np.array(each) for each in ((h, 0, 0), (0, h, 0), (0, 0, h))]

    def laplacian(function: object, place: np.ndarray) -> float:
        assert callable(function)
        return float(sum(function(place + s) + function(place - s) - 2 * function(place) for s in steps) / h**2)

    def field(place: np.ndarray) -> float:
        return axial(*place)

    inner = laplacian(field, np.array(at))
    outer = laplacian(lambda place: laplacian(field, place), np.array(at))
    scale = abs(inner) / np.dot(at, at)
    assert abs(outer) < 0.05 * scale


@pytest.mark.parametrize(("z", "rho"), [(30.0, 0.0), (-20.0, 25.0), (0.0, 40.0)])
def test_far_away_it_is_kelvins_point_force(z: float, rho: float) -> None:
    found = PUSH.shift_mm(FORCE, 0, 0, ahead_mm=z, aside_mm=rho)
    assert found == pytest.approx(kelvin(FORCE, z, rho), rel=2 * RADIUS**2 / (z * z + rho * rho))


@pytest.mark.parametrize(("z", "rho"), [(5.0, 3.0), (0.0, 1.0), (-30.0, 8.0)])
def test_friction_is_a_line_of_point_forces(z: float, rho: float) -> None:
    length, friction = 60.0, 0.8
    expected = quad(lambda s: kelvin(friction / length, z + s, rho), 0, length, points=[-z] if z < 0 else None)[0]
    both = PUSH.shift_mm(FORCE, friction, length, ahead_mm=z, aside_mm=rho)
    alone = PUSH.shift_mm(FORCE, 0.0, length, ahead_mm=z, aside_mm=rho)
    assert both - alone == pytest.approx(expected, rel=1e-8)


def test_directions() -> None:
    assert axial(0, 0, 5.0) == pytest.approx(axial(0, 0, -5.0))
    assert 0 < axial(5.0, 0, 0) < axial(0, 0, 5.0)
    assert PUSH.shift_mm(-FORCE, 0, 0, ahead_mm=3, aside_mm=0) < 0


@pytest.mark.parametrize("values", [(0.0, 1.0), (1.0, 0.0), (math.nan, 1.0), (1.0, math.inf)])
def test_wrong_numbers_are_refused(values: tuple[float, float]) -> None:
    with pytest.raises(ModelError, match="above 0"):
        NeedlePush(*values)
