import numpy as np
import pytest

from needleplan.errors import DataError
from needleplan.signals import VelocityMethod, lag_rad, sinusoid, velocity_without_delay


def test_an_encoder_gives_a_velocity_without_delay() -> None:
    motion = sinusoid(offset_mm=100, amplitude_mm=40, frequency_hz=0.1, cycles=2)
    made = velocity_without_delay(motion.time_s, np.round(motion.depth_mm, 3))
    assert made.method is VelocityMethod.POLYNOMIAL
    assert made.noise_mm < 1e-3
    assert np.abs(made.velocity_mm_s - motion.velocity_mm_s).max() < 0.05


def test_a_tracker_gives_one_by_smoothing() -> None:
    motion = sinusoid(offset_mm=100, amplitude_mm=40, frequency_hz=0.1, cycles=3, rate_hz=40)
    position = motion.depth_mm + np.random.default_rng(0).normal(0, 0.1, len(motion))
    made = velocity_without_delay(motion.time_s, position)
    assert made.method is VelocityMethod.SMOOTHER
    assert made.noise_mm == pytest.approx(0.1, rel=0.2)
    assert np.sqrt(np.mean((made.velocity_mm_s - motion.velocity_mm_s) ** 2)) < 0.5
    assert np.degrees(lag_rad(0.1, motion.time_s, made.velocity_mm_s, motion.velocity_mm_s)) == pytest.approx(
        0, abs=0.3
    )


def test_uneven_times_are_smoothed_and_bad_ones_refused() -> None:
    motion = sinusoid(offset_mm=100, amplitude_mm=40, frequency_hz=0.1, cycles=2, rate_hz=50)
    kept = np.delete(np.arange(len(motion)), [200, 201, 202, 203])
    made = velocity_without_delay(motion.time_s[kept], motion.depth_mm[kept])
    assert made.method is VelocityMethod.SMOOTHER
    assert np.abs(made.velocity_mm_s - motion.velocity_mm_s[kept])[20:-20].max() < 0.5
    with pytest.raises(DataError, match="at least 15"):
        velocity_without_delay(motion.time_s[:5], motion.depth_mm[:5])
    with pytest.raises(DataError, match="increasing"):
        velocity_without_delay(motion.time_s[::-1], motion.depth_mm)
