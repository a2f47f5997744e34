"""Screening uses amplitudes within the bounds of each effect."""

from __future__ import annotations

import numpy as np
import pytest

from needleplan.diagnosis import FittedEffect, Library
from needleplan.diagnosis.calibration import Calibration, calibrate
from needleplan.diagnosis.catalogue import allowed_amplitudes, screen, whitened_sensitivities
from needleplan.diagnosis.data import fit_axes
from needleplan.diagnosis.joint_fit import fit_jointly
from needleplan.diagnosis.likelihood import JointLikelihood
from needleplan.models.effects import effect_named
from needleplan.signals import Role
from tests.diagnosis.trials import BASE, recordings

LIBRARY = Library([effect_named(name) for name in ("relaxation", "bristle", "viscous")], BASE)
TRUTH = {"size": 0.8, "time_s": 1.2, "recovery_mm": 0.1}


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    data = recordings({"relaxation": TRUTH}, seed=4)
    by = {role: [each for each in data if each.role is role] for role in Role}
    return calibrate(BASE, by[Role.TRAIN], by[Role.HOLDOUT], fit_axes([[each["force_n"] for each in by[Role.NOISE]]]))


def test_a_share_is_no_more_than_the_whole(calibration: Calibration) -> None:
    base = JointLikelihood([trial.whitened for trial in calibration.training])
    entries = LIBRARY.entries([trial.motion for trial in calibration.training])
    columns = whitened_sensitivities(calibration, LIBRARY, calibration.training, entries)
    scores = base.scores(columns)
    sizes = allowed_amplitudes(scores.amplitudes(), entries)
    relaxation = next(each for each in entries if each.effect.name == "relaxation")
    part = slice(relaxation.first, relaxation.last)
    assert scores.amplitudes()[:, part].max() > 1.0 == sizes[:, part].max()
    assert sizes[:, part].min() >= 0.0
    free, bound = scores.gains()[0], scores.gains(sizes)[0]
    assert (bound <= free + 1e-6).all()
    inside = (scores.amplitudes() == sizes).all(axis=0)
    assert inside.any()
    np.testing.assert_allclose(bound[inside], free[inside], rtol=1e-9)
    best = screen(base, columns, entries)[0]
    assert best.effect.name == "relaxation"
    assert 0 < best.values["size"] <= 1.0
    assert best.likelihood_gain == pytest.approx(bound[part].max())


def test_below_the_smallest_guess_an_effect_is_linear(calibration: Calibration) -> None:
    entries = LIBRARY.entries([trial.motion for trial in calibration.training])
    bristle = next(each for each in entries if each.effect.name == "bristle")
    reference_amplitudes = bristle.reference_amplitudes()
    sizes = np.zeros((1, max(each.last for each in entries)))
    sizes[0, bristle.first : bristle.last] = 0.1 * reference_amplitudes
    allowed = allowed_amplitudes(sizes, entries)[0, bristle.first : bristle.last]
    detection_limits = reference_amplitudes == reference_amplitudes.min()
    np.testing.assert_allclose(allowed[detection_limits], 0.1 * reference_amplitudes.min())
    assert not allowed[~detection_limits].any()


def test_a_fit_that_still_gains_continues(calibration: Calibration) -> None:
    base = JointLikelihood([trial.whitened for trial in calibration.training])
    effect = effect_named("relaxation")
    near = fit_jointly([FittedEffect(effect, TRUTH)], calibration, base)
    far = fit_jointly([FittedEffect(effect, {**TRUTH, "size": 1.0, "time_s": 6.0})], calibration, base)
    assert far.likelihood_gain == pytest.approx(near.likelihood_gain, abs=2.0)
    assert far.effects[0].values["time_s"] == pytest.approx(TRUTH["time_s"], rel=0.1)
