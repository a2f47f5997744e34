"""Combination of trials: the coverage of the intervals, measured by simulation, and the formulas by hand."""

import math

import numpy as np
import pytest

from needleplan.errors import DataError
from needleplan.models import Bicycle, ShaftAndTip
from needleplan.models.trials import agreement_of, combine, mean_estimate, regress
from needleplan.signals import Array

RUNS = 2000
LEAST, MOST = 0.92, 0.98
# Three standard deviations of a count of RUNS at the upper limit: the chance of a false alarm is 0.1 % a case.
ALLOWED = 3 * math.sqrt(MOST * (1 - MOST) / RUNS)
EQUAL_OR_NOT = [(1, 1), (1, 2), (1, 1, 1), (1, 2, 3), (1, 1, 1, 1, 1), (1, 2, 3, 2, 1)]


@pytest.mark.parametrize("errors", EQUAL_OR_NOT, ids=str)
@pytest.mark.parametrize("scatter", [0.0, 1.0, 3.0])
def test_intervals_hold_the_truth_as_often_as_they_say(errors: tuple[int, ...], scatter: float) -> None:
    """Errors s known and unknown, scatter between trials tau = 0, s and 3 s; the range of the next trial too."""
    random, s = np.random.default_rng(len(errors)), np.array(errors, float)
    spread = np.hypot(s, scatter * np.sqrt(np.mean(s**2)))
    held = np.zeros(3)
    for _ in range(RUNS):
        x = spread * random.standard_normal(s.size)
        known, unknown = combine(x, s), combine(x)
        region = known.next_trial()
        assert region is not None
        ranges = (known.interval(), unknown.interval(), region)
        truth = (0.0, 0.0, random.choice(spread) * random.standard_normal())
        held += [low <= value <= high for value, (low, high) in zip(truth, ranges, strict=True)]
    assert np.all((held / RUNS >= LEAST) & (held / RUNS <= MOST + ALLOWED)), held / RUNS


def test_equal_errors_give_students_interval() -> None:
    x = np.array([9.8, 10.1, 10.4])
    reach = 4.302653 * x.std(ddof=1) / math.sqrt(3)
    for mean in (combine(x), combine(x, np.full(3, 0.01))):
        assert mean.interval() == pytest.approx((10.1 - reach, 10.1 + reach))
        assert mean.scatter_sd == pytest.approx(0.3)
    assert combine(x).between_sd is None
    assert combine(x, np.full(3, 0.1)).between_sd == pytest.approx(math.sqrt(0.3**2 - 0.1**2))


def test_precise_trials_have_more_weight_and_the_scale_of_the_errors_none() -> None:
    x, s = np.array([1.0, 2.0]), np.array([1.0, 3.0])
    mean = combine(x, s)
    assert mean.value == pytest.approx((1.0 / 6 + 2.0 / 14) / (1 / 6 + 1 / 14))
    assert combine(x, s / 100).interval() == pytest.approx(combine(x, s / 1000).interval())


def test_trials_that_agree_by_luck_keep_the_errors_of_the_trials() -> None:
    low, high = combine([5.0, 5.0, 5.0], [0.3, 0.3, 0.3]).interval()
    assert (high - low) / 2 == pytest.approx(0.3 / math.sqrt(3))


def test_one_trial_has_its_own_interval_or_none() -> None:
    assert combine([2.0], [0.1]).interval() == pytest.approx((2 - 0.1959964, 2 + 0.1959964))
    assert combine([2.0]).interval() == (-math.inf, math.inf)
    assert combine([2.0], [0.1]).next_trial() is None


def test_a_regression_is_exact_least_squares_with_equal_errors() -> None:
    random = np.random.default_rng(1)
    at = np.linspace(0, 1, 6)
    design = np.column_stack([1 - at, at])
    values = design @ [3.0, 1.0] + 0.1 * random.standard_normal(6)
    law = regress(design, values, np.full(6, 0.05))
    expected, (squares,), *_ = np.linalg.lstsq(design, values, rcond=None)
    assert law.coefficients == pytest.approx(expected)
    assert law.covariance == pytest.approx(squares / 4 * np.linalg.inv(design.T @ design))
    assert law.scatter_sd == pytest.approx(math.sqrt(squares / 4))
    difference = law.combination([1.0, -1.0])
    low, high = difference.interval()
    assert low < 2.0 < high
    assert difference.zero_test()[1] < 1e-4
    with pytest.raises(DataError, match="trials = 2: are too few for 2 coefficients: at least 3 are needed"):
        regress(np.eye(2), [1.0, 2.0])


def test_the_test_of_a_further_trial_has_its_level() -> None:
    random = np.random.default_rng(2)
    values: Array = random.standard_normal((RUNS, 4))
    exact, conservative = (
        np.mean([combine(row[:3]).further_trial(row[3], within_sd)[1] < 0.05 for row in values])
        for within_sd in (0.0, 0.5)
    )
    assert exact == pytest.approx(0.05, abs=4 * math.sqrt(0.05 * 0.95 / RUNS))
    assert 0 < conservative < exact


def test_agreement_is_cochrans_test() -> None:
    test = agreement_of([1.0, 2.0, 3.0], [0.5, 0.5, 0.5])
    assert (test.q, test.p_value) == (pytest.approx(8.0), pytest.approx(math.exp(-4.0)))
    assert not test.agree
    assert agreement_of([1.0, 1.0], [0.0, 0.0]).agree
    with pytest.raises(DataError, match="at least two trials"):
        agreement_of([1.0], [0.1])


def test_a_parameter_is_averaged_in_its_coordinate_and_stays_in_its_range() -> None:
    friction = ShaftAndTip.parameters()["friction"]
    mean = mean_estimate(friction, [0.01, 0.04])
    assert mean.value == pytest.approx(0.02)
    assert mean.high == friction.upper
    assert not mean.identified
    bend = Bicycle.parameters()["curvature_per_mm"]
    assert mean_estimate(bend, [0.01, 0.03]).value == pytest.approx(0.02)


def test_trials_that_do_not_determine_a_parameter_are_left_out() -> None:
    friction = ShaftAndTip.parameters()["friction"]
    values, sds = [0.010, 0.012, 3.0], [0.001, 0.001, math.inf]
    assert mean_estimate(friction, values, sds) == mean_estimate(friction, values[:2], sds[:2])
    alone = mean_estimate(friction, values, [0.001, 0.02, math.inf])
    assert alone.value == pytest.approx(0.010)
    assert alone.between_sd is None
    unknown = mean_estimate(friction, [0.010], [math.inf])
    assert (unknown.low, unknown.high, unknown.identified) == (friction.lower, friction.upper, False)


@pytest.mark.parametrize(
    ("values", "errors", "message"),
    [
        ([], None, "values: must be finite numbers, at least one"),
        ([math.nan], None, "values: must be finite numbers"),
        ([1.0, math.nan], None, "values: must be finite numbers"),
        ([1.0, 2.0], [0.1], "within_sd: must be 2 finite numbers"),
        ([1.0, 2.0], [0.1, -0.1], "within_sd: must be 2 finite numbers"),
        ([1.0, 2.0], [0.1, math.inf], "within_sd: must be 2 finite numbers"),
    ],
)
def test_numbers_that_cannot_be_combined(values: list[float], errors: list[float] | None, message: str) -> None:
    with pytest.raises(DataError, match=message):
        combine(values, errors)
