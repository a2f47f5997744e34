import math

import numpy as np
import pytest

from needleplan.errors import DataError, ModelError
from needleplan.models import simulate
from needleplan.models.friction import Profile, cutting_force, into_fresh_tissue
from needleplan.signals import Record, Start, sinusoid
from needleplan_thesis.chapter3.published import NEEDLE_MASS_KG, model_ii

MOTION = sinusoid(offset_mm=38, amplitude_mm=25, frequency_hz=0.08, cycles=2, start=Start.MIDDLE)
FRICTION = model_ii(2).with_values(profile=Profile.ISOSCELES)


def test_what_is_added_comes_back() -> None:
    mass = 3.0
    acceleration = np.gradient(MOTION.velocity_mm_s, MOTION.time_s)
    cut = np.where(into_fresh_tissue(MOTION), 0.2, 0.0)
    force = simulate(FRICTION, MOTION).output + mass * acceleration * 1e-3 + cut
    record = Record({
        "time_s": MOTION.time_s, "depth_mm": MOTION.depth_mm, "velocity_mm_s": MOTION.velocity_mm_s, "force_n": force,
    })  # fmt: skip
    parts = cutting_force(record, FRICTION, mass)
    # The two ways to an acceleration differ by the square of the sample interval.
    np.testing.assert_allclose(parts.cutting_n, cut, atol=1e-4)
    np.testing.assert_allclose(parts.friction_n + parts.inertia_n + parts.cutting_n, force, atol=1e-12)


def test_the_inertia_of_the_needles_is_negligible() -> None:
    columns = {"time_s": MOTION.time_s, "depth_mm": MOTION.depth_mm, "velocity_mm_s": MOTION.velocity_mm_s}
    parts = cutting_force(Record({**columns, "force_n": np.zeros(len(MOTION))}), FRICTION, NEEDLE_MASS_KG["B"])
    # m A omega^2, and three to four times as much in the quarter of a cycle in which the motion starts.
    steady = 1e-3 * NEEDLE_MASS_KG["B"] * 25 * (2 * math.pi * 0.08) ** 2
    assert np.abs(parts.inertia_n[1000:]).max() == pytest.approx(steady, rel=1e-3)
    assert steady < 1e-4


def test_fresh_tissue_is_cut_on_the_first_way_in() -> None:
    cuts = into_fresh_tissue(MOTION)
    deepest = int(np.argmax(MOTION.depth_mm))
    assert cuts[2 : deepest - 1].all()
    assert not cuts[deepest + 5 : deepest + 2000].any()
    outward = sinusoid(offset_mm=38, amplitude_mm=25, frequency_hz=0.08, cycles=1, start=Start.MIDDLE, outward=True)
    first = int(np.argmax(into_fresh_tissue(outward)))
    assert outward.depth_mm[first] == pytest.approx(38, abs=0.1)
    assert outward.time_s[first] == pytest.approx((0.5 + 0.125) / 0.08, abs=0.02)


def test_what_is_missing_is_said() -> None:
    with pytest.raises(DataError, match="force_n"):
        cutting_force(Record({"time_s": MOTION.time_s, "depth_mm": MOTION.depth_mm}), FRICTION, 0.01)
    with pytest.raises(ModelError, match="mass_kg"):
        cutting_force(Record({"time_s": MOTION.time_s, "depth_mm": MOTION.depth_mm}), FRICTION, math.nan)
