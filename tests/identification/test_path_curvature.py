from collections.abc import Callable

import numpy as np
import pytest

from needleplan.errors import DataError
from needleplan.identification import PathForm, TrackerNoise, agreement_of, arc_curvature, combine, path_curvature
from needleplan.identification._correlated_noise import marginalise
from needleplan.models import arc_step
from needleplan.signals import Array
from tests.identification.arcs import LENGTH_MM, POINTS, RADIUS_MM, SIGMA_MM, arc, correlated, white

KAPPA = 1 / RADIUS_MM
STRAIGHT_IN = (0.0, 0.0, 0.0)


@pytest.mark.parametrize("form", list(PathForm))
@pytest.mark.parametrize("noise", list(TrackerNoise))
def test_an_exact_arc(form: PathForm, noise: TrackerNoise) -> None:
    for bend in (KAPPA, -1 / 40, 0.0):
        found = arc_curvature(arc(bend), form=form, entry=STRAIGHT_IN, noise=noise)
        assert found.curvature_per_mm == pytest.approx(bend, abs=1e-9)
        assert found.low_per_mm <= found.curvature_per_mm <= found.high_per_mm


def test_a_chain_of_arcs_is_taken_apart() -> None:
    first = arc(1 / 60, 100, 30.0)
    pose = arc_step(0.0, 0.0, 0.0, 1 / 60, 30.0)
    x, y, _ = arc_step(*pose, 1 / 200, np.linspace(0.4, 50, 124))
    points = np.concatenate([first, np.column_stack([x, y])])
    depth = np.concatenate([np.linspace(0, 30, 100), 30 + np.linspace(0.4, 50, 124)])
    segments, (change,) = path_curvature(points, [30.0], position_mm=depth)
    assert [each.curvature_per_mm for each in segments] == pytest.approx([1 / 60, 1 / 200], rel=1e-6)
    assert [each.samples for each in segments] == [99, 125]
    edges_mm = [edge_mm for each in segments for edge_mm in (each.low_mm, each.high_mm)]
    assert edges_mm == pytest.approx([0.0, 30.0, 30.0, 80.0], abs=0.01)
    assert change.value_per_mm == pytest.approx(1 / 200 - 1 / 60, rel=1e-6)
    assert change.p_value < 1e-6


def coverage(
    disturbance: Callable[[np.random.Generator], Array], trials: int, **options: object
) -> tuple[float, float]:
    """Return how often the interval holds the truth, and the mean of the estimates over it."""
    random = np.random.default_rng(7)
    found = [arc_curvature(arc() + disturbance(random), **options) for _ in range(trials)]  # type: ignore[arg-type]
    held = np.mean([each.low_per_mm <= KAPPA <= each.high_per_mm for each in found])
    return float(held), float(np.mean([each.curvature_per_mm for each in found]) * RADIUS_MM)


# The study over 1,000 trials is benches/python/curvature.py; these are its limits widened for fewer trials.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("disturbance", "options"),
    [
        (white, {"noise": TrackerNoise.WHITE}),
        (white, {}),
        pytest.param(lambda random: correlated(random, 5.0), {}, marks=pytest.mark.study),
        pytest.param(lambda random: correlated(random, 20.0), {"correlation_mm": 20.0}, marks=pytest.mark.study),
    ],
)
def test_the_interval_holds_the_truth(
    disturbance: Callable[[np.random.Generator], Array], options: dict[str, object]
) -> None:
    held, ratio = coverage(disturbance, 40, **options)
    assert held >= 0.84
    assert ratio == pytest.approx(1, abs=0.08)


def test_the_tangent_form_is_narrower_and_needs_its_entry() -> None:
    random = np.random.default_rng(3)
    points = arc() + white(random)
    free = arc_curvature(points, noise=TrackerNoise.WHITE)
    tangent = arc_curvature(points, form=PathForm.TANGENT, entry=STRAIGHT_IN, noise=TrackerNoise.WHITE)
    assert free.sd_per_mm == pytest.approx(SIGMA_MM * np.sqrt(720 / POINTS) / LENGTH_MM**2, rel=0.15)
    assert tangent.sd_per_mm == pytest.approx(SIGMA_MM * np.sqrt(20 / POINTS) / LENGTH_MM**2, rel=0.15)
    with pytest.raises(DataError, match="is needed"):
        arc_curvature(points, form=PathForm.TANGENT)


def test_known_noise_is_generalised_least_squares() -> None:
    random = np.random.default_rng(2)
    place = np.sort(random.uniform(0, 80, 60))
    jacobian = np.column_stack([np.ones(60), place, place**2])
    residual = random.normal(size=60)
    found = marginalise(residual, jacobian, place, correlated=False)
    expected, left, *_ = np.linalg.lstsq(jacobian, residual, rcond=None)
    np.testing.assert_allclose(found.mean, expected, rtol=1e-8)
    sd = np.sqrt(left[0] / 57 * np.linalg.inv(jacobian.T @ jacobian)[2, 2])
    low, high = found.interval(np.array([0, 0, 1.0]))
    assert high - low == pytest.approx(2 * 2.0025 * sd, rel=1e-3)
    shuffled = random.permutation(60)
    again = marginalise(residual[shuffled], jacobian[shuffled], place[shuffled])
    np.testing.assert_allclose(again.mean, marginalise(residual, jacobian, place).mean, rtol=1e-8)


def test_paths_of_one_curvature_agree_and_others_do_not() -> None:
    random = np.random.default_rng(5)
    paths = [arc_curvature(arc(bend) + white(random)) for bend in (*[KAPPA] * 5, 2 * KAPPA)]
    values, sds = ([getattr(path, name) for path in paths] for name in ("curvature_per_mm", "interval_sd_per_mm"))
    assert agreement_of(values[:5], sds[:5]).agree
    low, high = combine(values[:5], sds[:5]).interval()
    assert low < KAPPA < high
    assert not agreement_of(values, sds).agree


def test_points_that_cannot_be_used_are_refused() -> None:
    with pytest.raises(DataError, match="too short"):
        arc_curvature(arc(points=5))
    with pytest.raises(DataError, match="must increase between 0 and"):
        path_curvature(arc(), [50.0, 20.0])
    with pytest.raises(DataError, match="a segment needs at least 5"):
        path_curvature(arc(points=20), [1.0])
