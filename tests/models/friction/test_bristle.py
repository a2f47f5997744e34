"""The compiled bristles against loops over the samples."""

import numpy as np

from needleplan.models.friction import slid, slid_along
from needleplan.signals import Array, Motion, lspb


def stretched(motion: Motion, length_mm: float, parts: int) -> Array:
    """Dahl's bristle, each interval in many short travels of one direction."""
    z, found = 0.0, [0.0]
    for first, last, h in zip(motion.velocity_mm_s, motion.velocity_mm_s[1:], motion.interval_s, strict=False):
        for share in (np.arange(parts) + 0.5) / parts:
            way = (first + share * (last - first)) * h / parts
            z = np.sign(way) + (z - np.sign(way)) * np.exp(-abs(way) / length_mm)
        found.append(z)
    return np.array(found)


def test_dahls_bristle_is_exact_within_a_step_too() -> None:
    motion = lspb([0, 6, 5, 9], [5, 7, 4], rate_hz=23.0)
    np.testing.assert_allclose(slid(motion, 0.3), stretched(motion, 0.3, 200), atol=2e-4)


def test_many_motions_are_as_each_alone() -> None:
    motion = lspb([0, 6, 5, 9], [5, 7, 4], rate_hz=50.0)
    speeds = motion.velocity_mm_s * np.array([[1.0], [-0.5], [2.0]])
    for row, speed in zip(slid_along(speeds, motion.time_s, 0.3), speeds, strict=True):
        alone = slid(Motion(motion.time_s, motion.depth_mm, speed, np.sign(speed), motion.angle_rad), 0.3)
        np.testing.assert_array_equal(row, alone)
