import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import cumulative_simpson

from needleplan.errors import DataError
from needleplan.signals import insertion_cycles, lspb

numbers = st.floats(0.5, 120)


def test_the_profile_of_the_thesis() -> None:
    motion = insertion_cycles(80.0, 10.0)
    assert motion.time_s[-1] == pytest.approx(2 * (80 / 10 + 0.5))
    assert motion.depth_mm.max() == pytest.approx(80, abs=1e-12)
    assert motion.velocity_mm_s.max() == pytest.approx(10)
    half = len(motion) // 2
    assert motion.velocity_mm_s[half] == 0
    assert motion.direction[half] == 1  # the reversal belongs to the insertion
    assert (motion.direction[half + 1 :] == -1).all()
    assert motion.depth_mm[-1] == pytest.approx(0, abs=1e-12)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(
    depths=st.lists(numbers, min_size=2, max_size=5, unique=True), speed=st.floats(0.4, 30), blend=st.floats(0.05, 1)
)
def test_depth_is_the_integral_of_velocity_and_limits_hold(depths: list[float], speed: float, blend: float) -> None:
    if min(abs(np.diff(depths))) < 0.2:
        depths = list(np.arange(len(depths)) * 1.0)
    motion = lspb(depths, [speed] * (len(depths) - 1), blend_s=blend, rate_hz=2000)
    integral = depths[0] + cumulative_simpson(motion.velocity_mm_s, x=motion.time_s, initial=0)
    np.testing.assert_allclose(motion.depth_mm, integral, atol=2e-3)
    assert np.abs(motion.velocity_mm_s).max() <= speed * (1 + 1e-9)
    assert np.abs(np.diff(motion.velocity_mm_s)).max() * 2000 <= speed / blend * (1 + 1e-6)
    assert motion.depth_mm[-1] == pytest.approx(depths[-1], abs=1e-9)
    assert min(depths) - 1e-9 <= motion.depth_mm.min()
    assert motion.depth_mm.max() <= max(depths) + 1e-9


def test_dwells_and_cycles() -> None:
    motion = insertion_cycles(20.0, 5.0, retraction_mm_s=10.0, cycles=3, dwell_s=2.0, pause_s=1.0, rate_hz=100.0)
    assert motion.time_s[-1] == pytest.approx(3 * (4.5 + 2.5 + 2.0) + 2 * 1.0)
    rest = motion.velocity_mm_s == 0
    at_depth = rest & (motion.depth_mm > 19.999)
    assert at_depth.sum() == 3 * 201
    assert (motion.direction[at_depth] == 1).all()
    assert motion.velocity_mm_s.min() == pytest.approx(-10.0)


def test_a_short_segment_is_a_triangle() -> None:
    motion = lspb([0.0, 0.5], [10.0], blend_s=0.5)
    peak = np.sqrt(10.0 / 0.5 * 0.5)
    assert motion.velocity_mm_s.max() == pytest.approx(peak, rel=0.02)
    assert motion.depth_mm[-1] == pytest.approx(0.5)


def test_all_mistakes_are_told_at_once() -> None:
    with pytest.raises(DataError) as raised:
        lspb([0.0, 10.0, 10.0], [0.0, float("nan")], blend_s=-1.0, dwells_s=[0.0, -1.0], rate_hz=200)
    assert [each.key for each in raised.value.mistakes] == [
        "velocities_mm_s", "velocities_mm_s", "blend_s", "dwells_s", "depths_mm",
    ]  # fmt: skip
    with pytest.raises(DataError, match="cycles"):
        insertion_cycles(80.0, 10.0, cycles=0)
    with pytest.raises(DataError, match="one fewer"):
        lspb([0.0, 10.0], [1.0, 1.0])
