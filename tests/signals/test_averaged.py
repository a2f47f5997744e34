"""Motions whose samples are means: models along them against the means of a much finer simulation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleplan.models import Model, ShaftAndTip, simulate
from needleplan.models.effects import AddedEffect, with_effect
from needleplan.signals import Motion, averaged_motion, lspb, parts_of

BASE = ShaftAndTip(friction=0.03, cutting=0.4, onset_mm=4.0, presliding_mm=0.2)
DELAYED = with_effect(BASE, AddedEffect("latency", {"size": 0.03}))
RELAXING = with_effect(BASE, AddedEffect("relaxation", {"size": 0.2, "time_s": 0.3, "recovery_mm": 0.3}))


def strokes(rate_hz: float) -> Motion:
    return lspb([-2, 30, 18, 40, -2], [6, 4, 9, 8], dwells_s=[0.8, 0, 1, 0], rate_hz=rate_hz)


def means(model: Model, rate_hz: float, block: int) -> np.ndarray:
    """Mean output over the interval about each sample of the averaged motion, from a simulation at 2 kHz."""
    fine = strokes(2000.0)
    output = simulate(model, fine).output
    width = block / rate_hz
    centres = averaged_motion(strokes(rate_hz), block).time_s
    area = np.concatenate([[0.0], np.cumsum((output[1:] + output[:-1]) / 2 * np.diff(fine.time_s))])
    ends = [np.interp(centres + side * width / 2, fine.time_s, area) for side in (-1, 1)]
    return (ends[1] - ends[0]) / width


@pytest.mark.parametrize("model", [BASE, DELAYED, RELAXING], ids=["base", "delayed", "relaxing"])
@pytest.mark.parametrize(("rate_hz", "block"), [(50.0, 1), (100.0, 2), (200.0, 4), (500.0, 9)])
def test_outputs_are_means_over_the_sample_intervals(model: Model, rate_hz: float, block: int) -> None:
    averaged = averaged_motion(strokes(rate_hz), block)
    exact = means(model, rate_hz, block)[1:-1]
    error = np.abs(simulate(model, averaged).output[1:-1] - exact)
    # the friction reverses by more than 2 N; the plain motion is wrong by up to a third of this
    assert error.max() < 0.04
    assert np.sqrt(np.mean(error**2)) < 0.004
    plain = np.abs(simulate(model, averaged[:]).output[1:-1] - exact)
    assert np.sqrt(np.mean(error**2)) < 0.35 * np.sqrt(np.mean(plain**2))


@settings(max_examples=40, deadline=None)
@given(st.floats(3.0, 28.0), st.floats(0.3, 10.0), st.sampled_from([(50.0, 1), (200.0, 4), (500.0, 9)]))
def test_a_burst_within_an_interval_has_its_mean(depth_mm: float, bulge_mm: float, rate: tuple[float, int]) -> None:
    values = {"size": 1.0, "depth_mm": depth_mm, "bulge_mm": bulge_mm}
    bursting = with_effect(BASE, AddedEffect("puncture", values))
    averaged = averaged_motion(strokes(rate[0]), rate[1])
    exact = (means(bursting, *rate) - means(BASE, *rate))[1:-1]
    gained = (simulate(bursting, averaged).output - simulate(BASE, averaged).output)[1:-1]
    assert np.abs(gained - exact).max() < 0.05  # with the values at the mean depths of the instants 0.1 N
    middle = simulate(bursting, averaged[:]).output - simulate(BASE, averaged[:]).output
    assert np.abs(gained - exact).sum() < 0.5 * np.abs(middle[1:-1] - exact).sum()


def test_readings_at_instants_stand_for_no_travel() -> None:
    assert not averaged_motion(strokes(50.0), 1, instants=True).fine.span_mm.any()
    assert averaged_motion(strokes(50.0), 1).fine.span_mm.max() == pytest.approx(9 / 50, rel=0.02)


def test_most_samples_keep_one_instant() -> None:
    averaged = averaged_motion(strokes(200.0), 4)
    assert len(averaged.fine) < 3 * len(averaged)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(-20, 20), min_size=4, max_size=60), st.integers(1, 5), st.sampled_from([0.002, 0.01, 0.02, 0.1])
)
def test_any_motion_has_increasing_instants_and_the_means_of_its_samples(
    speeds: list[float], block: int, interval: float
) -> None:
    velocity = np.array(speeds)
    time = interval * np.arange(len(velocity))
    depth = np.concatenate([[0.0], np.cumsum((velocity[1:] + velocity[:-1]) / 2 * interval)])
    if len(velocity) < 2 * block:
        return
    averaged = averaged_motion(Motion.sampled(time, depth, velocity), block)
    assert (np.diff(averaged.fine.time_s) > 0).all()
    assert len(averaged) == len(velocity) // block
    assert np.isfinite(averaged.fine.depth_mm).all()
    np.testing.assert_allclose(averaged.mean(averaged.fine.time_s), averaged.time_s, atol=1e-9)
    if velocity.min() >= 0:  # no reversal is added
        assert averaged.fine.velocity_mm_s.min() >= -1e-9


def test_means_of_several_rows() -> None:
    averaged = averaged_motion(strokes(100.0), 2)
    values = np.vstack([averaged.fine.depth_mm, np.ones(len(averaged.fine))])
    found = averaged.mean(values)
    assert found.shape == (2, len(averaged))
    np.testing.assert_allclose(found[1], 1.0)


def test_readings_at_instants_are_the_values_at_the_samples():
    motion = strokes(50.0)
    instants = averaged_motion(motion, 1, instants=True)
    np.testing.assert_array_equal(instants.fine.depth_mm, motion.depth_mm)
    np.testing.assert_array_equal(instants.mean(motion.depth_mm), motion.depth_mm)
    assert len(averaged_motion(motion, 1).fine) > len(motion)
    assert (parts_of(motion), parts_of(strokes(500.0))) == (4, 1)
