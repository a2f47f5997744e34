import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.errors import DataError
from needleplan.signals import Motion, Start, cycles, sinusoid


@settings(max_examples=30, deadline=None)
@given(
    start=st.sampled_from(Start), outward=st.booleans(), amplitude=st.floats(1, 50), frequency=st.floats(0.02, 0.2),
    ramp=st.floats(0.1, 1.0),
)  # fmt: skip
def test_a_sine_begins_at_rest_and_its_velocity_is_its_slope(
    start: Start, outward: bool, amplitude: float, frequency: float, ramp: float
) -> None:
    motion = sinusoid(
        offset_mm=60, amplitude_mm=amplitude, frequency_hz=frequency, cycles=2, start=start, outward=outward,
        ramp_cycles=ramp,
    )  # fmt: skip
    top = 2 * math.pi * frequency * amplitude
    assert abs(motion.velocity_mm_s[0]) < 1e-9
    assert np.abs(motion.velocity_mm_s).max() <= top * (1 + 1e-9)
    slope = np.gradient(motion.depth_mm, motion.time_s)[1:-1]
    np.testing.assert_allclose(motion.velocity_mm_s[1:-1], slope, atol=0.01 * top)
    assert motion.direction[1] == (-1 if outward else 1)
    assert motion.depth_mm[0] == pytest.approx(60 if start is Start.MIDDLE else 60 + amplitude * (1 if outward else -1))
    assert np.abs(motion.depth_mm - 60).max() == pytest.approx(amplitude, rel=1e-3)


def test_cycles_are_counted_by_reversals() -> None:
    motion = sinusoid(offset_mm=60, amplitude_mm=25, frequency_hz=0.1, cycles=3)
    passed = cycles(motion)
    # The count moves on where the new direction is sure: a twentieth of the top speed after the reversal.
    late = math.asin(0.05) / (2 * math.pi * 0.1)
    np.testing.assert_array_equal(motion.time_s[np.flatnonzero(np.diff(passed)) + 1] >= [10 + late, 20 + late], True)
    np.testing.assert_allclose(motion.time_s[np.flatnonzero(np.diff(passed)) + 1], [10 + late, 20 + late], atol=0.006)


def test_noise_near_the_reversals_makes_no_cycles() -> None:
    motion = sinusoid(offset_mm=60, amplitude_mm=25, frequency_hz=0.1, cycles=3)
    shaken = motion.velocity_mm_s + 0.1 * np.random.default_rng(0).standard_normal(len(motion))
    assert cycles(Motion.sampled(motion.time_s, motion.depth_mm, shaken)).max() == 2


def test_a_needle_at_rest_has_no_cycles() -> None:
    assert not cycles(Motion.sampled(np.arange(9.0), np.ones(9))).any()


def test_all_wrong_numbers_are_named() -> None:
    with pytest.raises(DataError) as raised:
        sinusoid(offset_mm=math.nan, amplitude_mm=-1, frequency_hz=0, cycles=2)
    assert [each.key for each in raised.value.mistakes] == ["amplitude_mm", "frequency_hz", "offset_mm"]
    with pytest.raises(DataError, match="at least two"):
        sinusoid(offset_mm=0, amplitude_mm=1, frequency_hz=1000, cycles=1, rate_hz=100)
