"""Intervals include the model error of formulas and the sampling of positions."""

from __future__ import annotations

import numpy as np
import pytest

from needleplan.diagnosis import Diagnosis, Library, Verdict, diagnose
from needleplan.diagnosis._verdict import parameter_interval
from needleplan.models.effects import effect_named
from tests.diagnosis.trials import BASE, RATE_HZ, recordings


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    hidden = {"puncture": {"size": 1.5, "depth_mm": 40.0, "bulge_mm": 2.0}}
    made = diagnose(BASE, recordings(hidden, seed=3), library=Library([effect_named("puncture")], BASE))
    assert made.verdict is Verdict.NAMED
    return made


def test_an_amplitude_has_the_error_of_its_formula(found: Diagnosis) -> None:
    (effect,) = found.effects
    size = effect.estimates["size"]
    assert found.joint is not None
    low, high = parameter_interval(found.joint, 0, "size")
    assert size.low < low < size.value < high < size.high
    formula = 1.96 * 0.04 * size.value
    assert size.value - size.low == pytest.approx(np.hypot(size.value - low, formula))
    assert size.high - size.value == pytest.approx(np.hypot(high - size.value, formula))


def test_a_place_has_the_error_of_the_sampling(found: Diagnosis) -> None:
    (effect,) = found.effects
    place = effect.estimates["depth_mm"]
    slowest_mm_s = 5.0  # of the two trials, on the way past 40 mm
    assert place.low <= 40.0 <= place.high
    assert place.high - place.low >= slowest_mm_s / RATE_HZ
    assert place.high - place.low < 1.0
