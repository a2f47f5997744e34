"""The interval of a mean over a few recordings holds as often as it says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from needleplan.models import Bicycle, mean_estimate

WHAT = Bicycle(0.01).parameters()["curvature_per_mm"]
TRUE = 0.01


@pytest.mark.parametrize("count", [2, 3, 6])
def test_its_interval_holds_the_true_mean_in_95_of_100_cases(count: int) -> None:
    """4,000 draws: the standard error of the share is 0.35 %. Two standard errors hold 70 % for two values."""
    random, centre = np.random.default_rng(count), WHAT.coordinate(TRUE)
    held = 0
    for _ in range(4000):
        found = mean_estimate(WHAT, [WHAT.value(each) for each in centre + random.normal(0, 0.05, count)])
        held += found.low <= TRUE <= found.high
    assert held / 4000 == pytest.approx(0.95, abs=0.012)


def test_one_value_shows_no_scatter() -> None:
    found = mean_estimate(WHAT, [TRUE])
    assert (found.low, found.high) == (WHAT.lower, WHAT.upper)
    assert math.isinf(found.sd)


def test_values_that_agree_by_chance_have_the_interval_of_their_noise() -> None:
    found = mean_estimate(WHAT, [TRUE, TRUE], [0.3, 0.4])
    low, high = (WHAT.value(WHAT.coordinate(TRUE) + side * 1.96 * 0.25) for side in (-1, 1))
    assert (found.low, found.high) == pytest.approx((low, high), rel=1e-4)
    assert mean_estimate(WHAT, [0.005, 0.02], [1e-3, 1e-3]) == mean_estimate(WHAT, [0.005, 0.02])
