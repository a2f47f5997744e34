from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from needleplan.errors import ModelError
from needleplan.models import Trajectory, simulate
from needleplan.models.force import (
    ForceModel1,
    ForceModel2,
    insertion_asymptote,
    regauged,
    retraction_asymptote,
    with_gauge,
)
from needleplan.signals import Motion, insertion_cycles
from needleplan_thesis.chapter2.forces import PUBLISHED_FORCES

SETS = {each.title: each for each in PUBLISHED_FORCES}
factor = st.floats(0.1, 10.0)


def run(title: str, **changes: float) -> Trajectory:
    chosen = SETS[title]
    motion = insertion_cycles(chosen.depth_mm, chosen.velocity_mm_s)
    return simulate(chosen.model.with_values(**changes), motion)


@pytest.mark.parametrize(("title", "peak", "peak_mm", "trough", "trough_mm", "last", "first_back"), [
    ("A/A 10 mm/s", 0.219, 6.8, 0.132, 19.4, 0.445, -0.218),
    ("A/A 6 mm/s", 0.180, 5.9, 0.093, 17.4, 0.346, -0.222),
])  # fmt: skip
def test_forward_oracles(
    title: str, peak: float, peak_mm: float, trough: float, trough_mm: float, last: float, first_back: float
) -> None:
    done = run(title)
    depth, force = done.motion.depth_mm, done.output
    half = np.flatnonzero(done.motion.direction > 0)[-1]
    top = np.argmax(force[: half // 4])
    bottom = top + np.argmin(force[top:half])
    assert force[top] == pytest.approx(peak, abs=1e-3)
    assert depth[top] == pytest.approx(peak_mm, abs=0.2)
    assert force[bottom] == pytest.approx(trough, abs=1e-3)
    assert depth[bottom] == pytest.approx(trough_mm, abs=0.2)
    assert force[half] == pytest.approx(last, abs=1e-3)
    assert force[half + 1] == pytest.approx(first_back, abs=1e-3)


def test_the_thin_needle_has_practically_no_drop() -> None:
    force = run("B/B 10 mm/s").output
    top = np.argmax(force[:400])
    assert force[top] == pytest.approx(0.078, abs=1e-3)
    assert force[top:1500].min() == pytest.approx(0.077, abs=1e-3)


def test_asymptotes() -> None:
    model, depth = SETS["A/A 10 mm/s"].model, np.array([80.0])
    assert insertion_asymptote(model, depth)[0] == pytest.approx(0.4446, abs=1e-4)
    assert retraction_asymptote(model, depth)[0] == pytest.approx(-0.2178, abs=1e-4)
    done = run("A/A 10 mm/s")
    deep = done.motion.depth_mm > 70
    forward, back = deep & (done.motion.direction > 0), deep & (done.motion.direction < 0)
    at = done.motion.depth_mm
    np.testing.assert_allclose(done.output[forward], insertion_asymptote(model, at[forward]), atol=1e-3)
    np.testing.assert_allclose(done.output[back], retraction_asymptote(model, at[back]), atol=1e-3)
    np.testing.assert_allclose(done.states[0][deep], (model.beta * model.g(at) / model.sigma0)[deep], rtol=2e-3)


@pytest.mark.parametrize("title", SETS)
def test_simulation_is_that_of_a_stiff_solver(title: str) -> None:
    chosen, done = SETS[title].model, run(title)
    motion = done.motion[::40]

    def change(time: float, z: np.ndarray) -> np.ndarray:
        depth = np.interp(time, done.motion.time_s, done.motion.depth_mm)
        return depth * (chosen.beta - chosen.sigma0 * z / (chosen.f1 + chosen.f2 * np.exp(-chosen.alpha * depth)))

    slow = solve_ivp(
        change, (0, motion.time_s[-1]), [0.0], "LSODA", motion.time_s, rtol=1e-8, atol=1e-10, max_step=0.05
    )
    np.testing.assert_allclose(done.output[::40], chosen.output(slow.y, motion), atol=2e-6)


@settings(max_examples=30, deadline=None)
@given(c=st.floats(0.02, 50), title=st.sampled_from(list(SETS)))
def test_the_gauge_leaves_the_force(c: float, title: str) -> None:
    chosen = SETS[title].model
    motion = insertion_cycles(80.0, SETS[title].velocity_mm_s, rate_hz=100)
    one, other = simulate(chosen, motion), simulate(regauged(chosen, c), motion)
    np.testing.assert_allclose(other.output, one.output, atol=1e-12)
    np.testing.assert_allclose(other.states, one.states / c, rtol=1e-10)
    assert with_gauge(regauged(chosen, c), chosen.beta).f1 == pytest.approx(chosen.f1, rel=1e-12)


@settings(max_examples=20, deadline=None)
@given(c=st.floats(0.1, 10))
def test_model_2_is_a_part_of_model_1(c: float) -> None:
    two = SETS["A/A 10 mm/s"].model
    motion = insertion_cycles(80.0, 10.0, rate_hz=50)
    one = ForceModel1(**with_gauge(two, 0.02 * c).values())
    np.testing.assert_allclose(simulate(one, motion).output, simulate(two, motion).output, atol=1e-12)


def test_what_is_free() -> None:
    free = {
        each.name: [name for name, what in each.parameters().items() if what.free]
        for each in (ForceModel1, ForceModel2)
    }
    assert free["force_model_1"] == ["sigma0", "sigma1", "sigma2", "f1", "f2", "alpha"]
    assert free["force_model_2"] == ["sigma0", "sigma1", "sigma2", "f1", "beta"]


def test_statements_of_the_text() -> None:
    base = run("A/A 10 mm/s")
    half = len(base.motion) // 2
    soft = run("A/A 10 mm/s", sigma0=0.5 * 7.9e-3)
    assert soft.output[: half // 2].max() > base.output[: half // 2].max()
    deep_back = slice(half + 1, half + 800)
    assert np.abs(soft.output[deep_back] - base.output[deep_back]).max() < 5e-3
    damped = run("A/A 10 mm/s", sigma1=2 * 2.46)
    change = np.abs(damped.output - base.output)[half + 1 :]
    depth = base.motion.depth_mm[half + 1 :]
    assert change[depth < 30].max() > 10 * change[depth > 60].max()
    near = base.output[half + 1 :][depth < 15]
    assert 0 < near.max() < 0.02  # the force of a retraction turns positive at the entry, by some mN


def test_as_printed_no_retraction_pulls() -> None:
    done = run("A/A 10 mm/s")
    printed = SETS["A/A 10 mm/s"].model.output_as_printed(done.states, done.motion)
    half = len(done.motion) // 2
    np.testing.assert_allclose(printed[: half + 1], done.output[: half + 1], atol=1e-15)
    deep = done.motion.depth_mm > 20
    assert printed[deep].min() > 0.05
    assert done.output.min() < -0.2


def test_a_dwell_keeps_the_last_direction() -> None:
    chosen = SETS["A/A 10 mm/s"].model
    motion = insertion_cycles(80.0, 10.0, dwell_s=1.0)
    force = simulate(chosen, motion).output
    dwell = (motion.velocity_mm_s == 0) & (motion.depth_mm > 79.9)
    assert np.ptp(force[dwell]) < 2e-3
    assert force[dwell].min() > 0.4


def test_improper_parameters_are_said_not_raised() -> None:
    chosen = SETS["A/A 10 mm/s"].model
    assert chosen.proper
    wrong = replace(chosen, f1=0.1 * 2.11e-2)
    assert not wrong.proper
    assert not run("A/A 10 mm/s", f1=0.1 * 2.11e-2).finite
    for c in (-1.0, float("nan")):
        with pytest.raises(ModelError, match="must be positive"):
            regauged(chosen, c)
    with pytest.raises(ModelError, match="beta"):
        with_gauge(chosen, 0.0)


def test_one_instant_is_one_sample() -> None:
    chosen, done = SETS["A/A 10 mm/s"].model, run("A/A 10 mm/s")
    instant: Motion = done.motion[1200]
    assert float(chosen.output(done.states[:, 1200], instant)) == pytest.approx(done.output[1200], abs=1e-15)
