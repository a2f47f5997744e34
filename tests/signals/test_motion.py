"""The motion that drives every model."""

import numpy as np

from needleplan.signals import Motion


def test_a_dwell_in_a_measured_depth_is_at_rest_and_keeps_its_direction() -> None:
    """Times like 0.1, 0.2, 0.30000000000000004 are uneven in the last bit; that must not pass for a movement."""
    time = np.arange(200) / 50
    depth = np.minimum(20 * time, 30.0)
    motion = Motion.sampled(time, depth)
    assert not motion.velocity_mm_s[80:].any()
    assert (motion.direction == 1).all()


def test_the_velocity_of_uneven_samples_is_exact_for_a_parabola() -> None:
    time = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.05, 100))
    motion = Motion.sampled(time, 3 * time**2 - time)
    np.testing.assert_allclose(motion.velocity_mm_s[1:-1], (6 * time - 1)[1:-1], rtol=1e-9)


def test_the_acceleration_is_exact_at_kinks_of_the_velocity() -> None:
    """The velocity is straight with kinks between samples; the truth is its own mean over each interval of a sample."""
    interval_s, time = 0.01, np.arange(100) / 100
    places, speeds = [0.0, 0.234, 0.297, 0.561, 0.628, 1.0], [0.0, 0.0, 6.0, 6.0, -3.0, -3.0]
    motion = Motion.sampled(time, np.zeros(100), np.interp(time, places, speeds))
    ends = [np.interp(time + side * interval_s / 2, places, speeds) for side in (1, -1)]
    np.testing.assert_allclose(motion.acceleration_mm_s2[1:-1], ((ends[0] - ends[1]) / interval_s)[1:-1], atol=1e-9)


def test_the_acceleration_of_a_smooth_motion_is_of_second_order() -> None:
    errors = []
    for rate_hz in (100, 200):
        time = np.arange(2 * rate_hz) / rate_hz
        motion = Motion.sampled(time, -np.cos(3 * time) / 3, np.sin(3 * time))
        errors.append(np.abs(motion.acceleration_mm_s2 - 3 * np.cos(3 * time))[2:-2].max())
    assert errors[0] < 1e-2
    assert errors[1] < 0.3 * errors[0]
