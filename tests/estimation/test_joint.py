from __future__ import annotations

import numpy as np
import pytest

from needleplan.errors import ModelError
from needleplan.estimation import JointForce, JointSystem, NumericJointSystem
from needleplan.models import simulate
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
