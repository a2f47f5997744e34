"""Faults of a force sensor: each is found once, and sound readings of all kinds of sensors have none."""

import numpy as np
import pytest

from needleplan.models import ShaftAndTip, simulate
from needleplan.signals import Array, Record, fault_notes, lspb, still_parts

MOTION = lspb([-2, 30, 20, 60, -2], [4, 8, 6, 12], dwells_s=[1, 0, 2, 0], rate_hz=100)
OUTPUT = simulate(ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.05), MOTION).output
NOISE = np.random.default_rng(0).normal(0, 0.01, len(MOTION))
FORCE = np.round(OUTPUT + NOISE, 5)
TIME = MOTION.time_s


def notes(force: Array) -> list[str]:
    columns = {"time_s": TIME, "depth_mm": MOTION.depth_mm, "velocity_mm_s": MOTION.velocity_mm_s}
    return fault_notes(Record({**columns, "force_n": force}, "one"))


FAULTS = {
    "stuck while it moves": (np.where((TIME > 9) & (TIME < 14), FORCE[900], FORCE), "stands still at 0.", "for 4.9"),
    "zeros": (np.where((TIME > 9) & (TIME < 10), 0.0, FORCE), "force_n stands still at 0 N for 0.98 s from 9.01 s on"),
    "clipped": (np.clip(FORCE, -0.4, 0.5), "force_n is saturated at -0.4 N and 0.5 N: "),
    "spikes": (np.where(np.arange(FORCE.size) % 700 == 3, 20.0, FORCE), "samples that are spikes of up to 20 N"),
    "twice": (np.where((TIME > 9) & (TIME < 10) | (TIME > 15) & (TIME < 15.5), 0.0, FORCE), "and in 1 more parts"),
    "stuck with steps as large as the noise": (
        np.where((TIME > 9) & (TIME < 12), 0.55, 0.01 * np.round(FORCE / 0.01)), "stands still at 0.55 N for 2.98 s",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", FAULTS)
def test_a_fault_has_one_note(case: str) -> None:
    force, *says = FAULTS[case]
    (note,) = notes(force)
    assert all(each in note for each in says), note


SOUND = {
    "noise": FORCE,
    "no noise": OUTPUT,
    "no noise, stepwise": np.round(OUTPUT, 2),
    "coarse steps": 0.05 * np.round(FORCE / 0.05),
    "steps as large as the noise": 0.01 * np.round(FORCE / 0.01),
    "coarse steps and little noise": 0.02 * np.round((OUTPUT + 0.1 * NOISE) / 0.02),
    "held samples": FORCE[np.arange(FORCE.size) // 20 * 20],
    "a puncture": FORCE - 0.4 * (TIME > 8),
    "filtered noise": OUTPUT + np.convolve(NOISE, np.ones(9) / 9, "same"),
    "missing": np.where(np.arange(FORCE.size) % 7 == 0, np.nan, FORCE),
    "noise alone": NOISE,
}


@pytest.mark.parametrize("case", SOUND)
def test_a_sound_reading_has_no_note(case: str) -> None:
    assert notes(SOUND[case]) == []


def test_a_reading_at_rest_without_a_depth_stands_still_only_if_its_noise_ends() -> None:
    assert still_parts(NOISE) == []
    assert still_parts(np.where((TIME > 9) & (TIME < 10), NOISE[5], NOISE)) == [(901, 1000)]
