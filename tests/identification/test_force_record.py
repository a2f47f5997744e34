import numpy as np
import pytest

from needleplan.errors import DataError
from needleplan.identification import force_drops
from needleplan.signals import Record


def record(noise_n: float) -> Record:
    """Force that rises by 0.1 N/mm and drops by 0.5 N at 12 mm and 0.3 N at 20 mm, then a way back."""
    depth = np.concatenate([np.linspace(-2, 30, 641), np.linspace(29.9, 0, 300)])
    force = 0.1 * np.maximum(depth, 0) - 0.5 * (depth > 12) - 0.3 * (depth > 20)
    force[641:] = -0.2 + np.sin(np.arange(300))
    force += noise_n * np.random.default_rng(0).standard_normal(force.size)
    return Record({"time_s": np.arange(depth.size) / 100, "depth_mm": depth, "force_n": force})


def test_membranes_are_found_where_they_are() -> None:
    first, second = force_drops(record(0.02), least_n=0.15, within_mm=1.0)
    assert (first.peak_mm, second.peak_mm) == pytest.approx((12, 20), abs=0.3)
    assert (first.drop_n, second.drop_n) == pytest.approx((0.5, 0.3), abs=0.1)


def test_noise_alone_has_no_drop_above_its_size() -> None:
    time = np.arange(500) / 100
    quiet = Record(
        {"time_s": time, "depth_mm": 5 * time, "force_n": 0.02 * np.random.default_rng(1).standard_normal(500)}
    )
    assert force_drops(quiet, least_n=0.15) == ()
    with pytest.raises(DataError, match="must be above 0"):
        force_drops(quiet, least_n=0.0)
