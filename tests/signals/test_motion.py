"""The motion that drives every model."""

from __future__ import annotations

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
