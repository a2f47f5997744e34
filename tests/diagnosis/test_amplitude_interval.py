from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from needleplan.diagnosis import Library, diagnose
from needleplan.diagnosis._verdict import parameter_interval
from needleplan.diagnosis.joint_fit import JointFit, is_nonzero
from needleplan.models.effects import effect_named
from needleplan.signals import Array
from tests.diagnosis.tip_trials import BASE, recordings


@pytest.fixture(scope="module")
def joint() -> JointFit:
    hidden = {"tracker_bias": {"size": 0.8, "direction_rad": 1.0}}
    found = diagnose(BASE, recordings(hidden, seed=3), library=Library([effect_named("tracker_bias")], BASE)).joint
    assert found is not None
    return found


def with_vector(joint: JointFit, vector: Array, covariance: Array) -> JointFit:
    """Return a fit whose size and direction are those of a vector, with a covariance of its two components."""
    (each,) = joint.effects
    size, angle = float(np.hypot(*vector)), float(np.arctan2(vector[1], vector[0]))
    polar = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle) / size, np.cos(angle) / size]])
    units = np.array([each.effect.parameters[name].typical for _, name in joint.coordinates])
    added = replace(each, values={"size": size, "direction_rad": angle})
    return replace(joint, effects=(added,), covariance=polar @ covariance @ polar.T / np.outer(units, units))


def test_a_round_ellipse_gives_the_linear_interval(joint: JointFit) -> None:
    there = with_vector(joint, np.array([0.6, 0.5]), 1e-4 * np.eye(2))
    size = there.effects[0].values["size"]
    np.testing.assert_allclose(parameter_interval(there, 0, "size"), size + 1.96 * 0.01 * np.array([-1, 1]), atol=1e-4)
    assert is_nonzero(there, 0)


def test_one_known_component_keeps_the_amplitude_from_zero(joint: JointFit) -> None:
    vague = with_vector(joint, np.array([0.4, 0.3]), np.diag([1.0, 1e-4]))
    low, high = parameter_interval(vague, 0, "size")
    assert low == pytest.approx(0.3 - 1.96 * 0.01, abs=0.002)
    assert high == pytest.approx(0.4 + 1.96, abs=0.03)
    assert vague.effects[0].values["size"] < 1.96 * vague.sd(0, "size")  # the linear interval would hold zero


def test_an_amplitude_that_may_be_zero_is_not_nonzero(joint: JointFit) -> None:
    weak = with_vector(joint, np.array([0.01, 0.0]), 1e-4 * np.eye(2))
    assert parameter_interval(weak, 0, "size")[0] == 0
    assert not is_nonzero(weak, 0)


def test_an_amplitude_correlated_with_a_length_is_nonzero() -> None:
    hidden = {"entry_rupture": {"size": 6.0, "length_mm": 2.0}}
    found = diagnose(BASE, recordings(hidden, seed=1), library=Library([effect_named("entry_rupture")], BASE)).joint
    assert found is not None
    row = found.coordinates.index((0, "size"))
    other = found.coordinates.index((0, "length_mm"))
    covariance = found.covariance.copy()
    covariance[row, row] *= 100  # and the correlation as near to one as to leave the precision of the size alone
    covariance[row, other] = covariance[other, row] = -np.sqrt(covariance[row, row] * covariance[other, other]) * 0.999
    vague = replace(found, covariance=covariance)
    size = vague.effects[0].values["size"]
    assert size < 1.96 * vague.sd(0, "size")
    assert is_nonzero(vague, 0)
    low, high = parameter_interval(vague, 0, "size")
    assert 0 < low < size < high
