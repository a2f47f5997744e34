from __future__ import annotations

import numpy as np
import pytest

from needleplan.errors import DataError, ModelError
from needleplan.models import bootstrap_intervals, fit, profile_intervals
from needleplan.models._intervals import _Profile
from tests.models.lag import Lag
from tests.models.line import Line, filtered, pushed
from tests.models.test_base import recorded

TRUTH = {"slope": 0.02, "offset": 0.1}


def test_the_profile_of_a_linear_model_is_its_interval() -> None:
    record = pushed(np.random.default_rng(0))
    found = fit(Line(0.01), record, lags=0)
    low, high = (getattr(profile_intervals(found, record).estimates["offset"], end) for end in ("low", "high"))
    matrix = np.column_stack([record["depth_mm"], np.ones(200)])
    solution, left, *_ = np.linalg.lstsq(matrix, record["force_n"], rcond=None)
    reach = 1.972 * np.sqrt(left[0] / 198 * np.linalg.inv(matrix.T @ matrix)[1, 1])
    # The covariance of the fit is robust, and so not exactly the classical one; the profile is never narrower.
    assert solution[1] - 1.2 * reach < low < solution[1] - 0.99 * reach
    assert solution[1] + 0.99 * reach < high < solution[1] + 1.2 * reach


@pytest.mark.slow
@pytest.mark.parametrize("correlated", [False, True])
def test_profile_intervals_hold_the_truth(correlated: bool) -> None:
    random, held, trials = np.random.default_rng(1), np.zeros(2), 25
    for _ in range(trials):
        record = pushed(random, filtered(random) if correlated else None)
        estimates = profile_intervals(fit(Line(0.02, 0.1), record), record).estimates
        held += [estimates[name].low <= value <= estimates[name].high for name, value in TRUTH.items()]
    assert (held / trials >= 0.8).all()


@pytest.mark.slow
def test_bootstrap_intervals_hold_the_truth() -> None:
    random, held, trials = np.random.default_rng(2), np.zeros(2), 25
    for trial in range(trials):
        record = pushed(random, filtered(random, 300), 300)
        intervals = bootstrap_intervals(fit(Line(0.02, 0.1), record), record, runs=40, block=20, seed=trial)
        assert intervals.failed == 0
        each = intervals.estimates
        held += [each[name].low <= value <= each[name].high for name, value in TRUTH.items()]
    assert (held / trials >= 0.76).all()


def test_what_has_no_end_is_not_identified() -> None:
    record = recorded(Lag(0.2, 0.4), 0.3, 0, seconds=3.0)
    found = fit(Lag(0.2, 1e-3), record.select(slice(0, 60)))
    estimates = profile_intervals(found, record.select(slice(0, 60))).estimates
    lag = estimates["time_constant"]
    assert not lag.identified or lag.high / lag.low < np.exp(4)
    assert lag.low <= found.estimates["time_constant"].value <= lag.high


def test_one_parameter_alone_has_a_profile() -> None:
    record = pushed(np.random.default_rng(3))
    found = fit(Line(0.02, 0.1), record, free=["slope"])
    slope = profile_intervals(found, record).estimates["slope"]
    assert slope.low < 0.02 < slope.high
    assert slope.high - slope.low < 0.002


def test_what_cannot_be_asked_is_refused() -> None:
    record = pushed(np.random.default_rng(4))
    found = fit(Line(0.02, 0.1), record)
    with pytest.raises(ModelError, match="must be one of slope, offset"):
        profile_intervals(found, record, ["slop"])
    with pytest.raises(DataError, match="at least 20 runs"):
        bootstrap_intervals(found, record, runs=3)


def test_an_end_of_the_range_may_be_rounded_beyond_it() -> None:
    """exp(log 1000) can be above 1000, which the model refuses."""
    record = recorded(Lag(0.2, 0.4), 0.3, 0, seconds=3.0)
    profile = _Profile(fit(Lag(0.2, 0.4), record), (record,), {})
    assert profile._sum("time_constant", 1e3 * (1 + 1e-15)) > profile.least
