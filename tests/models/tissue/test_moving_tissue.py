from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from needleplan.errors import ModelError
from needleplan.models import LinearStateModel, parameter, simulate
from needleplan.models.friction import Beta, LumpedLuGre, Profile
from needleplan.models.tissue import AveragedOnTissue, LumpedOnTissue, MovingTissue, PointwiseLaw
from needleplan.models.tissue._moving import first_root
from needleplan.signals import Array, Motion, lag_rad, sinusoid
from needleplan_thesis.chapter3.published import MODEL_II

CASE_1 = {name: printed.mean for name, printed in MODEL_II[1].items()}
SMOOTH = {"sigma0": 0.3, "sigma1": 0.05, "sigma2": 0.012, "mu_c": 0.3, "mu_s": 0.03, "alpha": 0.08}
TISSUES = [{"stiffness": 0.1, "damping": 0.02}, {"stiffness": 0.3, "damping": 0.003}]


def swing(cycles: float = 1.0, rate_hz: float = 200.0, offset_mm: float = 126.0) -> Motion:
    return sinusoid(offset_mm=offset_mm, amplitude_mm=40, frequency_hz=0.1, cycles=cycles, rate_hz=rate_hz)


def radau(model: MovingTissue, motion: Motion) -> Array:
    """What a stiff solver makes of the three equations, the motion linear between samples."""

    def rates(t: float, state: Array) -> Array:
        velocity = np.interp(t, motion.time_s, motion.velocity_mm_s)
        depth = np.interp(t, motion.time_s, motion.depth_mm)
        here = Motion(np.asarray(t), np.asarray(depth), np.asarray(velocity), np.sign(velocity), np.zeros(()))
        return model.derivative(state, here)

    ends = (motion.time_s[0], motion.time_s[-1])
    solved = solve_ivp(rates, ends, np.zeros(3), "Radau", motion.time_s, rtol=1e-5, atol=1e-7, max_step=0.05)
    return np.asarray(solved.y)


@pytest.mark.parametrize("friction", [CASE_1, SMOOTH])
@pytest.mark.parametrize("tissue", TISSUES)
def test_the_steps_are_the_differential_equation(friction: dict[str, float], tissue: dict[str, float]) -> None:
    model, motion = LumpedOnTissue(**friction, **tissue), swing(0.7)
    done = simulate(model, motion)
    exact = radau(model, motion)
    np.testing.assert_allclose(done.output, model.output(exact, motion), atol=2e-3)
    np.testing.assert_allclose(done.states[1], exact[1], atol=0.02)


def test_the_error_falls_with_the_square_of_the_step() -> None:
    model = LumpedOnTissue(**SMOOTH, **TISSUES[0])
    fine = simulate(model, swing(rate_hz=3200.0)).states[1, ::64]
    errors = [
        np.abs(simulate(model, swing(rate_hz=rate)).states[1, :: round(rate / 50)] - fine).max() for rate in (50, 100)
    ]
    assert 3 < errors[0] / errors[1] < 5


@given(st.sampled_from([CASE_1, SMOOTH]), st.floats(0.02, 2), st.floats(1e-3, 0.3))
@settings(max_examples=10)
def test_forces_on_the_tissue_are_in_balance(friction: dict[str, float], stiffness: float, damping: float) -> None:
    model = LumpedOnTissue(**friction, stiffness=stiffness, damping=damping)
    motion = swing(rate_hz=100.0)
    states = simulate(model, motion).states
    force = model.output(states, motion)
    inertia = model.mass * np.gradient(states[2], motion.time_s)
    held = stiffness * states[1] + damping * states[2]
    jumps = np.abs(inertia) > 5e-4
    assert jumps.mean() < 0.02
    np.testing.assert_allclose(force[~jumps], held[~jumps], atol=2e-3)


def test_rigid_tissue_is_the_friction_alone() -> None:
    motion = swing()
    alone = simulate(LumpedLuGre(**CASE_1), motion).output
    apart = [
        np.abs(simulate(LumpedOnTissue(**CASE_1, stiffness=1000.0, damping=damping), motion).output - alone).max()
        for damping in (10.0, 100.0)
    ]
    assert apart[1] < 4e-3
    assert apart[0] > 3 * apart[1]


def test_viscous_friction_has_the_lag_of_a_spring_and_two_dampers() -> None:
    """With F = b w the tissue is linear: w/v = (k + i om c)/(k + i om (b + c))."""
    b, k, c, omega = 0.05, 0.1, 0.02, 0.2 * np.pi
    model = LumpedOnTissue(
        sigma0=1e-4, sigma1=1e-5, sigma2=b, mu_c=1e-4, mu_s=1e-4, alpha=0.1, stiffness=k, damping=c, mass=1e-9
    )
    motion = swing(4.0)
    settled = slice(6000, None)
    relative = motion.velocity_mm_s - simulate(model, motion).states[2]
    late = lag_rad(0.1, motion.time_s[settled], relative[settled], motion.velocity_mm_s[settled])
    expected = -np.angle((k + 1j * omega * c) / (k + 1j * omega * (b + c)))
    assert late == pytest.approx(float(expected), abs=1e-3)


@dataclass(frozen=True, kw_only=True)
class Bingham(LinearStateModel):
    """Friction of another kind: a lagged dry one, and a damper."""

    name: ClassVar[str] = "bingham"
    channel: ClassVar = LumpedLuGre.channel
    yield_n: float = parameter("N", 1e-3, 10, "dry friction")
    viscous: float = parameter("N s/mm", 1e-6, 1, "damper")

    def coefficients(self, motion: Motion) -> tuple[Array, Array]:
        velocity = np.asarray(motion.velocity_mm_s, float)
        return 20 * np.tanh(velocity), np.full_like(velocity, 20.0)

    def output(self, state: Array, motion: Motion) -> Array:
        return np.asarray(self.yield_n * state[0] + self.viscous * motion.velocity_mm_s)


@dataclass(frozen=True, kw_only=True)
class BinghamOnTissue(MovingTissue):
    name: ClassVar[str] = "bingham_on_tissue"

    def friction(self) -> Bingham:
        return Bingham(yield_n=0.3, viscous=0.01)


def test_any_friction_with_a_linear_state_can_be_coupled() -> None:
    model = BinghamOnTissue(stiffness=0.1, damping=0.02)
    motion = swing(0.6, 50.0)
    np.testing.assert_allclose(simulate(model, motion).states[1], radau(model, motion)[1], atol=0.02)


@pytest.mark.parametrize("profile", [Profile.CONSTANT, Profile.ISOSCELES])
@pytest.mark.parametrize("gamma", [1.0, 1.5])
def test_the_fast_law_is_the_slow_one(profile: Profile, gamma: float) -> None:
    lumped = LumpedOnTissue(**CASE_1, **TISSUES[0], profile=profile, gamma=gamma)
    motion = swing(0.5, 100.0, offset_mm=70.0 if profile is Profile.CONSTANT else 38.0)
    slow = PointwiseLaw(lumped.friction(), motion)
    fast = lumped.law(motion)
    for sample, w in ((0, 3.0), (30, -7.0), (120, 0.0), (249, 0.3)):
        forcing, rate = slow.coefficients(sample, w)
        assert fast.coefficients(sample, w) == pytest.approx((forcing, rate), rel=1e-12)
        bending_rate = forcing - rate * 0.2
        expected = slow.force(sample, w, 0.2, bending_rate)
        assert fast.force(sample, w, 0.2, bending_rate) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("beta", [Beta.TRANSPORT, Beta.ABSOLUTE])
def test_the_fast_law_of_the_averaged_model_is_the_slow_one(beta: Beta) -> None:
    model = AveragedOnTissue(**CASE_1, **TISSUES[0], beta=beta)
    motion = swing(0.3, 100.0, offset_mm=60.0)
    slow, fast = PointwiseLaw(model.friction(), motion), model.law(motion)
    for sample, w in ((0, 3.0), (30, -7.0), (120, 0.0)):
        assert fast.coefficients(sample, w) == pytest.approx(slow.coefficients(sample, w), rel=1e-12)


def test_a_state_goes_on_where_it_was() -> None:
    model, motion = LumpedOnTissue(**CASE_1, **TISSUES[0]), swing()
    whole = simulate(model, motion)
    rest = simulate(model, motion[700:], whole.states[:, 700])
    np.testing.assert_allclose(rest.states, whole.states[:, 700:], rtol=1e-9, atol=1e-9)


def test_a_needle_that_starts_fast_starts_in_balance() -> None:
    model = LumpedOnTissue(**SMOOTH, **TISSUES[0])
    motion = Motion.sampled(np.arange(20) / 200, 100 + np.arange(20) / 20, np.full(20, 10.0))
    state = model.initial_state(motion)
    assert float(model.output(state, motion[0])) == pytest.approx(0.02 * state[2], abs=1e-9)
    assert 0 < state[2] < 10


def test_the_first_root_is_where_the_force_drives_to() -> None:
    def three_roots(x: float) -> float:
        return (x - 1) * (x - 2) * (x - 3)

    assert first_root(three_roots, 5.0) == pytest.approx(3)
    assert first_root(three_roots, 1.9) == pytest.approx(1)
    assert first_root(three_roots, 2.1) == pytest.approx(3)
    assert first_root(three_roots, -4.0) == pytest.approx(1)
    assert np.isnan(first_root(lambda x: 1.0 + x * x, 0.0))


def test_a_state_without_bound_is_nan_and_not_an_error() -> None:
    model = LumpedOnTissue(**{**SMOOTH, "sigma2": -8.0}, **TISSUES[0])
    done = simulate(model, swing())
    assert not done.finite
    assert np.isnan(done.output[-1])


def test_bad_tissue_is_refused() -> None:
    with pytest.raises(ModelError) as raised:
        LumpedOnTissue(**CASE_1, stiffness=-1.0, damping=float("nan"))
    assert {each.key for each in raised.value.mistakes} == {"stiffness", "damping"}
