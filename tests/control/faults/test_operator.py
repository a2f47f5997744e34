"""Fault 36: what operator and planner get wrong; nothing moves, or nothing goes on moving."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from needleplan.control import Insertion, InsertionOutcome
from needleplan.control.safety import Cause, OperatingState, SafetyLimits
from needleplan.errors import MotionRefused, TableError
from needleplan.planning import PolicyTable
from tests.control.safety.bench import Bench
from tests.control.scenes import FAST, a_lab, small_table, station_of

WIDE = SafetyLimits(insertion_velocity_mm_s=50.0, pose_age_s=0.5)


@pytest.mark.parametrize(
    ("limits", "cause"),
    [
        (replace(WIDE, insertion_velocity_mm_s=19.0), Cause.VELOCITY_BEYOND),
        (replace(WIDE, rotation_velocity_rad_s=9.0), Cause.ROTATION_BEYOND),
        (replace(WIDE, deepest_mm=1.0), Cause.DEPTH_BEYOND),
        (replace(WIDE, roll_rad=0.1), Cause.ROLL_BEYOND),
    ],
)
def test_36_a_plan_beyond_a_limit_ends_the_run_where_it_would_be_passed(limits: SafetyLimits, cause: Cause) -> None:
    lab = a_lab()
    station = station_of(lab)
    with Insertion(small_table(), station, FAST, limits=limits, accepted_limits="a fast lab") as insertion:
        report = insertion.run()
        assert report.outcome in (InsertionOutcome.FAULT, InsertionOutcome.REFUSED)
        assert cause in report.cause
        lab.advance(1.0)
        assert not lab.plant.moving
        assert lab.plant.insertion.position <= limits.deepest_mm + limits.following_mm
        assert insertion.guard.state.operating is not OperatingState.ENABLED


@pytest.mark.parametrize("target", [(math.nan, 5.0), (10.0, math.nan), (math.inf, 5.0)])
def test_36_a_target_that_is_no_number(target: tuple[float, float]) -> None:
    bench = Bench()
    guard = bench.enabled()
    with pytest.raises(MotionRefused, match="not_finite"):
        guard.insert(*target)
    assert bench.stage.wire == []


def test_36_the_plan_has_no_answer() -> None:
    bench = Bench()
    guard = bench.enabled()
    guard.insert(20.0, 5.0)
    guard.report({Cause.PLAN_LOST}, "the pose is outside of the table")
    assert bench.stage.wire[-1] == ("stop",)
    assert guard.state.operating is OperatingState.PAUSED
    assert any("outside of the table" in each.text for each in bench.events)
    guard.report(())
    assert guard.state.operating is OperatingState.PAUSED
    assert not guard.state.present


@pytest.mark.parametrize("how", ["missing", "cut", "changed", "another file"])
def test_36_a_table_that_is_none_is_refused_before_anything_is_opened(how: str, tmp_path: Path) -> None:
    file = tmp_path / "table.h5"
    if how != "missing":
        small_table().write(file)
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 1
        contents = {"cut": bytes(data[: len(data) // 2]), "changed": bytes(data), "another file": b"[workspace]\n"}
        file.write_bytes(contents[how])
    with pytest.raises(TableError, match=str(file)):
        PolicyTable.read(file)
