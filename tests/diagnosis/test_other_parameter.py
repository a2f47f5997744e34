"""Whether the data contradict a given parameter, if few trials hardly tell how far it scatters."""

import math

import pytest
from scipy.stats import t as student

from needleplan.diagnosis import OtherParameter
from needleplan.models import Estimate


def departs(given: float, scatter: float, trials: int) -> bool:
    """Return the answer for trials with the mean 1 and a scatter of the logarithm."""
    width = student.ppf(0.975, trials - 1) * scatter / math.sqrt(trials)
    estimate = Estimate(value=1.0, sd=scatter, low=math.exp(-width), high=math.exp(width), unit="", identified=True)
    return OtherParameter.of("friction", estimate, given, None, trials).departs


@pytest.mark.parametrize("trials", [2, 3, 5])
@pytest.mark.parametrize("scatter", [0.02, 0.1, 0.2])
def test_a_factor_of_two_is_seen_in_two_trials(trials: int, scatter: float) -> None:
    assert departs(2.0, scatter, trials)
    assert departs(0.5, scatter, trials)


@pytest.mark.parametrize("trials", [2, 3, 5])
def test_a_tenth_is_no_change_even_if_the_trials_agree_by_chance(trials: int) -> None:
    assert not departs(1.1, 0.001, trials)
    assert not departs(0.9, 0.001, trials)


def test_many_trials_show_their_own_scatter() -> None:
    assert departs(1.1, 0.05, 200)
    assert not departs(2.0, 3.0, 20)


def test_of_an_angle_only_the_scatter_of_the_trials_counts() -> None:
    for mean_rad, is_clear in ((0.002, False), (0.02, True)):
        low, high = mean_rad - 0.004, mean_rad + 0.004
        estimate = Estimate(value=mean_rad, sd=0.001, low=low, high=high, unit="rad", identified=True)
        assert OtherParameter.of("heading_y_rad", estimate, 0.0, None, 3).departs is is_clear


def test_one_trial_shows_nothing() -> None:
    estimate = Estimate(value=1.0, sd=0.1, low=0.9, high=1.1, unit="", identified=True)
    assert not OtherParameter.of("friction", estimate, 5.0, None, 1).departs
