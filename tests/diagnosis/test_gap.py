"""Location of a gap, and the description of an unexplained one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from needleplan.diagnosis import GapAxis, Library, MotionPhase, Verdict, diagnose, motion_phases
from needleplan.diagnosis.calibration import calibrate
from needleplan.diagnosis.data import fit_noise
from needleplan.diagnosis.gap import axis_values, localise
from needleplan.diagnosis.likelihood import JointLikelihood
from needleplan.models import simulate
from needleplan.models.effects import SIZE, effect_named, known_effects, register_file
from needleplan.reports.diagnosis import effect_file_text
from needleplan.signals import Motion, Record, insertion_cycles
from tests.diagnosis.trials import BASE, motion, recordings


def calibrated(data: list[Record]):  # type: ignore[no-untyped-def]
    noise = fit_noise([data[3]["force_n"]])
    found = calibrate(BASE, data[:2], data[2:3], noise)
    return found, JointLikelihood([trial.whitened for trial in found.training])


def test_a_gap_is_found_where_it_is() -> None:
    found, likelihood = calibrated(recordings({"bump": {SIZE: 0.3, "depth_mm": 40.0, "width_mm": 2.0}}, seed=3))
    where = localise(likelihood, found.training)
    depths = [each for each in where.bins if each.axis == "depth_mm"]
    worst = max(depths, key=lambda each: each.share)
    low, high = (float(word) for word in worst.label.split(" mm")[0].split(" to "))
    assert low <= 41
    assert high >= 39
    assert worst.p_value < 0.01
    assert sum(each.share for each in depths) == pytest.approx(1.0)


def test_a_change_point_has_an_interval_that_holds_it() -> None:
    hidden = {"cutting_layer": {SIZE: 0.08, "depth_mm": 37.0, "width_mm": 0.5}}
    found = diagnose(BASE, recordings(hidden, seed=3), library=Library([effect_named("cutting_layer")], BASE))
    (change,) = [each for each in found.localisation.changes if each.axis is GapAxis.DEPTH]
    assert change.low - 1 <= 37.0 <= change.high + 1
    assert change.high - change.low < 5


def test_without_a_gap_few_bins_are_called_large() -> None:
    called = 0
    for seed in range(6):
        found, likelihood = calibrated(recordings(seed=seed))
        called += len(localise(likelihood, found.training, seed=seed).where(0.01))
    assert called <= 3  # of 6 data sets with 5 axes each, 0.3 are expected


def test_phases() -> None:
    found = motion_phases(insertion_cycles(30.0, 5.0, dwell_s=1.0, rate_hz=50))
    assert {*found.tolist()} == {MotionPhase.ADVANCE, MotionPhase.DWELL, MotionPhase.REVERSAL, MotionPhase.RETRACTION}
    assert found[100] == MotionPhase.ADVANCE
    assert found[-100] == MotionPhase.RETRACTION


def test_an_unexplained_gap_is_described_and_can_be_named(tmp_path: Path) -> None:
    data = recordings({"viscous": {SIZE: 3e-4}}, seed=1)
    found = diagnose(BASE, data, library=Library([effect_named("inertia")], BASE))
    assert found.verdict is Verdict.UNKNOWN
    assert found.decision.axis is GapAxis.SPEED
    assert found.described is not None
    assert any("velocity_mm_s" in each.text for each in found.described.formula)
    (tmp_path / "speedy.py").write_text(effect_file_text(found.described, "speedy"))
    effect = register_file(str(tmp_path / "speedy.py"))
    del known_effects()["speedy"]
    with_it = effect.apply(found.calibration.model, {SIZE: found.described.rms})
    gained = simulate(with_it, motion(0)).output - simulate(found.calibration.model, motion(0)).output
    truth = (
        simulate(effect_named("viscous").apply(BASE, {SIZE: 3e-4}), motion(0)).output - simulate(BASE, motion(0)).output
    )
    slope = np.polyfit(truth, gained, 1)[0]
    assert 0.3 < slope < 1.7  # what the base does not take up of it


def test_values_along_the_angle_are_angles() -> None:
    time_s, angle_rad = np.arange(5.0), np.linspace(0.0, 3.0, 5)
    turning = Motion.sampled(time_s, 10 * time_s, angle_rad=angle_rad)
    assert axis_values(GapAxis.ANGLE, turning, time_s).tolist() == angle_rad.tolist()
    assert axis_values(GapAxis.PERIOD, turning, time_s).tolist() == turning.depth_mm.tolist()
