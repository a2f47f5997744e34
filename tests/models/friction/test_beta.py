"""Normal force and beta against the integrals that they stand for."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from needleplan.models.friction import Beta, Profile, beta_per_mm, intensity, normal_length_mm

TRAPEZOIDS = (Profile.RIGHT, Profile.ISOSCELES)
LENGTHS = (0.3, 2.4, 2.5, 2.6, 4.9, 5.0, 5.1, 13.0, 76.0)
RAMP = 2.5


def integral(function: Callable[[float], float], length: float) -> float:
    """Integrate piece by piece between the corners of a profile."""
    corners = sorted({0.0, min(RAMP, length), min(length / 2, RAMP), max(length - RAMP, length / 2), length})
    return sum(quad(function, a, b, epsabs=0, epsrel=1e-13)[0] for a, b in pairwise(corners) if b > a)


def spread(profile: Profile, position: float, length: float) -> float:
    return float(intensity(profile, np.array(position), length, RAMP))


def slope(profile: Profile, position: float, length: float) -> float:
    """Return fn' at a position, f = 1."""
    end = min(RAMP, length) if profile is Profile.RIGHT else min(RAMP, length / 2)
    if position < end:
        return 1 / RAMP
    return -1 / RAMP if profile is Profile.ISOSCELES and position > max(length - RAMP, length / 2) else 0.0


@pytest.mark.parametrize("profile", [Profile.UNIFORM, *TRAPEZOIDS])
@pytest.mark.parametrize("length", LENGTHS)
def test_the_normal_force_is_the_integral_of_its_intensity(profile: Profile, length: float) -> None:
    expected = integral(lambda position: spread(profile, position, length), length)
    assert float(normal_length_mm(profile, np.array(length), RAMP)) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("length", LENGTHS)
def test_the_printed_normal_force_holds_for_long_patches_only(length: float) -> None:
    ours = float(normal_length_mm(Profile.ISOSCELES, np.array(length), RAMP))
    assert (ours == pytest.approx(length - RAMP)) is (length >= 2 * RAMP)
    assert ours > 0


@pytest.mark.parametrize("exponent", [0.5, 1.5, 2.5, 5.0])
@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("profile", TRAPEZOIDS)
def test_beta_is_the_quotient_of_its_integrals(profile: Profile, length: float, exponent: float) -> None:
    weight = integral(lambda x: x**exponent * spread(profile, x, length), length)
    inner = integral(lambda x: x**exponent * slope(profile, x, length), length)
    end = length**exponent * spread(profile, length, length)
    growth = integral(lambda x: spread(profile, x, length), length)
    rising = {Profile.RIGHT: min(RAMP, length), Profile.ISOSCELES: min(RAMP, length / 2)}[profile]
    carried = rising ** (exponent + 1) / (exponent + 1) / RAMP  # fn' + dfn/dL is 1/w on the rising ramp alone
    per_length = spread(profile, length, length) if profile is Profile.RIGHT else min(1.0, length / (2 * RAMP))
    expected = {
        Beta.TRANSPORT: (inner - end) / weight,
        Beta.PRINTED: inner / weight,
        Beta.TIP: carried / weight - per_length / growth,
    }
    for term, value in expected.items():
        ours = float(beta_per_mm(profile, term, np.array(length), RAMP, exponent))
        assert ours == pytest.approx(value, rel=1e-9), term


def test_the_printed_end_of_the_right_trapezoid_is_missing() -> None:
    length = np.array([76.0])
    printed = [float(beta_per_mm(Profile.RIGHT, Beta.PRINTED, length, RAMP, lam)[0]) for lam in (0.5, 5.0)]
    corrected = [float(beta_per_mm(Profile.RIGHT, Beta.TRANSPORT, length, RAMP, lam)[0]) for lam in (0.5, 5.0)]
    assert printed == pytest.approx([2e-3, 5e-10], rel=0.2)
    assert corrected == pytest.approx([-0.017, -0.079], abs=5e-4)


@settings(max_examples=60, deadline=None)
@given(
    profile=st.sampled_from(TRAPEZOIDS), term=st.sampled_from([Beta.TRANSPORT, Beta.PRINTED, Beta.TIP]),
    ramp=st.floats(0.5, 20), exponent=st.floats(0.1, 8),
)  # fmt: skip
def test_everything_is_continuous_where_triangles_become_trapezoids(
    profile: Profile, term: Beta, ramp: float, exponent: float
) -> None:
    corner = ramp if profile is Profile.RIGHT else 2 * ramp
    around = corner * np.array([1 - 1e-9, 1 + 1e-9])
    below, above = beta_per_mm(profile, term, around, ramp, exponent)
    assert below == pytest.approx(above, rel=1e-6)
    below, above = normal_length_mm(profile, around, ramp)
    assert below == pytest.approx(above, rel=1e-6)


@pytest.mark.parametrize("profile", TRAPEZOIDS)
def test_flat_bending_is_not_changed_by_a_moving_tip(profile: Profile) -> None:
    flat = beta_per_mm(profile, Beta.TIP, np.array(LENGTHS), RAMP, 0.0)
    np.testing.assert_allclose(flat, 0, atol=1e-12)
    if profile is Profile.ISOSCELES:
        np.testing.assert_allclose(beta_per_mm(profile, Beta.TRANSPORT, np.array(LENGTHS), RAMP, 0.0), 0, atol=1e-12)
