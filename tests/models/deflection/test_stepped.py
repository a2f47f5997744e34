"""A shaft whose stiffness changes along it, against closed forms and collocation with one piece per stiffness."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_bvp

from needleplan.errors import ModelError
from needleplan.models import NeedleShaft, SpatialBeam
from needleplan.models.deflection import (
    AxialTerms,
    Beam,
    ElasticTissue,
    finite_depth_factor,
    march,
    solve_elements,
    solve_uniform,
    steady_radius_mm,
    tip_path_mm,
)
from tests.models.deflection.thesis import NEEDLE
from tests.reference.exact_beam import solve_exact

GEL = ElasticTissue(3.87e-3, 123.9e-6)
LENGTH = NEEDLE.length_mm
EI = NEEDLE.bending_stiffness_n_mm2


def stepped(*steps: tuple[float, float]) -> NeedleShaft:
    return replace(NEEDLE, stiffness_steps=steps)


def in_air(needle: NeedleShaft, depth_mm: float, force_n: float, count: int) -> float:
    """Return the deflection of the tip without tissue: only the division into outer part and elements remains."""
    beam = Beam.of(needle, GEL, depth_mm, force_n, terms=AxialTerms.PLAIN).flat()
    return float(solve_uniform(replace(beam, foundation_n_mm2=np.zeros(1)), count).tip_mm[0])


@pytest.mark.parametrize("depth", [17.0, 60.0, 120.0])
@pytest.mark.parametrize("count", [1, 7])
def test_a_stepped_cantilever_bends_as_in_the_textbook(depth: float, count: int) -> None:
    soft, ratio, force = 40.0, 5.0, 1e-3
    push = force * math.cos(NEEDLE.bevel_angle_rad)
    expected = push / 3 * ((LENGTH**3 - soft**3) / (ratio * EI) + soft**3 / EI)
    assert in_air(stepped((soft, ratio)), depth, force, count) == pytest.approx(expected, rel=1e-9)


def test_a_taper_is_a_number_of_steps() -> None:
    # Solid cone, diameter d at the tip and 2 d at the base: the deflection is P L^3 / (3 EI_base) (d_base / d_tip).
    force, number = 1e-3, 60
    push = force * math.cos(NEEDLE.bevel_angle_rad)
    edges = np.linspace(0, LENGTH, number + 1)
    ratios = (1 + (edges[:-1] + edges[1:]) / 2 / LENGTH) ** 4
    cone = replace(
        NEEDLE, youngs_modulus_gpa=NEEDLE.youngs_modulus_gpa * ratios[0],
        stiffness_steps=tuple(zip(edges[1:-1].tolist(), (ratios[1:] / ratios[0]).tolist(), strict=True)),
    )  # fmt: skip
    expected = push * LENGTH**3 / (3 * EI * 2**4) * 2
    assert in_air(cone, 50.0, force, 5) == pytest.approx(expected, rel=2e-4)


def collocated(needle: NeedleShaft, beam: Beam) -> float:
    """Return the deflection of the tip, with the states u, u', moment and transverse force in every piece."""
    made = {name: float(value) for name, value in zip(list(vars(beam))[:-1], beam.coefficients, strict=True)}
    entry = LENGTH - made["depth_mm"]
    breaks = sorted({0.0, LENGTH, entry, *(LENGTH - place for place, _ in needle.stiffness_steps)})
    sizes, middles = np.diff(breaks), (np.array(breaks[:-1]) + breaks[1:]) / 2
    ratios = [1.0, *(ratio for _, ratio in needle.stiffness_steps)]
    places = [place for place, _ in needle.stiffness_steps]
    stiff = [EI * ratios[sum(LENGTH - x >= place for place in places)] for x in middles]
    rate = made["axial_rate_n_mm"]

    def rates(t: np.ndarray, y: np.ndarray) -> np.ndarray:
        rows = []
        for k, size in enumerate(sizes):
            u, theta, m, q = y[4 * k : 4 * k + 4]
            x = breaks[k] + t * size
            inside = middles[k] > entry
            axial = made["tip_axial_n"] + rate * (LENGTH - np.maximum(x, entry))
            support = made["foundation_n_mm2"] * u + rate * theta if inside else 0.0 * u
            rows += [size * theta, size * m / stiff[k], size * (q - axial * theta), -size * support]
        return np.array(rows)

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        tip = b[-4:]
        shear = tip[3] + made["tip_push_n"] - (made["tip_axial_n"] - made["tip_follow_n"]) * tip[1]
        return np.concatenate([a[:2], b[:-4] - a[4:], [tip[2], shear]])

    grid = np.linspace(0, 1, 41)
    done = solve_bvp(rates, ends, grid, np.zeros((4 * sizes.size, grid.size)), tol=1e-9, max_nodes=100_000)
    assert done.success, done.message
    return float(done.y[-4, -1])


@pytest.mark.parametrize("steps", [(), ((35.0, 4.0),), ((35.0, 0.3), (120.0, 6.0)), ((150.0, 0.2),)])
@pytest.mark.parametrize("terms", [AxialTerms.PLAIN, AxialTerms.CONSISTENT])
def test_a_needle_in_tissue_against_collocation(steps: tuple[tuple[float, float], ...], terms: AxialTerms) -> None:
    needle = stepped(*steps)
    beam = Beam.of(needle, GEL, 80.0, 0.15, 15.0, terms=terms)
    expected = collocated(needle, beam)
    assert float(solve_elements(beam, element_mm=2.0)) == pytest.approx(expected, rel=2e-5)
    assert float(solve_elements(beam)) == pytest.approx(expected, rel=1e-3)


def test_steps_of_ratio_one_change_nothing_and_a_stiff_shaft_bends_less() -> None:
    force = 0.05 * np.minimum(np.arange(81.0) / 20, 1) ** 2
    plain, same, stiff = (
        march(each, GEL, force, 1.0, 15.0).tip_mm for each in (NEEDLE, stepped((33.3, 1.0)), stepped((30.0, 10.0)))
    )
    np.testing.assert_allclose(same, plain, rtol=1e-7, atol=1e-9)
    assert np.abs(stiff[1:]).max() < np.abs(plain[1:]).max()
    # A long soft tip curves like a shaft that is soft everywhere, a short one like a stiff shaft.
    uniform, long, short = (
        float(finite_depth_factor(each, GEL, 80.0)) for each in (NEEDLE, stepped((150.0, 8.0)), stepped((5.0, 8.0)))
    )
    assert long == pytest.approx(uniform, rel=0.05)
    assert short > 0.5 * 8**0.75


def test_what_needs_a_uniform_shaft_says_so() -> None:
    needle = stepped((30.0, 2.0))
    for call in (
        lambda: steady_radius_mm(needle, GEL, 0.1),
        lambda: SpatialBeam.of(needle, GEL, 0.1),
        lambda: tip_path_mm(needle, GEL, [0.0, 1.0], [0.1, 0.1]),
        lambda: solve_exact(Beam.of(needle, GEL, 80.0, 0.1, terms=AxialTerms.PLAIN)),
        lambda: solve_elements(Beam.of(needle, GEL, 80.0, 0.1), 90.0),
    ):
        with pytest.raises(ModelError, match=r"stiffness_steps|behind_tip_mm"):
            call()


@pytest.mark.parametrize("steps", [((0.0, 2.0),), ((50.0, 2.0), (40.0, 3.0)), ((300.0, 2.0),), ((50.0, 0.0),)])
def test_wrong_steps_are_refused(steps: tuple[tuple[float, float], ...]) -> None:
    with pytest.raises(ModelError, match="stiffness_steps"):
        stepped(*steps)
