import numpy as np
import pytest

from needleplan.errors import DataError
from needleplan.models import fit
from needleplan.recording import align
from needleplan.signals import Array, Record
from tests.models.lag import Lag
from tests.models.test_base import recorded


def record(time: Array, **columns: Array) -> Record:
    return Record({"time_s": time, **columns}, "trial")


def test_a_slow_sensor_is_brought_to_the_times_of_a_fast_one() -> None:
    fast, slow = np.arange(1000) / 200, 1 + np.arange(100) / 40
    found = align(record(fast, force_n=fast), record(slow, depth_mm=3 * slow, force_n=0 * slow))
    assert found["time_s"][0] == 1.0
    assert len(found) == ((fast >= 1) & (fast <= slow[-1])).sum()
    np.testing.assert_allclose(found["depth_mm"], 3 * found["time_s"], rtol=1e-12)
    np.testing.assert_array_equal(found["force_n"], found["time_s"])
    assert "200 samples before and 304 after the time of the other record were left out" in found.notes
    assert f"depth_mm interpolated from 100 to {len(found)} samples" in found.notes


def test_gaps_are_not_bridged() -> None:
    slow = np.array([0, 0.1, 0.2, 0.3, 2.0, 2.1])
    found = align(record(np.arange(22) / 10, force_n=np.zeros(22)), record(slow, depth_mm=slow))
    assert np.isnan(found["depth_mm"]).sum() == 16
    assert any(note.startswith("depth_mm: 16 of 22 samples fall into gaps") for note in found.notes)
    holed = record(np.arange(9.0), depth_mm=np.array([0, 1, np.nan, np.nan, np.nan, np.nan, np.nan, 7, 8]))
    found = align(record(np.arange(9.0), force_n=np.zeros(9)), holed)
    np.testing.assert_array_equal(np.isnan(found["depth_mm"]), np.isnan(holed["depth_mm"]))


def test_records_that_cannot_be_aligned() -> None:
    first, second = record(np.arange(9.0), force_n=np.zeros(9)), record(20 + np.arange(9.0), depth_mm=np.zeros(9))
    with pytest.raises(DataError, match="must overlap 20 to 28 s"):
        align(first, second)
    with pytest.raises(DataError, match="is not in the other record"):
        align(first, second, ["x_mm"])
    with pytest.raises(DataError, match="no column"):
        align(first, first)


def test_trials_of_different_lengths_are_fitted_together() -> None:
    truth = Lag(0.2, 0.4, -0.05)
    trials = [recorded(truth, 0.01, seed, seconds=seconds) for seed, seconds in ((0, 3.0), (1, 8.0))]
    found = fit(truth, trials)
    assert found.samples == sum(map(len, trials))
    assert found.estimates["gain"].value == pytest.approx(0.2, rel=0.01)
