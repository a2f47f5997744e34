from itertools import product

import numpy as np
import pytest

from needleplan.errors import DataError
from needleplan.estimation import FilterSample, JointFilter, JointForce, SampleUse
from needleplan.identification import Recipe, feed
from needleplan.signals import Array, Motion, Record
from tests.estimation.insertions import JOINT, MODEL, moved, recorded

CORNERS = list(product((-1, 1), repeat=5))


def plain_filter(
    joint: JointForce, model: object, record: Record, variance: float, sd: float, walk: float
) -> tuple[Array, Array]:
    """The extended Kalman filter as in a textbook: x and P after the last sample."""
    motion: Motion = record.motion()
    x = joint.initial(model, motion)  # type: ignore[arg-type]
    covariance = np.diag([0.0, *[sd**2] * (x.size - 1)])
    for k in range(len(motion)):
        if k:
            x, change = joint.predict(x, motion[k - 1], motion[k])
            covariance = change @ covariance @ change.T + np.diag([0.0, *[walk] * (x.size - 1)])
        expected, row = joint.measure(x, motion[k])
        gain = covariance @ row / (row @ covariance @ row + variance)
        x = x + gain * (record["force_n"][k] - expected)
        covariance = (np.eye(x.size) - np.outer(gain, row)) @ covariance
    return x, covariance


def test_the_filter_is_that_of_the_textbook() -> None:
    record = recorded(MODEL).select(slice(0, 1500))
    filtered = JointFilter(JOINT, moved(MODEL, {"sigma2": 1.3, "beta": 0.8}), variance=1e-4, sd=0.3)
    feed(filtered, record)
    x, covariance = plain_filter(JOINT, moved(MODEL, {"sigma2": 1.3, "beta": 0.8}), record, 1e-4, 0.3, 1e-8)
    np.testing.assert_allclose(filtered.x, x, rtol=1e-6)
    np.testing.assert_allclose(filtered.covariance, covariance, rtol=1e-4, atol=1e-9)


def test_online_and_in_one_go_are_the_same() -> None:
    record = recorded(MODEL).select(slice(0, 400))
    one, other = (JointFilter(JOINT, MODEL, variance=1e-4, sd=0.2, settle=5) for _ in range(2))
    feed(one, record)
    for time, depth, force in zip(record["time_s"], record["depth_mm"], record["force_n"], strict=True):
        other.update(FilterSample(float(time), float(depth), float(force)))
    np.testing.assert_allclose(other.x, one.x, rtol=1e-3)


def test_reversals_and_missing_values_are_counted() -> None:
    record = recorded(MODEL, depth=20.0)
    force = record["force_n"].copy()
    force[100:130] = np.nan
    filtered = JointFilter(JOINT, MODEL, variance=1e-4, sd=0.2, settle=5)
    steps = feed(filtered, record.with_column("force_n", force), 5)
    assert filtered.counts[SampleUse.MISSING] == 30
    turned = int(np.flatnonzero(record.motion().direction < 0)[0])
    masked = [k for k, each in enumerate(steps) if each.use is SampleUse.MASKED]
    assert masked == [*range(turned - 1, turned + 5), len(record) - 1]  # and at rest at the end
    assert sum(filtered.counts.values()) == len(record)
    assert np.isnan(steps[110].innovation)
    assert np.isfinite(steps[110].predicted)


def test_bad_samples_are_refused_and_change_nothing() -> None:
    filtered = JointFilter(JOINT, MODEL, variance=1e-4, sd=0.2)
    with pytest.raises(DataError, match="not had a sample"):
        _ = filtered.x
    filtered.update(FilterSample(0.0, 0.0, 0.0))
    filtered.update(FilterSample(0.005, 0.05, 0.001))
    before = filtered.x.copy()
    for sample in (FilterSample(0.005, 0.1, 0.0), FilterSample(0.001, 0.1, 0.0), FilterSample(0.01, float("nan"), 0.0)):
        with pytest.raises(DataError):
            filtered.update(sample)
    np.testing.assert_array_equal(filtered.x, before)
    with pytest.raises(DataError, match="variance"):
        JointFilter(JOINT, MODEL, variance=0.0, sd=0.2)
    with pytest.raises(DataError, match="spreads"):
        Recipe(variances=(1e-2,))
