from __future__ import annotations

import pytest

from needleplan.diagnosis import FittedEffect
from needleplan.diagnosis.calibration import Calibration, calibrate
from needleplan.diagnosis.data import fit_axes
from needleplan.diagnosis.joint_fit import fit_jointly
from needleplan.diagnosis.likelihood import JointLikelihood
from needleplan.models import Channel
from needleplan.models.effects import effect_named
from needleplan.signals import Role
from tests.diagnosis.tip_trials import BASE, recordings

TRUTH = {"size": -1e-3, "fading_mm": 60.0}


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    data = recordings({"gravity": TRUTH}, seed=5)
    noise = [each for each in data if each.role is Role.NOISE]
    training = [each for each in data if each.role is Role.TRAIN]
    return calibrate(BASE, training, [], fit_axes([[each[name] for each in noise] for name in Channel.TIP.columns]))


@pytest.mark.parametrize("start", [20.0, 400.0])
def test_parameters_that_trade_with_one_another_arrive_together(calibration: Calibration, start: float) -> None:
    base = JointLikelihood([trial.whitened for trial in calibration.training])
    effect = effect_named("gravity")
    far = fit_jointly([FittedEffect(effect, {**TRUTH, "fading_mm": start})], calibration, base)
    near = fit_jointly([FittedEffect(effect, TRUTH)], calibration, base)
    assert far.likelihood_gain == pytest.approx(near.likelihood_gain, abs=1.0)
    assert far.effects[0].values["fading_mm"] == pytest.approx(TRUTH["fading_mm"], rel=0.25)


def test_a_bound_holds_one_parameter_and_the_others_go_on(calibration: Calibration) -> None:
    base = JointLikelihood([trial.whitened for trial in calibration.training])
    effect = effect_named("gravity")
    within = {"fading_mm": (100.0, 400.0)}
    held = fit_jointly([FittedEffect(effect, {**TRUTH, "size": -1e-4, "fading_mm": 100.0}, within)], calibration, base)
    assert held.effects[0].values["fading_mm"] == pytest.approx(100.0)
    assert -1.2e-3 < held.effects[0].values["size"] < -3e-4
