"""Small rolls of the bevel that bring the tip back to the plane of the plan."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from needleplan.control import InsertionOutcome, Options
from needleplan.control._plane import in_plane_per_mm, plane_roll_rad
from needleplan.errors import InputError
from needleplan.estimation.tip import TipEstimate, TipStatus
from needleplan.models import TipFrame
from needleplan.simulation import Effects, SimulatedEntry
from tests.control.scenes import FAST, a_lab, run_in, small_table

BEND, MOST = 0.025, 0.35


def estimate(z: float, elevation: float, roll: float) -> TipEstimate:
    numbers = dict.fromkeys(TipEstimate.__dataclass_fields__, 0.0)
    known: dict[str, Any] = {"status": TipStatus.TRACKING, "time_ns": 0, "curvature_per_mm": BEND}
    return TipEstimate(**(numbers | known | {"z_mm": z, "elevation_rad": elevation, "roll_rad": roll}))


@pytest.mark.parametrize("bevel", [1, -1])
@pytest.mark.parametrize(("z", "elevation"), [(1.0, 0.02), (-2.0, 0.0), (0.0, -0.05), (1.5, -0.01)])
def test_the_path_comes_back_to_the_plane(bevel: int, z: float, elevation: float) -> None:
    """Decisions every 4 mm over 60 mm, with arcs in 3D that share no code with the rule."""
    frame = TipFrame.planar(0.0, 0.0, 0.0).raised(elevation).moved((0.0, 0.0, z))
    roll = 0.0 if bevel > 0 else math.pi
    largest = 0.0
    for number in range(15):
        tip = estimate(frame.position_mm[2], math.asin(frame.tangent[2]), roll)
        found = plane_roll_rad(tip, 60.0 - 4.0 * number, 1.0, MOST)
        if found is not None:
            roll = found if bevel > 0 else math.pi - found
            largest = max(largest, abs(found))
        frame = frame.arc(BEND * math.cos(roll), BEND * math.sin(roll), 4.0)
    assert abs(frame.position_mm[2]) < 0.35
    assert largest <= MOST


def test_a_small_miss_and_a_miss_that_cannot_be_mended_stop_no_needle() -> None:
    assert plane_roll_rad(estimate(0.2, 0.0, 0.0), 50.0, 1.0, MOST) is None
    assert plane_roll_rad(estimate(3.0, 0.0, 0.0), 2.0, 1.0, MOST) is None
    assert plane_roll_rad(estimate(3.0, 0.0, 0.0), 50.0, 1.0, 0.0) is None
    wanted = plane_roll_rad(estimate(1.0, 0.0, 0.0), 50.0, 1.0, MOST)
    assert wanted == pytest.approx(math.asin(-3 / (BEND * 50**2)))
    assert in_plane_per_mm(estimate(0.0, 0.0, math.pi - 0.3)) == pytest.approx(BEND * math.cos(0.3))


def ends(elevation: float, plane_roll: float, seeds: int = 3) -> list[tuple[float, float, InsertionOutcome]]:
    """Ends of insertions whose tip enters out of the plane: true distance from it, seen distance, outcome."""
    found = []
    for seed in range(seeds):
        x, y, heading, _ = small_table().best_entry().pose
        effects = Effects(tracker_noise_mm=0.05, tracker_angle_noise_rad=0.005)
        lab = a_lab(effects, seed, entry=SimulatedEntry(x, y, heading, elevation_rad=elevation))
        report = run_in(lab, replace(FAST, plane_roll_rad=plane_roll))
        found.append((lab.plant.tip().position_mm[2], report.error_out_of_plane_mm, report.outcome))
        assert report.error_in_space_mm == pytest.approx(math.hypot(report.error_mm, report.error_out_of_plane_mm))
        record = report.record()
        assert record["error_in_space_mm"] == report.error_in_space_mm
    return found


@pytest.mark.study
def test_the_loop_brings_a_tilted_needle_back_and_counts_the_distance_in_space() -> None:
    without = ends(0.08, 0.0, seeds=1)
    assert abs(without[0][0]) > 1.5
    assert without[0][2] is InsertionOutcome.MISSED
    corrected = ends(0.08, 0.35)
    assert np.mean([abs(each[0]) for each in corrected]) < 0.6
    assert [each[2] for each in corrected] == [InsertionOutcome.TARGET] * len(corrected)
    for true, seen, _ in corrected:
        assert abs(true) == pytest.approx(seen, abs=0.3)


def test_the_largest_roll_is_a_small_angle() -> None:
    with pytest.raises(InputError, match="plane_roll_rad"):
        Options(plane_roll_rad=1.2)
