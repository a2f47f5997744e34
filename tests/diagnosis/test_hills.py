"""An effect that fits as well at one place as at another: all data together choose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from needleplan.diagnosis import Gates, Library, rounds
from needleplan.diagnosis.calibrate import calibrate
from needleplan.diagnosis.noise import fit_axes
from needleplan.diagnosis.refit import Added, Joint, refit
from needleplan.diagnosis.rounds import Search, one_round, whitened_columns
from needleplan.diagnosis.screen import allowed_sizes, hills, screen
from needleplan.diagnosis.space import Space
from needleplan.diagnosis.step import Ranked
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
    candidates = LIBRARY.candidates([case.motion for case in calibration.training])
    first = whitened_columns(calibration, LIBRARY, calibration.training, candidates)
    base = Space([case.block for case in calibration.training])
    return Search(calibration, LIBRARY, candidates, base, first, (), Gates(), 0)


def test_there_is_one_hill_for_each_value_and_the_best_is_the_one_that_was_screened(search: Search) -> None:
    found = hills(search.base, search.first, search.candidates, BREATH, "frequency_hz")
    each = next(each for each in search.candidates if each.effect is BREATH)
    scores = search.base.scores(search.first)
    gains = scores.gains(allowed_sizes(scores.sizes(), search.candidates))[0][each.first : each.last]
    frequencies = np.array([values["frequency_hz"] for values in each.grid])
    assert [hill.values["frequency_hz"] for hill in found] == sorted(
        set(frequencies), key=lambda hertz: -gains[frequencies == hertz].max()
    )
    for hill in found:
        assert hill.gain == pytest.approx(gains[frequencies == hill.values["frequency_hz"]].max())
    best = next(one for one in screen(search.base, search.first, search.candidates) if one.effect is BREATH)
    assert found[0] == best


def test_where_the_best_does_not_hold_elsewhere_the_others_are_asked(
    search: Search, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = one_round(search, None, 0.0).ranked[0]
    assert plain.name == "respiration"
    assert not plain.vetoed
    judged = rounds._judged
    asked: list[int] = []

    def refuted_at_first(search: Search, taken: Joint | None, ranked: Sequence[Ranked], needed: float) -> list[Ranked]:
        asked.append(len(ranked))
        found = judged(search, taken, ranked, needed)
        return [replace(each, vetoed=True) for each in found] if len(asked) == 1 else found

    monkeypatch.setattr(rounds, "_judged", refuted_at_first)
    found = one_round(search, None, 0.0).ranked[0]
    assert len(asked) == 2
    assert asked[1] >= 1
    assert found.name == "respiration"
    assert not found.vetoed
    assert found.balance == pytest.approx(plain.balance, abs=1.0)
    assert found.joint.added[0].values["frequency_hz"] == pytest.approx(TRUTH["frequency_hz"], rel=0.03)


def test_only_what_is_far_from_linear_has_hills(search: Search) -> None:
    assert search.is_hilly(BREATH)
    assert not search.is_hilly(effect_named("viscous"))


def test_a_wrong_hill_is_no_start(search: Search) -> None:
    # What makes the others worth a trial: from another frequency a fit does not come to the true one.
    other = {**TRUTH, "frequency_hz": 0.45, "phase_rad": 0.0}
    far = refit([Added(BREATH, other)], search.calibration, search.base)
    near = refit([Added(BREATH, TRUTH)], search.calibration, search.base)
    assert far.gain < near.gain - 50
