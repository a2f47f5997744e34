from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needleplan.diagnosis import FittedEffect
from needleplan.diagnosis.calibration import calibrate
from needleplan.diagnosis.data import fit_axes
from needleplan.diagnosis.joint_fit import fit_jointly
from needleplan.diagnosis.likelihood import JointLikelihood
from needleplan.models.effects import BreathingTissue, Reach, effect_named
from needleplan.signals import Role
from tests.diagnosis.trials import BASE, motion, recordings

TRUTH = {"frequency_hz": 0.256, "phase_rad": 1.9, "rest": 1.0, "size": 11.0}


@given(st.floats(0.01, 20), st.floats(0.05, 0.6), st.floats(-6, 6), st.floats(-1, 1))
def test_tissue_goes_by_the_size_from_end_to_end_and_as_fast_as_it_says(
    size: float, frequency_hz: float, phase_rad: float, rest: float
) -> None:
    needle = motion(0)
    breath = BreathingTissue(base=BASE, size=size, frequency_hz=frequency_hz, phase_rad=phase_rad, rest=rest)
    seen = breath.relative(needle)
    moved = needle.depth_mm - seen.depth_mm
    assert np.ptp(moved) == pytest.approx(size, rel=2e-3)
    rate = np.gradient(moved, needle.time_s)
    assert np.abs(rate - (needle.velocity_mm_s - seen.velocity_mm_s))[1:-1].max() < 2e-2 * size


def test_at_full_rest_it_dwells_where_the_breath_is_out() -> None:
    needle = motion(0)
    breath = BreathingTissue(base=BASE, **TRUTH)
    angle = 2 * np.pi * TRUTH["frequency_hz"] * needle.time_s + TRUTH["phase_rad"]
    usual = TRUTH["size"] * np.cos((angle - np.pi / 2) / 2) ** 4
    assert np.allclose(needle.depth_mm - breath.relative(needle).depth_mm, usual)


def test_breaths_that_turn_the_movement_round_are_reached_from_the_grid() -> None:
    data = recordings({"respiration": TRUTH}, seed=3)
    noise = [each["force_n"] for each in data if each.role is Role.NOISE]
    training = [each for each in data if each.role is Role.TRAIN]
    calibration = calibrate(BASE, training, [], fit_axes([noise]))
    effect, base = effect_named("respiration"), JointLikelihood([trial.whitened for trial in calibration.training])
    grid = effect.grid(Reach.of([trial.motion for trial in calibration.training]))
    middle = np.pi * 25.0  # a phase is told in the middle of a trial

    def off(each: dict[str, float]) -> float:
        later = each["phase_rad"] - TRUTH["phase_rad"] + middle * (each["frequency_hz"] - TRUTH["frequency_hz"])
        far = abs(each["frequency_hz"] - TRUTH["frequency_hz"]) * 60
        return abs(np.angle(np.exp(1j * later))) + abs(np.log(each["size"] / TRUTH["size"])) + far

    found = fit_jointly([FittedEffect(effect, min(grid, key=off))], calibration, base)
    best = fit_jointly([FittedEffect(effect, TRUTH)], calibration, base)
    assert found.likelihood_gain == pytest.approx(best.likelihood_gain, rel=1e-3)
    assert found.effects[0].values["size"] == pytest.approx(TRUTH["size"], rel=0.02)
