"""The displaced target against the equations of elasticity, quadrature and limits."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from needleplan.errors import ModelError
from needleplan.models.tissue import NeedlePush, TargetPush
from tests.models.tissue.finite_elements import pushed

G, RADIUS, FORCE = 0.02, 0.6, 0.4
PUSH = NeedlePush(G, RADIUS, free_surface=False)


def test_a_tip_that_goes_on_reaches_the_displaced_target() -> None:
    for tip_n, shaft_n, length in ((FORCE, 0.0, math.inf), (FORCE, 0.4, 60.0)):
        beyond = PUSH.beyond_mm(tip_n, shaft_n, length)
        inserted = length if math.isfinite(length) else 0.0
        assert PUSH.shift_mm(tip_n, shaft_n, inserted, ahead_mm=-beyond, aside_mm=0.0) == pytest.approx(beyond)
        assert 0 < beyond < PUSH.shift_mm(tip_n, shaft_n, inserted, ahead_mm=0.0, aside_mm=0.0)
        push = TargetPush(PUSH, tip_n, shaft_n, length)
        beside = push.beyond_mm(np.array((20.0, 3.0)), np.array((1.0, 0.0)))
        assert 0 < beside < beyond
        shift = PUSH.shift_mm(tip_n, shaft_n, inserted, ahead_mm=-beside, aside_mm=3.0)
        assert beside == pytest.approx(shift, abs=1e-5)
    assert PUSH.beyond_mm(0.0) == 0.0


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


def mindlin(force: float, poisson: float, source: float, depth: float, rho: float) -> float:
    """Axial displacement in a half-space by an axial force at the depth `source` (Mindlin 1936, his equation 1)."""
    near, far = math.hypot(rho, depth - source), math.hypot(rho, depth + source)
    four = 3 - 4 * poisson
    terms = (
        four / near, (8 * (1 - poisson) ** 2 - four) / far, (depth - source) ** 2 / near**3,
        (four * (depth + source) ** 2 - 2 * source * depth) / far**3,
        6 * source * depth * (depth + source) ** 2 / far**5,
    )  # fmt: skip
    return force / (16 * math.pi * G * (1 - poisson)) * sum(terms)


@pytest.mark.parametrize("poisson", [0.3, 0.5])
@pytest.mark.parametrize(("source", "ahead", "rho"), [(20.0, 15.0, 0.0), (20.0, -18.0, 10.0), (60.0, -5.0, 30.0)])
def test_near_the_surface_it_is_mindlins_force_and_its_line(
    poisson: float, source: float, ahead: float, rho: float
) -> None:
    push, beside = NeedlePush(G, RADIUS, poisson), max(rho, RADIUS)
    tip = push.shift_mm(FORCE, 0.0, source, ahead_mm=ahead, aside_mm=rho)
    expected = mindlin(FORCE, poisson, source, source + ahead, rho)
    assert tip == pytest.approx(expected, rel=2 * RADIUS**2 / (ahead**2 + rho**2))
    both = push.shift_mm(FORCE, 0.8, source, ahead_mm=ahead, aside_mm=rho)
    depth = source + ahead
    line = quad(lambda s: mindlin(0.8 / source, poisson, s, depth, beside), 0, source, points=[min(depth, source)])[0]
    assert both - tip == pytest.approx(line, rel=1e-4)


def test_far_below_the_surface_it_is_the_infinite_medium() -> None:
    deep = NeedlePush(G, RADIUS).shift_mm(FORCE, 0.0, 1e5, ahead_mm=8.0, aside_mm=3.0)
    assert deep == pytest.approx(PUSH.shift_mm(FORCE, 0.0, 1e5, ahead_mm=8.0, aside_mm=3.0), rel=1e-3)


@pytest.mark.parametrize("poisson", [0.3, 0.45])
def test_the_half_space_agrees_with_finite_elements(poisson: float) -> None:
    source = 20.0
    push, infinite = (NeedlePush(G, 0.01, poisson, free_surface=surface) for surface in (True, False))
    radii, depths, moved = pushed(G, poisson, source, FORCE)
    compared = 0
    for row in np.flatnonzero(depths < 60):
        for column in np.flatnonzero(radii < 40):
            ahead, aside = float(depths[row] - source), float(radii[column])
            if math.hypot(ahead, aside) > 6:
                found = push.shift_mm(FORCE, 0.0, source, ahead_mm=ahead, aside_mm=aside)
                assert found == pytest.approx(moved[row, column], rel=0.06)
                compared += 1
    assert compared > 200
    # Without its surface the medium is much stiffer there.
    at_surface = infinite.shift_mm(FORCE, 0.0, source, ahead_mm=-source, aside_mm=0.0)
    assert moved[0, 0] > 1.8 * at_surface


def test_directions() -> None:
    assert axial(0, 0, 5.0) == pytest.approx(axial(0, 0, -5.0))
    assert 0 < axial(5.0, 0, 0) < axial(0, 0, 5.0)
    assert PUSH.shift_mm(-FORCE, 0, 0, ahead_mm=3, aside_mm=0) < 0


def test_a_material_that_grows_in_pressure_is_refused() -> None:
    with pytest.raises(ModelError, match=r"poisson = 0.6: must be a finite number at least 0 and at most 0.5"):
        NeedlePush(G, RADIUS, poisson=0.6)


@pytest.mark.parametrize("values", [(0.0, 1.0), (1.0, 0.0), (math.nan, 1.0), (1.0, math.inf)])
def test_wrong_numbers_are_refused(values: tuple[float, float]) -> None:
    with pytest.raises(ModelError, match="above 0"):
        NeedlePush(*values)
