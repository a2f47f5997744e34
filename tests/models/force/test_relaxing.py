"""The relaxing force beside a slow twin: the equations by SciPy, from event to event."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from needleplan.estimation import FilterSample, JointFilter, NumericJointSystem, SampleUse
from needleplan.models import RelaxingForce, fit, simulate
from needleplan.signals import Array, Motion, Record

TWO = RelaxingForce(
    contact_mm=2.0, stiffness=0.03, growth=0.12, branch_1=1.5, time_1_s=0.8, branch_2=0.7, time_2_s=9.0,
    friction=0.01, cutting=0.1, boundary_1_mm=11.0, ratio_1=2.0, boundary_2_mm=15.0, ratio_2=0.5, breaks_2=0.0,
)  # fmt: skip
ONE = replace(TWO, branch_2=0.0)
SPRING = replace(ONE, branch_1=0.0)

# In, a dwell, on, out, in again beyond both boundaries, a dwell.
KNOTS_S = np.array([0.0, 2.0, 5.0, 6.0, 7.5, 9.0, 11.0, 14.0])
KNOTS_MM = np.array([0.0, 9.0, 9.0, 13.0, 6.0, 14.0, 19.0, 19.0])


def motion(rate_hz: float) -> Motion:
    time = np.arange(round(14 * rate_hz) + 1) / rate_hz
    return Motion.sampled(time, np.interp(time, KNOTS_S, KNOTS_MM))


def twin(model: RelaxingForce, times: Array) -> Array:
    """The sum of E, q1, q2 and R after the first time, from their rates of change."""
    cuts = set(KNOTS_S.tolist())
    for s0, s1, x0, x1 in zip(KNOTS_S, KNOTS_S[1:], KNOTS_MM, KNOTS_MM[1:], strict=False):
        cuts |= {s0 + (s1 - s0) * (at - x0) / (x1 - x0) for at in (2.0, 11.0, 13.0, 15.0) if (at - x0) * (at - x1) < 0}
    found, state, deepest, a = np.zeros(times.size), np.zeros(4), 0.0, 2.0
    for begin, end in zip(sorted(cuts), sorted(cuts)[1:], strict=False):
        x0, x1 = np.interp([begin, end], KNOTS_S, KNOTS_MM)
        if a == 2.0 and x0 >= 11.0 - 1e-12:  # the capsule breaks
            a, state = 11.0, np.array([0.0, 0.0, 0.0, state.sum()])
        v, fresh = (x1 - x0) / (end - begin), bool(x1 > deepest)
        m = 0.5 if x0 + x1 > 30 else 2.0 if x0 + x1 > 22 else 1.0

        def rates(t: float, y: Array, x0: float = x0, v: float = v, m: float = m, fresh: bool = fresh,
                  begin: float = begin, a: float = a) -> Array:  # fmt: skip
            x = x0 + v * (t - begin)
            load = m * model.stiffness * np.exp(model.growth * (x - a)) * v if x > a + 1e-12 else 0.0
            return np.array([
                load, model.branch_1 * load - y[1] / model.time_1_s, model.branch_2 * load - y[2] / model.time_2_s,
                -y[3] * v / model.release_mm if fresh else 0.0,
            ])  # fmt: skip

        inside = (times > begin) & (times <= end + 1e-12)
        wanted = [*np.minimum(times[inside], end), end]
        solved = solve_ivp(rates, (begin, end), state, t_eval=sorted(set(wanted)), rtol=1e-9, atol=1e-11)
        found[inside] = np.interp(np.minimum(times[inside], end), solved.t, solved.y.sum(axis=0))
        state, deepest = solved.y[:, -1], max(deepest, x1)
    return found


@pytest.mark.parametrize("model", [SPRING, ONE, TWO], ids=["spring", "one branch", "two branches"])
def test_beside_the_equations(model: RelaxingForce) -> None:
    driven = motion(20.0)
    smooth = replace(model, friction=0.0, cutting=0.0)
    np.testing.assert_allclose(simulate(smooth, driven).output, twin(model, driven.time_s), atol=1e-7)


def test_the_sampling_rate_does_not_matter() -> None:
    coarse, fine = simulate(TWO, motion(2.0)), simulate(TWO, motion(500.0))
    np.testing.assert_allclose(fine.states[:, ::250], coarse.states, atol=1e-9)


def test_a_state_goes_on_where_it_was() -> None:
    driven = motion(20.0)
    whole = simulate(TWO, driven)
    for cut in (60, 115, 170, 230):
        rest = simulate(TWO, driven[cut:], whole.states[:, cut])
        np.testing.assert_allclose(rest.states, whole.states[:, cut:], atol=1e-12)


def test_derivative_is_that_of_the_step() -> None:
    driven = motion(2000.0)
    states = simulate(TWO, driven).states
    rates = TWO.derivative(states, driven)
    for sample in (1000, 6000, 10200, 13000, 16000, 20500, 26000):  # between the events
        slope = (states[:, sample + 1] - states[:, sample - 1]) * 1000
        np.testing.assert_allclose(rates[:, sample], slope, atol=2e-3 * (1 + np.abs(slope)).max())


def test_friction_and_cutting() -> None:
    """Beyond the capsule friction follows the direction; the tip cuts only in fresh tissue, on the way in."""
    driven = motion(200.0)
    sliding = simulate(TWO, driven).output - simulate(replace(TWO, friction=0.0, cutting=0.0), driven).output
    at = lambda seconds: sliding[round(200 * seconds)]  # noqa: E731
    assert at(5.0) == 0.0
    assert at(5.95) == pytest.approx(0.01 * 1.8 + 0.1, abs=1e-3)
    assert at(6.1) == pytest.approx(-0.01 * (13 - 0.7 / 1.5 - 11), abs=1e-3)
    assert at(8.45) == pytest.approx(
        0.01 * (6 + 8 * 0.95 / 1.5 - 11) + 0.1 * np.exp(-(13 - 6 - 8 * 0.95 / 1.5) / 0.3), abs=1e-3
    )
    assert at(11.0) == pytest.approx(0.01 * 8 + 0.1, abs=1e-6)


def test_the_force_is_continuous_in_the_depth_of_the_capsule() -> None:
    driven = motion(10.0)
    before, after = (simulate(replace(TWO, boundary_1_mm=11.0 + d), driven).output for d in (-1e-7, 1e-7))
    np.testing.assert_allclose(before, after, atol=1e-5)


def test_branches_are_identified_with_a_dwell() -> None:
    driven = motion(50.0)
    noise = np.random.default_rng(5).normal(0.0, 0.003, len(driven))
    record = Record(
        {"time_s": driven.time_s, "depth_mm": driven.depth_mm, "force_n": simulate(ONE, driven).output + noise}
    )
    names = ("stiffness", "growth", "branch_1", "time_1_s", "boundary_1_mm", "ratio_1", "friction", "cutting")
    start = replace(ONE, stiffness=0.05, growth=0.06, branch_1=0.5, time_1_s=2.0, boundary_1_mm=11.3, ratio_1=1.0)
    found = fit(start, record, free=names)
    assert found.ok
    for name in names:
        each = found.estimates[name]
        assert each.identified, name
        assert each.value == pytest.approx(getattr(ONE, name), rel=0.05), name


def test_an_online_filter_takes_it() -> None:
    driven = motion(20.0)[:60]
    measured = simulate(ONE, driven).output
    start = replace(ONE, stiffness=0.045)
    joint = NumericJointSystem(start, ["stiffness"])
    online = JointFilter(joint, start, variance=1e-6, sd=0.5)
    steps = [
        online.update(FilterSample(float(t), float(x), float(f), float(v)))
        for t, x, f, v in zip(driven.time_s, driven.depth_mm, measured, driven.velocity_mm_s, strict=True)
    ]
    assert steps[-1].use is SampleUse.USED
    assert online.model.values()["stiffness"] == pytest.approx(0.03, rel=0.02)
