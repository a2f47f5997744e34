"""The members of the family, against quadrature, a stiff solver, and each other."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from needleplan.errors import ModelError
from needleplan.models import Model, simulate
from needleplan.models.friction import AveragedLuGre, Beta, Karnopp, LumpedLuGre, OutputForm, Profile, QuasiStatic
from needleplan.signals import Array, Motion, Start, sinusoid
from needleplan_thesis.chapter3.published import CASES, model_i, model_ii, model_iii_b, passing_through

INSIDE = sinusoid(offset_mm=38, amplitude_mm=25, frequency_hz=0.08, cycles=1, start=Start.MIDDLE)


def second_cycle(model: Model, case: int) -> Array:
    motion = passing_through(case, cycles=2)
    return simulate(model, motion).output[motion.time_s > 1 / CASES[case].frequency_hz]


def test_the_lumped_model_has_its_peak() -> None:
    force = second_cycle(model_ii(1), 1)
    assert [force.max(), force.min()] == pytest.approx([0.521, -0.521], abs=2e-3)


def test_the_averaged_model_is_lower_in_than_out() -> None:
    force = second_cycle(model_iii_b(1), 1)
    assert [force.max(), force.min()] == pytest.approx([0.510, -0.532], abs=2e-3)


@pytest.mark.parametrize("case", CASES)
def test_peaks_are_tenths_of_a_newton(case: int) -> None:
    assert 0.4 < second_cycle(model_ii(case), case).max() < 0.88


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("length", [0.2, 5.0, 76.0])
def test_model_i_is_the_integral_of_its_bending(case: int, length: float) -> None:
    model = model_i(case)
    for velocity in (-12.0, -0.3, 0.7, 9.0):
        moved = Motion.sampled(np.arange(2.0), np.full(2, length), np.full(2, velocity))
        g = float(model.level(moved)[0])
        bending = quad(lambda x, g=g: g / model.sigma0 * (1 - math.exp(-model.sigma0 * x / g)), 0, length,
                       epsabs=0, epsrel=1e-13, limit=200)[0]  # fmt: skip
        expected = math.copysign(model.sigma0 * bending / length, velocity) + model.sigma2 * velocity
        assert simulate(model, moved).output[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("model", [
    model_ii(1).with_values(profile=Profile.UNIFORM),
    model_iii_b(4),
    model_iii_b(4).with_values(beta=Beta.ABSOLUTE),
    model_iii_b(2).with_values(profile=Profile.RIGHT, beta=Beta.TIP),
], ids=["II uniform", "III-B", "III-B absolute", "III-A tip"])  # fmt: skip
def test_the_state_is_the_solution(model: LumpedLuGre) -> None:
    def instant(t: float) -> Motion:
        depth, velocity = (float(np.interp(t, INSIDE.time_s, x)) for x in (INSIDE.depth_mm, INSIDE.velocity_mm_s))
        return Motion(*(np.array(x) for x in (t, depth, velocity, np.sign(velocity), 0.0)))

    solution = solve_ivp(
        lambda t, z: model.derivative(z, instant(t)), (INSIDE.time_s[0], INSIDE.time_s[-1]), [0.0], "LSODA",
        INSIDE.time_s[::20], rtol=1e-9, atol=1e-11, max_step=0.02,
    )  # fmt: skip
    # |v| has a kink at the reversals, somewhere within a step.
    ours = simulate(model, INSIDE)
    np.testing.assert_allclose(ours.states[:, ::20], solution.y, atol=3e-5)
    np.testing.assert_allclose(ours.output[::20], model.output(solution.y, INSIDE[::20]), atol=5e-5)


def test_the_output_is_the_integral_over_the_patch() -> None:
    """(3.18) with z = psi phi, done by quadrature, is (3.11) and not what (3.19) prints."""
    model, length, velocity, bending = model_iii_b(1), 60.0, 5.0, 0.21
    moved = Motion.sampled(np.arange(2.0), np.full(2, length), np.full(2, velocity))
    g, lam, w = float(model.level(moved)[0]), model.exponent, model.ramp_mm
    plateau = 1 / (model.reference_mm - w)

    def along(function: Callable[[float], float]) -> float:
        def weighted(x: float) -> float:
            return function(x) * min(x / w, 1.0, (length - x) / w) * plateau

        return sum(quad(weighted, a, b, epsrel=1e-12)[0] for a, b in ((0, w), (w, length - w), (length - w, length)))

    total = along(lambda _: 1.0)
    phi = bending * total / along(lambda x: x**lam)
    share = model.sigma0 - model.sigma0 * model.sigma1 * velocity / g
    expected = along(
        lambda x: share * x**lam * phi - model.sigma1 * velocity * lam * x ** (lam - 1) * phi
        + (model.sigma1 + model.sigma2) * velocity
    )  # fmt: skip
    state = np.full((1, 2), bending)
    assert model.output(state, moved)[0] == pytest.approx(expected, rel=1e-9)
    printed = model.with_values(form=OutputForm.PRINTED)
    assert abs(printed.output(state, moved)[0] - expected) > 0.05


@pytest.mark.parametrize("case", CASES)
def test_the_printed_output_leaves_a_one_sided_force(case: int) -> None:
    model, motion = model_iii_b(case), passing_through(case, cycles=2)
    printed = simulate(model.with_values(form=OutputForm.PRINTED), motion)
    undamped = simulate(model.with_values(sigma1=1e-5), motion).output
    left = printed.output - undamped
    expected = -model.sigma1 * model.transport_per_s(motion) * printed.states[0]
    np.testing.assert_allclose(left, expected, atol=1e-4)
    assert 0.05 < left.max() < 0.23
    assert left.min() > -0.01


def test_short_lengths_have_a_normal_force_where_the_printed_one_is_negative() -> None:
    model = model_iii_b(1)
    shallow = sinusoid(offset_mm=1.2, amplitude_mm=1.2, frequency_hz=0.1, cycles=1)
    assert (model.total_normal_force_n(shallow)[10:-10] > 0).all()
    assert (shallow.depth_mm < model.ramp_mm).all()


def test_a_needle_that_passes_through_has_a_patch_of_constant_length() -> None:
    through = passing_through(3)
    assert (model_ii(3).inserted_mm(through) == 76.0).all()
    np.testing.assert_array_equal(model_ii(3).inserted_mm(INSIDE), INSIDE.depth_mm)
    away = Motion.sampled(np.arange(3.0), np.array([-5.0, 0.0, 5.0]))
    assert model_ii(3).inserted_mm(away).tolist() == [0, 0, 5]


def test_outside_of_the_tissue_bristles_straighten() -> None:
    motion = sinusoid(offset_mm=5, amplitude_mm=15, frequency_hz=0.1, cycles=2)
    for model in (model_ii(1), model_iii_b(1).with_values(beta=Beta.ABSOLUTE)):
        states = simulate(model.with_values(profile=Profile.ISOSCELES), motion).states[0]
        outside = motion.depth_mm < -0.2
        assert np.abs(states[outside]).max() < 1e-3
        assert np.abs(states).max() > 0.1


def test_a_sine_that_begins_at_full_speed_gives_a_blow() -> None:
    motion = sinusoid(offset_mm=126, amplitude_mm=25, frequency_hz=0.05, cycles=2)
    begun = motion[np.flatnonzero(motion.time_s >= 5.0)]
    model = model_ii(1)
    assert simulate(model, begun).output[0] > 3 * simulate(model, motion).output.max()
    assert np.abs(simulate(model, motion).output[:20]).max() < 0.1


def rough(draw_sigma1: float = 0.0, **values: float) -> LumpedLuGre:
    return LumpedLuGre(sigma1=max(draw_sigma1, 1e-5), **values)


SURFACES = st.fixed_dictionaries({
    "sigma0": st.floats(0.2, 4), "mu_c": st.floats(0.05, 1), "mu_s": st.floats(0.02, 1), "alpha": st.floats(0.01, 0.5),
    "sigma2": st.floats(0, 0.05),
})  # fmt: skip
MOTIONS = st.builds(
    lambda frequency, amplitude, start: sinusoid(
        offset_mm=60, amplitude_mm=amplitude, frequency_hz=frequency, cycles=1.5, start=start, rate_hz=400
    ),
    st.floats(0.05, 0.2), st.floats(1, 15), st.sampled_from(Start),
)  # fmt: skip


@settings(max_examples=40, deadline=None)
@given(surface=SURFACES, motion=MOTIONS)
def test_friction_without_damping_opposes_the_motion(surface: dict[str, float], motion: Motion) -> None:
    surface = {**surface, "sigma2": 0.0}
    static = QuasiStatic(**surface)
    assert (simulate(static, motion).output * motion.velocity_mm_s >= 0).all()
    assert (simulate(Karnopp(mu_c=surface["mu_c"], sigma2=0.0), motion).output * motion.velocity_mm_s >= 0).all()
    # Bent bristles push back for a while after a reversal, so they oppose a motion that goes on in one direction.
    first = motion[: int(np.argmax(motion.direction < 0)) or len(motion)]
    force = simulate(rough(**surface), first).output
    assert (force >= -1e-9).all()
    assert force.max() <= max(surface["mu_c"], surface["mu_s"]) * (1 + 1e-6)


@settings(max_examples=40, deadline=None)
@given(surface=SURFACES, motion=MOTIONS, share=st.floats(0, 0.9))
def test_the_lumped_model_gives_back_no_more_energy_than_it_took(
    surface: dict[str, float], motion: Motion, share: float
) -> None:
    """Passive where sigma1 <= 4 g/|v|: the storage sigma0 z^2/2 then grows no faster than F v."""
    fastest = np.abs(motion.velocity_mm_s) > 1e-6
    level = QuasiStatic(**surface).level(motion)
    limit = 4 * (level[fastest] / np.abs(motion.velocity_mm_s[fastest])).min()
    model = rough(share * float(limit), **surface)
    run = simulate(model, motion)
    power = run.output * motion.velocity_mm_s
    energy = np.concatenate([[0], np.cumsum((power[1:] + power[:-1]) / 2 * motion.interval_s)])
    stored = model.sigma0 * run.states[0] ** 2 / 2
    supplied = energy - stored
    # Steps of the trapezoidal rule may err by a little of what passes through.
    assert (np.diff(supplied) >= -1e-4 * np.abs(power).max() * motion.interval_s.max() - 1e-9).all()


@settings(max_examples=25, deadline=None)
@given(surface=SURFACES, sigma1=st.floats(0.01, 1), motion=MOTIONS)
def test_what_has_no_beta_v_is_its_own_mirror_image(surface: dict[str, float], sigma1: float, motion: Motion) -> None:
    through = Motion.sampled(motion.time_s, motion.depth_mm + 100, motion.velocity_mm_s)
    mirrored = Motion.sampled(motion.time_s, 320 - through.depth_mm, -motion.velocity_mm_s)
    averaged = AveragedLuGre(**surface, sigma1=sigma1)
    symmetric = [
        Karnopp(mu_c=surface["mu_c"], sigma2=surface["sigma2"]), QuasiStatic(**surface), rough(sigma1, **surface),
        averaged.with_values(beta=Beta.ABSOLUTE),
    ]  # fmt: skip
    for model in symmetric:
        here, there = simulate(model, through).output, simulate(model, mirrored).output
        np.testing.assert_allclose(here, -there, atol=1e-12)
    force = simulate(averaged, through).output
    assume(np.abs(force).max() > 0.01)
    assert np.abs(force + simulate(averaged, mirrored).output).max() > 1e-4 * np.abs(force).max()


def test_choices_that_do_not_exist_are_refused() -> None:
    values = model_iii_b(1).values()
    with pytest.raises(ModelError, match="must be one of constant, uniform, right, isosceles"):
        AveragedLuGre(**values, profile="trapezoid")  # type: ignore[arg-type]
    with pytest.raises(ModelError, match="must be right or isosceles"):
        AveragedLuGre(**values, profile=Profile.CONSTANT)
    with pytest.raises(ModelError, match="mirror"):
        AveragedLuGre(**values, profile=Profile.RIGHT, beta=Beta.ABSOLUTE)
    with pytest.raises(ModelError, match="consistent, printed"):
        AveragedLuGre(**values, form="3.19")  # type: ignore[arg-type]
    assert AveragedLuGre(**values, profile="right").profile is Profile.RIGHT  # type: ignore[arg-type]
