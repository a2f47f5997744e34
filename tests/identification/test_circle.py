import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.errors import DataError
from needleplan.identification import CircleMethod, fit_circle
from needleplan.identification._circle import arc_distance
from tests.identification.arcs import LENGTH_MM, POINTS, RADIUS_MM, SIGMA_MM, arc, kasa, white

METHODS = list(CircleMethod)


@pytest.mark.parametrize("method", METHODS)
@settings(max_examples=60, deadline=None)
@given(
    st.floats(-0.05, 0.05), st.floats(-3.1, 3.1), st.tuples(st.floats(-300, 300), st.floats(-300, 300)),
    st.integers(3, 60),
)  # fmt: skip
def test_exact_points_give_their_circle(
    method: CircleMethod, bend: float, turn: float, shift: tuple[float, float], points: int
) -> None:
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    placed = arc(bend, points) @ rotation.T + shift
    found = fit_circle(placed, method)
    assert found.curvature_per_mm == pytest.approx(bend, abs=1e-8)
    assert found.rms_mm < 1e-5
    np.testing.assert_allclose(found.distances(placed), 0, atol=1e-5)


def test_distances_are_those_from_the_centre() -> None:
    random = np.random.default_rng(0)
    points = random.uniform(-50, 50, (100, 2))
    for bend, heading in ((0.02, 0.3), (-0.01, 2.0)):
        centre = np.array([3 - np.sin(heading) / bend, 4 + np.cos(heading) / bend])
        away = np.hypot(*(points - centre).T)
        expected = np.sign(bend) * (1 / abs(bend) - away)
        np.testing.assert_allclose(arc_distance(points, 3, 4, heading, bend), expected, atol=1e-9)
    np.testing.assert_allclose(arc_distance(points, 3, 4, 0.0, 0.0), points[:, 1] - 4, atol=1e-12)


def test_three_points_on_a_line_have_no_curvature() -> None:
    found = fit_circle(np.array([[0, 0], [1, 1], [3, 3.0]]))
    assert found.curvature_per_mm == pytest.approx(0, abs=1e-9)
    assert found.heading_rad == pytest.approx(np.pi / 4)


def test_only_the_plain_fit_is_biased() -> None:
    random = np.random.default_rng(1)
    trials = [arc() + white(random) for _ in range(200)]
    bends = {method: np.array([fit_circle(each, method).curvature_per_mm for each in trials]) for method in METHODS}
    formula = 1 / (1 + 720 * SIGMA_MM**2 * RADIUS_MM**2 / LENGTH_MM**4)
    assert np.mean([kasa(each) for each in trials]) / RADIUS_MM == pytest.approx(formula, abs=0.02)
    assert formula < 0.81
    bound = SIGMA_MM * np.sqrt(720 / POINTS) / LENGTH_MM**2
    for found in bends.values():
        assert found.mean() * RADIUS_MM == pytest.approx(1, abs=0.01)
        assert found.std() == pytest.approx(bound, rel=0.1)
    np.testing.assert_allclose(bends[CircleMethod.PRATT], bends[CircleMethod.TAUBIN], rtol=1e-3)


@pytest.mark.parametrize(
    ("points", "rule"),
    [
        (np.zeros((2, 2)), "n at least 3"),
        (np.zeros((5, 3)), "n at least 3"),
        (np.ones((5, 2)), "all in one place"),
        (np.array([[0, 0], [1, np.nan], [2, 0.0]]), "1 points: must be finite"),
    ],
)
def test_points_that_have_no_circle_are_refused(points: np.ndarray, rule: str) -> None:
    with pytest.raises(DataError, match=rule):
        fit_circle(points)
