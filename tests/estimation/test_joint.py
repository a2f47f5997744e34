import numpy as np
import pytest

from needleplan.errors import ModelError
from needleplan.estimation import FilterSample, JointFilter, JointForce, JointSystem, NumericJointSystem
from needleplan.models import (
    AveragedLuGre,
    Bicycle,
    Karnopp,
    LumpedLuGre,
    Profile,
    QuasiStatic,
    RelaxingForce,
    simulate,
)
from needleplan.models.force import ForceModel1
from needleplan.signals import Array, Motion, insertion_cycles
from tests.estimation.insertions import MODEL
from tests.models.lag import Lag, SteppedLag

MOTION = insertion_cycles(80.0, 10.0)


def slow_derivatives(joint: JointSystem, x: Array, before: Motion, after: Motion) -> tuple[Array, Array]:
    steps = 1e-6 * np.maximum(np.abs(x), 1e-2)
    ups, downs = ([x + sign * step * row for step, row in zip(steps, np.eye(x.size), strict=True)] for sign in (1, -1))
    pairs = list(zip(ups, downs, steps, strict=True))
    moved = [
        (joint.predict(up, before, after)[0] - joint.predict(down, before, after)[0]) / (2 * h) for up, down, h in pairs
    ]
    seen = [(joint.measure(up, after)[0] - joint.measure(down, after)[0]) / (2 * h) for up, down, h in pairs]
    return np.array(moved).T, np.array(seen)


@pytest.mark.parametrize("model", [
    MODEL, MODEL.with_values(f2=0.03), ForceModel1(**{**MODEL.values(), "beta": 0.02}),
    ForceModel1(**{**MODEL.values(), "f2": 0.05}),
])  # fmt: skip
@pytest.mark.parametrize("sample", [300, 1200, 2000, 3200])
def test_force_derivatives_in_coordinates(model: ForceModel1, sample: int) -> None:
    joint = JointForce(model)
    x = joint.initial(model, MOTION)
    x[0] = 0.1
    before, after = MOTION[sample], MOTION[sample + 1]
    moved, seen = slow_derivatives(joint, x, before, after)
    np.testing.assert_allclose(joint.predict(x, before, after)[1], moved, atol=1e-7)
    np.testing.assert_allclose(joint.measure(x, after)[1], seen, atol=1e-7)


def test_force_coordinates_go_and_come_back() -> None:
    joint = JointForce(MODEL)
    x = joint.initial(MODEL, MOTION)
    assert joint.model(x) == joint.model(joint.initial(joint.model(x), MOTION))
    for name, value in joint.values(x).items():
        assert value == pytest.approx(getattr(MODEL, name), rel=1e-12)


def test_no_coordinate_makes_g_negative() -> None:
    model = ForceModel1(**{**MODEL.values(), "beta": 0.02})
    joint = JointForce(model)
    for x in np.random.default_rng(0).normal(0, 8, (200, 7)):
        values = joint.values(x)
        assert values["f1"] > 0
        assert values["f1"] + values["f2"] > 0


def test_any_model_becomes_a_joint_system() -> None:
    force, numeric = JointForce(MODEL), NumericJointSystem(MODEL)
    x = numeric.initial(MODEL, MOTION)
    x[0] = 0.1
    same = force.initial(MODEL, MOTION)
    same[0] = 0.1
    before, after = MOTION[900], MOTION[901]
    numerically, closed = numeric.predict(x, before, after), force.predict(same, before, after)
    assert numerically[0][0] == pytest.approx(closed[0][0], rel=1e-6)
    by_f1 = 1 + force.free.index("f1")
    scale = np.ones(6)
    scale[by_f1] = (MODEL.f1 + MODEL.f2) / MODEL.f1  # ln f1 there, ln(f1 + f2) here
    np.testing.assert_allclose(numerically[1][0] * scale, closed[1][0], atol=1e-6)
    seen, known = numeric.measure(x, after)[1], force.measure(same, after)[1]
    np.testing.assert_allclose(seen * scale, known, atol=1e-6)


@pytest.mark.parametrize("model", [Lag(0.2, 0.4, 0.05), SteppedLag(0.2, 0.4)])
def test_a_numeric_joint_steps_as_the_simulation(model: Lag | SteppedLag) -> None:
    joint = NumericJointSystem(model)
    done = simulate(model, MOTION)
    x = joint.initial(model, MOTION)
    x[0] = done.states[0, 500]
    stepped, change = joint.predict(x, MOTION[500], MOTION[501])
    assert stepped[0] == pytest.approx(done.states[0, 501], rel=1e-12)
    np.testing.assert_array_equal(change[1:, 0], 0)
    assert change[0, 0] == pytest.approx(np.exp(-0.005 / 0.4), rel=1e-6)
    assert joint.measure(x, MOTION[500])[0] == pytest.approx(done.output[500], rel=1e-12)


def test_what_cannot_be_joint_is_refused() -> None:
    with pytest.raises(ModelError, match="f1 and f1"):
        JointForce(MODEL.with_values(f1=0.001))
    with pytest.raises(ModelError, match="must be one of"):
        NumericJointSystem(MODEL, ["sigma3"])


# A model of every kind for which the points of a step are computed at once, and its motion.
AT_ONCE = {
    "force model 1": ForceModel1(**{**MODEL.values(), "beta": 0.02}),
    "force model 2": MODEL,
    "Karnopp": Karnopp(mu_c=0.5, sigma2=0.02),
    "quasi-static": QuasiStatic(mu_c=0.7, sigma2=0.017, sigma0=1.3, mu_s=0.04, alpha=0.08),
    "lumped": LumpedLuGre(mu_c=0.73, sigma2=0.016, sigma0=1.3, sigma1=0.46, mu_s=0.034, alpha=0.09),
    "lumped by length": LumpedLuGre(
        mu_c=0.73, sigma2=0.016, sigma0=1.3, sigma1=0.46, mu_s=0.034, alpha=0.09, profile=Profile.ISOSCELES
    ),
    "averaged": AveragedLuGre(mu_c=0.73, sigma2=0.016, sigma0=1.3, sigma1=0.46, mu_s=0.034, alpha=0.09),
    "bicycle": Bicycle(0.01, 0.02, 0.1),
    "relaxing": RelaxingForce(
        contact_mm=3.0, stiffness=0.03, growth=0.1, branch_1=1.0, time_1_s=0.5, boundary_1_mm=30.0, friction=0.01
    ),
    "stepped": SteppedLag(0.2, 0.4),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", AT_ONCE)
def test_points_at_once_beside_one_by_one(kind: str) -> None:
    """The same filter with both ways: estimates and covariances agree to 1e-9 after 60 samples."""
    model = AT_ONCE[kind]
    motion = insertion_cycles(40.0, 20.0, rate_hz=50.0)[:60]
    noise = np.random.default_rng(1).normal(0.0, 0.01, len(motion))
    measured = simulate(model, motion).output + noise
    filters = []
    for at_once in (True, False):
        joint = NumericJointSystem(model, at_once=at_once)
        filters.append(JointFilter(joint, model, variance=1e-3, sd=0.1, settle=2))
        rows = zip(motion.time_s, motion.depth_mm, measured, motion.velocity_mm_s, strict=True)
        for row in rows:
            filters[-1].update(FilterSample(*map(float, row)))
        if at_once:
            assert (joint._steps_at_once, joint._outputs_at_once) == (True if joint.states else None, True)
    np.testing.assert_allclose(filters[0].x, filters[1].x, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(filters[0].covariance, filters[1].covariance, rtol=1e-6, atol=1e-12)


class Branching(SteppedLag):
    """A model with a condition on a parameter, which arrays cannot take."""

    def derivative(self, state: Array, motion: Motion) -> Array:
        gain = self.gain if self.gain > 0.1 else 0.1
        return (gain * motion.velocity_mm_s - state) / self.time_constant


class Summing(SteppedLag):
    """A model that mixes the points without an error."""

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        return state[0] + 0 * np.sum(self.gain) + np.mean(self.time_constant)


@pytest.mark.parametrize("kind", [Branching, Summing])
def test_a_model_that_does_not_broadcast_is_computed_point_by_point(kind: type[SteppedLag]) -> None:
    model = kind(0.2, 0.4)
    fast, slow = NumericJointSystem(model), NumericJointSystem(model, at_once=False)
    x = fast.initial(model, MOTION)
    slow.initial(model, MOTION)
    for sample in (400, 401):
        for one, other in zip(
            (*fast.predict(x, MOTION[sample], MOTION[sample + 1]), *fast.measure(x, MOTION[sample])),
            (*slow.predict(x, MOTION[sample], MOTION[sample + 1]), *slow.measure(x, MOTION[sample])),
            strict=True,
        ):
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
    assert (fast._steps_at_once, fast._outputs_at_once) == ((False, True) if kind is Branching else (True, False))
