"""A pose that repeats bit for bit while the stage moves: the tracker, or the program that passes it on, hangs."""

import pytest

from needleplan.control.safety import Cause, GuardedStage, OperatingState
from needleplan.devices import Health
from tests.control.safety.bench import Bench


def frozen_after_s(bench: Bench, speed_mm_s: float) -> float:
    """Move the stage while the pose repeats, and return the time until the guard notices; 9 s if it does not."""
    began_ns = bench.clock.now_ns()
    for _ in range(round(9.0 / 0.005)):
        bench.stage.depth_mm += speed_mm_s * 0.005
        bench.turn()
        if Cause.POSE_FROZEN in bench.causes:
            return (bench.clock.now_ns() - began_ns) / 1e9
    return 9.0


def test_a_pose_that_repeats_while_the_stage_moves_is_frozen() -> None:
    for speed_mm_s in (5.0, 1.0):
        bench = Bench()
        bench.enabled().insert(50.0, speed_mm_s)
        bench.stage.moving = True
        bench.pose = {"position_mm": (1.0, 2.0, 3.0)}
        assert frozen_after_s(bench, speed_mm_s) == pytest.approx(0.25 + 0.1 / speed_mm_s, abs=0.02)
        assert bench.guard.state.operating is OperatingState.FAULT
        assert bench.stage.wire[-1] == ("stop",)
        # The stage stands, and the pose still repeats: the fault stays until the pose differs.
        bench.turns(0.5)
        assert Cause.POSE_FROZEN in bench.guard.state.present
        bench.pose = {}
        bench.turns(0.02)
        assert Cause.POSE_FROZEN not in bench.guard.state.present


def test_a_pose_may_repeat_while_the_stage_stands_or_only_turns(bench: Bench, guard: GuardedStage) -> None:
    """A simulated tracker without noise says the same at rest, and a coil with five degrees of freedom has no roll."""
    bench.pose = {"position_mm": (1.0, 2.0, 3.0)}
    bench.turns(2.0)
    guard.rotate(3.0, 3.0)
    bench.stage.moving = True
    for _ in range(200):
        bench.stage.roll_rad += 3.0 * 0.005
        bench.turn()
    assert Cause.POSE_FROZEN not in bench.causes
    # The motion begins, and the pose follows: no time at rest counts.
    bench.stage.depth_mm += 0.2
    bench.turn()
    bench.pose = {}
    bench.turns(0.3)
    assert Cause.POSE_FROZEN not in bench.causes


def test_a_frozen_pose_is_noticed_through_poses_without_a_coil(bench: Bench) -> None:
    bench.enabled().insert(50.0, 5.0)
    bench.stage.moving = True
    for turn in range(80):
        bench.stage.depth_mm += 5.0 * 0.005
        bench.pose = {"health": Health.MISSING} if turn % 5 == 4 else {"position_mm": (1.0, 2.0, 3.0)}
        bench.turn()
    assert Cause.POSE_FROZEN in bench.causes
