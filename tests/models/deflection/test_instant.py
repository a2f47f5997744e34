"""The needle at an instant: exact solution, finite elements, collocation."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.errors import ModelError
from needleplan.models import NeedleShaft
from needleplan.models.deflection import AxialTerms, Beam, ElasticTissue, solve_elements, solve_uniform
from tests.models.deflection.thesis import COIL_MM, NEEDLE, SOFT, STIFF, beam
from tests.models.deflection.twin import collocation
from tests.reference.exact_beam import solve_exact

EXPONENTIAL = [AxialTerms.PRINTED, AxialTerms.PLAIN, AxialTerms.FIXED]
ORACLES = {
    AxialTerms.PRINTED: (1.907932, 1.460279),
    AxialTerms.PLAIN: (1.842982, 1.407635),
    AxialTerms.CONSISTENT: (1.835866, 1.396638),
    AxialTerms.FIXED: (1.781525, 1.357839),
}
"""Deflection of tip and coil (mm) at 80 mm, 0.15 N, 15 mm/s in the soft gel: oracles 7 to 10."""


def test_the_section_is_the_printed_one() -> None:
    assert pytest.approx(1.162e-2, rel=3e-4) == NEEDLE.second_moment_mm4
    assert pytest.approx(0.2709, rel=3e-4) == NEEDLE.area_mm2
    assert NEEDLE.bending_stiffness_n_mm2 == pytest.approx(2324, rel=3e-4)
    assert NEEDLE.line_mass_t_mm * 1e6 == pytest.approx(2.167e-3, rel=3e-4)  # 1e-6 t/mm is 1 kg/m
    assert NEEDLE.torsional_stiffness_n_mm2 == pytest.approx(1789, rel=1e-3)


@pytest.mark.parametrize("terms", AxialTerms)
def test_tip_and_coil_at_80_mm(terms: AxialTerms) -> None:
    made = beam(SOFT, 80.0, 0.15, 15.0, terms)
    for behind, oracle in zip((0.0, COIL_MM), ORACLES[terms], strict=True):
        assert float(solve_elements(made, behind, element_mm=1.0)) == pytest.approx(oracle, rel=1e-6)
        if terms in EXPONENTIAL:
            assert float(solve_exact(made).at(behind)) == pytest.approx(oracle, rel=1e-6)


@pytest.mark.parametrize("terms", EXPONENTIAL)
@pytest.mark.parametrize("tissue", [SOFT, STIFF], ids=["soft", "stiff"])
@pytest.mark.parametrize("depth", [1.0, 10.0, 40.0, 80.0, 150.0])
def test_exponentials_agree_with_collocation(terms: AxialTerms, tissue: ElasticTissue, depth: float) -> None:
    made = beam(tissue, depth, 0.1, 15.0, terms)
    digits = 1e-10 if depth >= 10 else 5e-9  # just after entry the four functions are nearly dependent
    twin = collocation(made)
    for behind in (0.0, COIL_MM, 120.0):
        assert float(solve_exact(made).at(behind)) == pytest.approx(twin(behind), rel=digits, abs=1e-13)


@pytest.mark.parametrize("depth", [1.0, 10.0, 80.0, 150.0])
def test_elements_under_axial_load_agree_with_collocation(depth: float) -> None:
    made = replace(beam(STIFF, depth, 0.1, 15.0, AxialTerms.CONSISTENT), tip_moment_n_mm=np.asarray(0.5))
    twin = collocation(made)
    for behind in (0.0, COIL_MM, 120.0):
        found = float(solve_elements(made, behind, element_mm=1.0))
        assert found == pytest.approx(twin(behind), rel=2e-7)


def test_tension_is_compression_with_the_other_sign() -> None:
    made = beam(SOFT, 60.0, 0.1, -15.0, AxialTerms.CONSISTENT)
    assert float(solve_elements(made, element_mm=1.0)) == pytest.approx(collocation(made)(0.0), rel=2e-7)


def test_elements_converge_with_the_fourth_power() -> None:
    made = beam(SOFT, 80.0, 0.15, 15.0, AxialTerms.PRINTED)
    exact = float(solve_exact(made).tip_mm)
    errors = [abs(float(solve_uniform(made, count).tip_mm[0]) / exact - 1) for count in (4, 10, 20, 40)]
    # What the reference solution had, 2.6e-4, 7.1e-6, 4.5e-7 and 2.8e-8, to within a factor of two.
    np.testing.assert_array_less(errors, [5.2e-4, 1.5e-5, 9e-7, 6e-8])
    assert errors[0] / errors[2] > 300


@settings(max_examples=40, deadline=None)
@given(
    depth=st.floats(0.5, 190), force=st.floats(0, 0.2), velocity=st.floats(-20, 20),
    stiffness=st.floats(2e-3, 0.2), terms=st.sampled_from(EXPONENTIAL), behind=st.floats(0, 203),
)  # fmt: skip
def test_elements_are_the_exact_solution(
    depth: float, force: float, velocity: float, stiffness: float, terms: AxialTerms, behind: float
) -> None:
    made = Beam.of(NEEDLE, ElasticTissue(stiffness, 1e-4), depth, force, velocity, terms=terms)
    exact = solve_exact(made)
    scale = 1e-9 + float(abs(exact.tip_mm))
    assert abs(float(solve_elements(made, behind, element_mm=1.0) - exact.at(behind))) < 1e-5 * scale


@settings(max_examples=25, deadline=None)
@given(st.floats(-3, 3), st.floats(5, 150), st.sampled_from([AxialTerms.PLAIN, AxialTerms.PRINTED]))
def test_deflection_is_linear_in_the_push(factor: float, depth: float, terms: AxialTerms) -> None:
    made = beam(SOFT, depth, 0.1, 15.0, terms)
    more = replace(made, tip_push_n=factor * made.tip_push_n)
    assert float(solve_exact(more).tip_mm) == pytest.approx(
        factor * float(solve_exact(made).tip_mm), rel=1e-9, abs=1e-12
    )


def test_many_insertions_are_one_after_the_other() -> None:
    depth, force = np.linspace(2, 150, 300).reshape(3, 100), np.linspace(0.01, 0.2, 100)
    many = Beam.of(NEEDLE, SOFT, depth, force, 15.0)
    together = solve_elements(many, COIL_MM)
    for row, column in [(0, 0), (1, 30), (2, 99)]:
        one = Beam.of(NEEDLE, SOFT, depth[row, column], force[column], 15.0)
        assert together[row, column] == pytest.approx(float(solve_elements(one, COIL_MM)), rel=1e-9)
    plain = Beam.of(NEEDLE, SOFT, depth, force, 15.0, terms=AxialTerms.FIXED)
    np.testing.assert_allclose(solve_exact(plain).at(COIL_MM), solve_elements(plain, COIL_MM), rtol=2e-5)
    np.testing.assert_allclose(solve_exact(plain).tip_mm, solve_elements(plain), rtol=1e-5)
    # Few systems go another way than many.
    same = Beam.of(NEEDLE, SOFT, np.full(200, 80.0), np.linspace(0.01, 0.2, 200), 15.0).flat()
    rows = solve_uniform(same, 20).slope_rad
    np.testing.assert_allclose(solve_uniform(same.rows(np.arange(9)), 20).slope_rad, rows[:9], rtol=1e-8)


def test_table_5_1_meets_its_conditions_and_where_it_ends() -> None:
    # The lifting polynomial phi = (c3 x^3 + c2 x^2) Fc of (5.10), SI: EI phi''' = Fc cos a - Fc sin a phi' at L, with
    # the sign of the thesis, whose w is -u.
    bending, length, alpha = 2.324e-3, 0.203, NEEDLE.bevel_angle_rad
    for force in (0.05, 0.15, 0.25, 0.2685):
        c3 = math.cos(alpha) / (6 * bending - 3 * length**2 * force * math.sin(alpha))
        c2 = -3 * length * c3
        slope, moment, shear = (3 * c3 * length**2 + 2 * c2 * length, 6 * c3 * length + 2 * c2, 6 * c3)
        residual = bending * shear - (math.cos(alpha) - force * math.sin(alpha) * slope)
        assert abs(residual * force) < 1e-12
        assert abs(moment * force) < 1e-10
    assert 2 * bending / (length**2 * math.sin(alpha)) == pytest.approx(0.268901, abs=1e-6)
    # Our printed terms have that singularity for the free cantilever: the deflection changes its sign there.
    below, above = (
        float(solve_elements(beam(ElasticTissue(1e-6), 0.01, force, 0.0, AxialTerms.PRINTED)))
        for force in (0.2685, 0.2693)
    )
    assert below > 100 > -100 > above


def test_the_thesis_route_leads_to_the_same_tip() -> None:
    # Lifting polynomial + static Green's function by quadrature. It cancels some 40 times; only worth a check.
    made = beam(SOFT, 80.0, 0.15, 15.0, AxialTerms.PRINTED)
    push, follow = float(made.tip_push_n), float(made.tip_follow_n)
    bending, spring, slope = 2324.0, SOFT.stiffness_n_mm2, float(made.slope_n_mm)
    length, l1 = 203.0, 123.0
    c3 = -push / (6 * bending - 3 * length**2 * follow)
    points, weights = np.polynomial.legendre.leggauss(12)
    x = l1 + (points + 1) * 40.0
    phi, steep = c3 * (x**3 - 3 * length * x**2), c3 * (3 * x**2 - 6 * length * x)
    load = -(spring * phi + slope * steep)  # on what is left, in the tissue
    green = np.array([tip_of_a_point_load(made, place - l1) for place in x])
    tip = c3 * (length**3 - 3 * length**3) + (green * load * weights * 40.0).sum()
    assert tip == pytest.approx(1.907932, rel=1e-6)


def tip_of_a_point_load(made: Beam, place_mm: float) -> float:
    """Return the deflection of the tip by a unit load in the tissue, by scipy's matrix exponential of the equation."""
    from scipy.linalg import expm

    bending = float(made.bending_n_mm2)
    step = np.eye(4, k=1)
    outside = expm(step * 123.0)
    step[3] = [-float(made.foundation_n_mm2) / bending, -float(made.slope_n_mm) / bending, 0, 0]
    before, after = expm(step * place_mm) @ outside, expm(step * (80.0 - place_mm))
    whole, kick = after @ before, after @ np.array([0, 0, 0, 1 / bending])
    follow = np.array([0, float(made.tip_follow_n) / bending, 0, 1])
    rows = np.stack([whole[2, 2:], (follow @ whole)[2:]])
    start = np.linalg.solve(rows, -np.array([kick[2], follow @ kick]))
    return float(whole[0, 2:] @ start + kick[0])


def tip_off_the_line(terms: AxialTerms, count: int = 10) -> float:
    """Push the needle along an oblique line that it has cut, without cutting force: its tip should stay on it."""
    angle, depth = 0.05, 80.0
    made = beam(SOFT, depth, 0.0, 15.0, terms)
    line = angle * np.linspace(0, depth, count + 1)
    shape = solve_uniform(made, count, line[None], base_mm=-angle * 123.0, base_slope_rad=angle)
    assert float(shape.at(150.0)[0]) == pytest.approx(angle * (depth - 150.0), abs=0.01)
    return float(shape.tip_mm[0] - line[-1])


def test_turning_everything_changes_nothing_only_with_all_axial_terms() -> None:
    line_mm = 0.05 * 80
    assert abs(tip_off_the_line(AxialTerms.CONSISTENT)) < 1e-12 * line_mm
    assert abs(tip_off_the_line(AxialTerms.PLAIN)) < 1e-11 * line_mm
    assert tip_off_the_line(AxialTerms.PRINTED) == pytest.approx(0.0258, abs=1e-4)
    assert tip_off_the_line(AxialTerms.FIXED) == pytest.approx(-0.0257, abs=1e-4)


@pytest.mark.parametrize(("make", "message"), [
    (lambda: Beam.of(NEEDLE, SOFT, 203.0, 0.1), "less than the needle's length"),
    (lambda: Beam.of(NEEDLE, SOFT, [10.0, 0.0], 0.1), "more than 0"),
    (lambda: Beam.of(NEEDLE, SOFT, 10.0, float("nan")), "cutting_force_n: must be finite"),
    (lambda: ElasticTissue(float("nan")), "stiffness_n_mm2"),
    (lambda: ElasticTissue(3870.0), "1 kN/m2 is 0.001"),
    (lambda: NeedleShaft(0.4, 0.7, 203.0, 0.4), "less than outer_diameter_mm"),
    (lambda: NeedleShaft(0.718, 0.413, 0.203, 0.4), "length_mm = 0.203"),
    (lambda: solve_exact(Beam.of(NEEDLE, SOFT, 10.0, 0.1)), "axial load"),
    (
        lambda: solve_exact(Beam.of(NEEDLE, ElasticTissue(1e-6, 1e-4), 10.0, 0.1, 50.0, terms=AxialTerms.FIXED)),
        "no decaying",
    ),
    (lambda: solve_elements(Beam.of(NEEDLE, SOFT, 10.0, 0.1), element_mm=0.0), "must be positive"),
])  # fmt: skip
def test_what_cannot_be_is_refused(make: object, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        make()  # type: ignore[operator]
