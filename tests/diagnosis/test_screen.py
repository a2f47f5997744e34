"""Columns are judged with sizes that an effect may have."""

from __future__ import annotations

import numpy as np
import pytest

from needleplan.diagnosis import Library
from needleplan.diagnosis.calibrate import Calibration, calibrate
from needleplan.diagnosis.noise import fit_axes
from needleplan.diagnosis.refit import Added, refit
from needleplan.diagnosis.rounds import whitened_columns
from needleplan.diagnosis.screen import allowed_sizes, screen
from needleplan.diagnosis.space import Space
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
    base = Space([case.block for case in calibration.training])
    candidates = LIBRARY.candidates([case.motion for case in calibration.training])
    columns = whitened_columns(calibration, LIBRARY, calibration.training, candidates)
    scores = base.scores(columns)
    sizes = allowed_sizes(scores.sizes(), candidates)
    relaxation = next(each for each in candidates if each.effect.name == "relaxation")
    part = slice(relaxation.first, relaxation.last)
    assert scores.sizes()[:, part].max() > 1.0 == sizes[:, part].max()
    assert sizes[:, part].min() >= 0.0
    free, bound = scores.gains()[0], scores.gains(sizes)[0]
    assert (bound <= free + 1e-6).all()
    inside = (scores.sizes() == sizes).all(axis=0)
    assert inside.any()
    np.testing.assert_allclose(bound[inside], free[inside], rtol=1e-9)
    best = screen(base, columns, candidates)[0]
    assert best.effect.name == "relaxation"
    assert 0 < best.values["size"] <= 1.0
    assert best.gain == pytest.approx(bound[part].max())


def test_below_the_smallest_guess_an_effect_is_linear(calibration: Calibration) -> None:
    candidates = LIBRARY.candidates([case.motion for case in calibration.training])
    bristle = next(each for each in candidates if each.effect.name == "bristle")
    guessed = bristle.guessed()
    sizes = np.zeros((1, max(each.last for each in candidates)))
    sizes[0, bristle.first : bristle.last] = 0.1 * guessed
    allowed = allowed_sizes(sizes, candidates)[0, bristle.first : bristle.last]
    smallest = guessed == guessed.min()
    np.testing.assert_allclose(allowed[smallest], 0.1 * guessed.min())
    assert not allowed[~smallest].any()


def test_a_fit_that_climbs_goes_on(calibration: Calibration) -> None:
    base = Space([case.block for case in calibration.training])
    effect = effect_named("relaxation")
    near = refit([Added(effect, TRUTH)], calibration, base)
    far = refit([Added(effect, {**TRUTH, "size": 1.0, "time_s": 6.0})], calibration, base)
    assert far.gain == pytest.approx(near.gain, abs=2.0)
    assert far.added[0].values["time_s"] == pytest.approx(TRUTH["time_s"], rel=0.1)
