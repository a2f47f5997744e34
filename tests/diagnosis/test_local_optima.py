"""Effects with several local optima: training and held-out trials together choose one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from needleplan.diagnosis import FittedEffect, Gates, Library, selection_round
from needleplan.diagnosis.calibration import calibrate
from needleplan.diagnosis.catalogue import allowed_amplitudes, local_optima, screen, whitened_sensitivities
from needleplan.diagnosis.data import fit_axes
from needleplan.diagnosis.joint_fit import JointFit, fit_jointly
from needleplan.diagnosis.likelihood import JointLikelihood
from needleplan.diagnosis.selection_round import Search, run_round
from needleplan.models.effects import effect_named
from needleplan.signals import Role
from tests.diagnosis.trials import BASE, recordings

TRUTH = {"frequency_hz": 0.256, "phase_rad": 1.9, "rest": 1.0, "size": 0.04}
BREATH = effect_named("respiration")
LIBRARY = Library([BREATH, effect_named("viscous")], BASE)


@pytest.fixture(scope="module")
def search() -> Search:
    data = recordings({"respiration": TRUTH}, seed=3)
    by = {role: [each for each in data if each.role is role] for role in Role}
    noise = fit_axes([[each["force_n"] for each in by[Role.NOISE]]])
    calibration = calibrate(BASE, by[Role.TRAIN], by[Role.HOLDOUT], noise)
    entries = LIBRARY.entries([trial.motion for trial in calibration.training])
    first = whitened_sensitivities(calibration, LIBRARY, calibration.training, entries)
    base = JointLikelihood([trial.whitened for trial in calibration.training])
    return Search(calibration, LIBRARY, entries, base, first, (), Gates(), 0)


def test_each_value_has_one_local_optimum_and_screening_returns_the_best(search: Search) -> None:
    found = local_optima(search.base, search.sensitivities, search.entries, BREATH, "frequency_hz")
    each = next(each for each in search.entries if each.effect is BREATH)
    scores = search.base.scores(search.sensitivities)
    gains = scores.gains(allowed_amplitudes(scores.amplitudes(), search.entries))[0][each.first : each.last]
    frequencies = np.array([values["frequency_hz"] for values in each.grid])
    assert [hill.values["frequency_hz"] for hill in found] == sorted(
        set(frequencies), key=lambda hertz: -gains[frequencies == hertz].max()
    )
    for hill in found:
        assert hill.likelihood_gain == pytest.approx(gains[frequencies == hill.values["frequency_hz"]].max())
    best = next(one for one in screen(search.base, search.sensitivities, search.entries) if one.effect is BREATH)
    assert found[0] == best


def test_other_optima_are_fitted_if_the_best_is_refuted(search: Search, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = run_round(search, None, 0.0).ranked[0]
    assert plain.newest.name == "respiration"
    assert not plain.refuted
    judged = selection_round._validated
    asked: list[int] = []

    def refuted_at_first(
        search: Search, taken: JointFit | None, ranked: Sequence[JointFit], needed: float
    ) -> list[JointFit]:
        asked.append(len(ranked))
        found = judged(search, taken, ranked, needed)
        return [replace(each, refuted=True) for each in found] if len(asked) == 1 else found

    monkeypatch.setattr(selection_round, "_validated", refuted_at_first)
    found = run_round(search, None, 0.0).ranked[0]
    assert len(asked) == 2
    assert asked[1] >= 1
    assert found.newest.name == "respiration"
    assert not found.refuted
    assert found.newest.bic_gain == pytest.approx(plain.newest.bic_gain, abs=1.0)
    assert found.effects[0].values["frequency_hz"] == pytest.approx(TRUTH["frequency_hz"], rel=0.03)


def test_only_nonlinear_effects_have_local_optima(search: Search) -> None:
    assert search.has_local_optima(BREATH)
    assert not search.has_local_optima(effect_named("viscous"))


def test_a_fit_does_not_leave_a_wrong_optimum(search: Search) -> None:
    # What makes the others worth a trial: from another frequency a fit does not come to the true one.
    other = {**TRUTH, "frequency_hz": 0.45, "phase_rad": 0.0}
    far = fit_jointly([FittedEffect(BREATH, other)], search.calibration, search.base)
    near = fit_jointly([FittedEffect(BREATH, TRUTH)], search.calibration, search.base)
    assert far.likelihood_gain < near.likelihood_gain - 50
