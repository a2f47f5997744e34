"""Intervals hold what is not of the noise: formulas that are nearly right, and what lies between two samples."""

from __future__ import annotations

import numpy as np
import pytest

from needleplan.diagnosis import Diagnosis, Library, Verdict, diagnose
from needleplan.diagnosis.size import interval_of
from needleplan.models.effects import effect_named
from tests.diagnosis.trials import BASE, RATE_HZ, recordings


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    hidden = {"puncture": {"size": 1.5, "depth_mm": 40.0, "bulge_mm": 2.0}}
    made = diagnose(BASE, recordings(hidden, seed=3), library=Library([effect_named("puncture")], BASE))
    assert made.verdict is Verdict.NAMED
    return made


def test_a_size_is_not_known_better_than_its_formula(found: Diagnosis) -> None:
    (effect,) = found.effects
    size = effect.added.estimates["size"]
    assert found.joint is not None
    low, high = interval_of(found.joint, 0, "size")
    assert size.low < low < size.value < high < size.high
    formula = 1.96 * 0.04 * size.value
    assert size.value - size.low == pytest.approx(np.hypot(size.value - low, formula))
    assert size.high - size.value == pytest.approx(np.hypot(high - size.value, formula))


def test_a_place_is_not_known_better_than_the_way_between_two_samples(found: Diagnosis) -> None:
    (effect,) = found.effects
    place = effect.added.estimates["depth_mm"]
    slowest_mm_s = 5.0  # of the two trials, on the way past 40 mm
    assert place.low <= 40.0 <= place.high
    assert place.high - place.low >= slowest_mm_s / RATE_HZ
    assert place.high - place.low < 1.0
