"""Inertia: natural frequencies, and its negligible effect at the speed of an insertion."""

import math

import numpy as np
import pytest

from needleplan.errors import ModelError
from needleplan.models.deflection import AxialTerms, Beam
from needleplan_thesis.chapter5.dynamics import Vibration, natural_frequencies_hz, vibrate
from tests.models.deflection.thesis import NEEDLE, SOFT, STIFF
from tests.reference.exact_beam import solve_exact

FIRST_ROOT = 1.8751040687119611
"""Roots of cosh(x) cos(x) = -1."""


def analytic_hz(bending: float, line_mass: float) -> float:
    return (FIRST_ROOT / NEEDLE.length_mm) ** 2 * math.sqrt(bending / line_mass) / (2 * math.pi)


def test_the_free_cantilever() -> None:
    own = natural_frequencies_hz(NEEDLE, SOFT, 0.0, 2, element_mm=2.03)
    analytic = analytic_hz(NEEDLE.bending_stiffness_n_mm2, NEEDLE.line_mass_t_mm)
    assert own[0] == pytest.approx(analytic, rel=1e-9)
    assert analytic_hz(2324.0, 8000e-12 * 0.2709) == pytest.approx(14.0620, abs=5e-4)  # with the printed A and I
    assert own[1] / own[0] == pytest.approx((4.694091132974174 / FIRST_ROOT) ** 2, rel=1e-8)


@pytest.mark.parametrize(
    ("tissue", "published"), [(SOFT, (57, 79, 122)), (STIFF, (61, 85, 139))], ids=["soft", "stiff"]
)
def test_tissue_makes_it_stiffer(tissue: object, published: tuple[float, ...]) -> None:
    own = [float(natural_frequencies_hz(NEEDLE, tissue, depth, 1)[0]) for depth in (10.0, 40.0, 80.0)]  # type: ignore[arg-type]
    np.testing.assert_allclose(own, published, atol=0.6)


def insert(shape: float, damping: float = 0.0) -> Vibration:
    step, velocity, end = 0.004, 15.0, 80.0
    depth = velocity * step * np.arange(int(end / velocity / step) + 1)
    return vibrate(NEEDLE, SOFT, 0.18 * (depth / end) ** shape, velocity, step, damping_1_s=damping, element_mm=4.0)


@pytest.mark.slow
def test_a_force_that_grows_like_the_square_of_the_depth_leaves_no_vibration() -> None:
    run = insert(2.0)
    assert 1e-4 < float(np.abs(run.tip_mm - run.static_tip_mm).max()) < 2e-3
    damped = insert(2.0, damping=2 * 0.02 * 2 * math.pi * 14)
    late = damped.depth_mm > 40
    assert float(np.abs(damped.tip_mm - damped.static_tip_mm)[late].max()) < 1e-5


def test_a_step_at_touch_down_rings_without_end() -> None:
    run = insert(0.0)
    apart = np.abs(run.tip_mm - run.static_tip_mm)
    assert float(apart[run.depth_mm < 5].max()) > 10  # a free cantilever
    assert float(apart[run.depth_mm > 60].max()) > 0.05


def test_its_static_part_is_the_exact_solution() -> None:
    run = insert(2.0)
    beam = Beam.of(NEEDLE, SOFT, run.depth_mm[300:], 1.0, terms=AxialTerms.PLAIN)
    push = 0.18 * (run.depth_mm[300:] / 80) ** 2
    exact = solve_exact(beam).tip_mm * push / float(np.ravel(beam.tip_push_n)[0])
    np.testing.assert_allclose(run.static_tip_mm[300:], exact, rtol=2e-5)


def test_too_deep() -> None:
    with pytest.raises(ModelError, match="needle's length"):
        vibrate(NEEDLE, SOFT, np.zeros(100), 15.0, 1.0)
