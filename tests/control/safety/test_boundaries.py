"""Exactly at a limit is allowed, the next number beyond it is not: every limit, by the pure functions."""

import math
from dataclasses import replace
from typing import Any

import pytest

from needleplan.control.safety import Cause, Inputs, SafetyLimits, validate
from needleplan.control.safety._limits import against_insertion, against_retraction, against_rotation
from needleplan.devices import ForceSample, PoseSample, StageSample, Stamp

LIMITS = SafetyLimits(workspace_x_mm=(0.0, 60.0), workspace_y_mm=(-20.0, 20.0))
HERE = StageSample(Stamp(0, 1), 40.0, 0.0, 0.0, False)
NOW_NS = 10**12
UP, DOWN = math.inf, -math.inf


def beyond(value: float, direction: float) -> float:
    return math.nextafter(value, direction)


@pytest.mark.parametrize(
    ("depth_mm", "velocity_mm_s", "direction"),
    [(150.0, 5.0, UP), (-100.0, 5.0, DOWN), (50.0, 10.0, None), (40.0, 20.0, None), (30.0, 20.0, None)],
)
def test_insertions(depth_mm: float, velocity_mm_s: float, direction: float | None) -> None:
    assert against_insertion(LIMITS, HERE, depth_mm, velocity_mm_s) == frozenset()
    if direction is not None:
        assert against_insertion(LIMITS, HERE, beyond(depth_mm, direction), velocity_mm_s) == {Cause.DEPTH_BEYOND}
    else:
        assert against_insertion(LIMITS, HERE, depth_mm, beyond(velocity_mm_s, UP)) == {Cause.VELOCITY_BEYOND}
    assert against_insertion(LIMITS, HERE, depth_mm, 0.0) == {Cause.VELOCITY_BEYOND}
    assert against_insertion(LIMITS, HERE, depth_mm, beyond(0.0, UP)) == frozenset()


def test_inward_begins_where_the_stage_is() -> None:
    assert against_insertion(LIMITS, HERE, beyond(40.0, UP), 20.0) == {Cause.VELOCITY_BEYOND}
    assert against_insertion(LIMITS, None, 30.0, 20.0) == {Cause.VELOCITY_BEYOND}


@pytest.mark.parametrize("side", [-1, 1])
def test_rotations(side: int) -> None:
    assert against_rotation(LIMITS, side * 25.0, 12.0) == frozenset()
    assert against_rotation(LIMITS, side * beyond(25.0, UP), 12.0) == {Cause.ROLL_BEYOND}
    assert against_rotation(LIMITS, side * 1.0, beyond(12.0, UP)) == {Cause.ROTATION_BEYOND}
    assert against_rotation(LIMITS, side * 1.0, 0.0) == {Cause.ROTATION_BEYOND}
    assert against_rotation(LIMITS, side * 1.0, beyond(0.0, UP)) == frozenset()


def test_retractions() -> None:
    assert against_retraction(LIMITS, HERE, 40.0, 20.0) == frozenset()
    assert against_retraction(LIMITS, HERE, beyond(40.0, UP), 20.0) == {Cause.NOT_A_RETRACTION}
    assert against_retraction(LIMITS, HERE, -100.0, 20.0) == frozenset()
    assert against_retraction(LIMITS, HERE, beyond(-100.0, DOWN), 20.0) == {Cause.DEPTH_BEYOND}
    assert against_retraction(LIMITS, None, -100.0, 20.0) == frozenset()
    assert against_retraction(LIMITS, None, beyond(-100.0, UP), 20.0) == {Cause.NOT_A_RETRACTION}
    assert against_retraction(LIMITS, HERE, 0.0, beyond(20.0, UP)) == {Cause.VELOCITY_BEYOND}
    assert against_retraction(LIMITS, HERE, 0.0, 0.0) == {Cause.VELOCITY_BEYOND}


def inputs(**changed: Any) -> Inputs:
    """Return inputs that are well at NOW_NS, but for what is changed: `force_n`, `stage_ns`, `tip_mm` and so on."""
    stamps = {name: Stamp(changed.get(f"{name}_ns", NOW_NS), 2) for name in ("force", "pose", "stage")}
    force = ForceSample(stamps["force"], (0.0, 0.0, changed.get("force_n", 1.0)), (0.0, 0.0, 0.0))
    before = PoseSample(Stamp(stamps["pose"].received_ns, 1), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), 0.1)
    pose = replace(before, stamp=stamps["pose"], position_mm=(changed.get("step_mm", 0.0), 0.0, 0.0))
    stage = StageSample(stamps["stage"], changed.get("depth_mm", 10.0), 0.0, 0.0, False)
    tip_mm, plane_mm = changed.get("tip_mm", (1.0, 1.0)), changed.get("plane_mm", 0.0)
    return Inputs().with_force(force).with_pose(before, tip_mm, plane_mm).with_pose(pose, tip_mm, plane_mm).with_stage(
        stage
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "at", "after", "cause"),
    [
        ("force_n", 5.0, beyond(5.0, UP), Cause.FORCE_EXCEEDED),
        ("force_n", -5.0, beyond(-5.0, DOWN), Cause.FORCE_EXCEEDED),
        ("force_ns", NOW_NS - 30_000_000, NOW_NS - 30_000_001, Cause.FORCE_STALE),
        ("pose_ns", NOW_NS - 45_000_000, NOW_NS - 45_000_001, Cause.POSE_STALE),
        ("stage_ns", NOW_NS - 30_000_000, NOW_NS - 30_000_001, Cause.STAGE_STALE),
        ("force_ns", NOW_NS + 5_000_000, NOW_NS + 5_000_001, Cause.CLOCK_MISMATCH),
        ("pose_ns", NOW_NS + 5_000_000, NOW_NS + 5_000_001, Cause.CLOCK_MISMATCH),
        ("stage_ns", NOW_NS + 5_000_000, NOW_NS + 5_000_001, Cause.CLOCK_MISMATCH),
        ("step_mm", 3.0, beyond(3.0, UP), Cause.POSE_JUMPED),
        ("plane_mm", 5.0, beyond(5.0, UP), Cause.OUT_OF_PLANE),
        ("plane_mm", -5.0, beyond(-5.0, DOWN), Cause.OUT_OF_PLANE),
        ("tip_mm", (60.0, 20.0), (beyond(60.0, UP), 20.0), Cause.OUT_OF_WORKSPACE),
        ("tip_mm", (0.0, -20.0), (beyond(0.0, DOWN), -20.0), Cause.OUT_OF_WORKSPACE),
        ("tip_mm", (60.0, 20.0), (60.0, beyond(20.0, UP)), Cause.OUT_OF_WORKSPACE),
        ("tip_mm", (0.0, -20.0), (0.0, beyond(-20.0, DOWN)), Cause.OUT_OF_WORKSPACE),
        ("tip_mm", (1.0, 1.0), (1.0, math.nan), Cause.TIP_UNKNOWN),
        ("tip_mm", (1.0, 1.0), None, Cause.TIP_UNKNOWN),
        ("plane_mm", 0.0, math.inf, Cause.TIP_UNKNOWN),
        ("depth_mm", 150.5, beyond(150.5, UP), Cause.DEPTH_EXCEEDED),
        ("depth_mm", -100.5, beyond(-100.5, DOWN), Cause.DEPTH_EXCEEDED),
    ],
)
def test_inputs(name: str, at: Any, after: Any, cause: Cause) -> None:
    assert validate(inputs(**{name: at}), LIMITS, NOW_NS) == frozenset()
    assert validate(inputs(**{name: after}), LIMITS, NOW_NS) == {cause}


def test_without_inputs_nothing_is_well() -> None:
    assert validate(Inputs(), LIMITS, NOW_NS) == {Cause.FORCE_STALE, Cause.POSE_STALE, Cause.STAGE_STALE}


@pytest.mark.parametrize("age_ns", [0, 30_000_000, 30_000_001])
def test_where_the_stage_is_is_known_as_long_as_it_is_young(age_ns: int) -> None:
    known = inputs(stage_ns=NOW_NS - age_ns).stage_known(LIMITS, NOW_NS)
    assert (known is not None) == (age_ns <= 30_000_000)
