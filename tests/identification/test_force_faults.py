"""Spikes, saturation and a flipped sign are found, reported, and do not change the model; sound data are left alone."""

import numpy as np
import pytest

from needleplan.identification import force
from needleplan.identification._force_faults import without_faults
from needleplan.models import ForceModel1, simulate
from needleplan.signals import Array, Record, insertion_cycles

TRUE = ForceModel1(sigma0=8e-3, sigma1=2.5, sigma2=4e-3, f1=0.056, f2=-0.021, alpha=0.05)
MOTION = insertion_cycles(80.0, 10.0, rate_hz=50.0)
CLEAN = simulate(TRUE, MOTION).output


def record(values: Array, trial: str = "one") -> Record:
    columns = {"time_s": MOTION.time_s, "depth_mm": MOTION.depth_mm, "velocity_mm_s": MOTION.velocity_mm_s}
    return Record(columns | {"force_n": values}, trial)


def noisy(seed: int, size: float = 0.005) -> Array:
    return np.asarray(CLEAN + np.random.default_rng(seed).normal(0, size, CLEAN.size))


@pytest.mark.parametrize("size", [0.0, 1e-4, 0.005, 0.05])
@pytest.mark.parametrize("step", [0.0, 0.01])
def test_sound_data_are_left_alone(size: float, step: float) -> None:
    values = noisy(1, size)
    values = np.round(values / step) * step if step else values
    (kept,), remarks = without_faults([record(values)])
    assert remarks == []
    np.testing.assert_array_equal(kept["force_n"], values)


def test_a_puncture_is_no_spike() -> None:
    values = noisy(2)
    values[300:] -= 0.3 * values.max()
    assert without_faults([record(values)])[1] == []


def test_a_spike_of_50_n_is_left_out_and_the_model_stays() -> None:
    values = noisy(3)
    hit = values.copy()
    hit[[200, 201, 450]] = 50.0, 48.0, -50.0
    (kept,), remarks = without_faults([record(hit)])
    assert np.flatnonzero(np.isnan(kept["force_n"])).tolist() == [200, 201, 450]
    assert "3 samples are spikes of up to 50 N" in remarks[0]
    with_spikes, without = (
        force.identify([record(each)], average=1, starts=1, filtered=False) for each in (hit, values)
    )
    assert any("spikes" in each for each in with_spikes.remarks)
    assert with_spikes.estimates["sigma2"].value == pytest.approx(without.estimates["sigma2"].value, rel=0.02)


@pytest.mark.parametrize("offset", [0.0, -0.3])
def test_a_saturated_sensor_is_found(offset: float) -> None:
    limit = 0.7 * CLEAN.max() + offset
    values = np.minimum(noisy(4) + offset, limit)
    (kept,), remarks = without_faults([record(values)])
    saturated = values == limit
    assert saturated.sum() > 50
    np.testing.assert_array_equal(np.isnan(kept["force_n"]), saturated)
    assert f"saturated at {limit:.4g} N" in remarks[0]


def test_a_flipped_sign_is_reported() -> None:
    _, remarks = without_faults([record(-noisy(5))])
    assert len(remarks) == 1
    assert "its sign is flipped" in remarks[0]
    way_in = MOTION.direction > 0
    half = Record({name: each[way_in] for name, each in record(-noisy(5)).columns.items()}, "way in")
    assert "its sign is flipped" in without_faults([half])[1][0]
