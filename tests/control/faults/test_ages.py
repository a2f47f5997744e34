"""Streams that come later and later: each is stale by the clock of its own device, before its samples mislead."""

from pathlib import Path

import pytest

from needleplan.control.safety import Cause, OperatingState
from tests.control.faults.rig import Rig
from tests.control.faults.robot_rig import RobotRig
from tests.control.faults.slow_link import SlowLink

GROWTH = 0.05  # s by which the delay grows each second


@pytest.mark.parametrize(("source", "cause", "state"), [
    ("box_link", Cause.FORCE_STALE, OperatingState.FAULT), ("aurora_link", Cause.POSE_STALE, OperatingState.PAUSED),
])  # fmt: skip
def test_a_sensor_that_comes_50_ms_later_each_second(
    source: str, cause: Cause, state: OperatingState, tmp_path: Path
) -> None:
    rig = Rig(tmp_path / "run.mcap")
    begins_s = 0.5
    slow = SlowLink(getattr(rig, source), rig.clock, lambda time_s: GROWTH * max(time_s - begins_s, 0.0))
    setattr(rig, source, slow)
    rig.begin()
    rig.turns(begins_s - (rig.clock.now_ns() * 1e-9 - 1e3))
    began_ns = rig.clock.now_ns()
    rig.turns(2.0)
    first = rig.first_stop()
    assert first is not None
    assert first.causes == {cause}
    assert first.state is state
    assert (first.time_ns - began_ns) * 1e-9 < 0.7  # 30 ms at 50 ms a second; a frame more for the tracker
    rig.close()


def test_a_robot_that_comes_50_ms_later_each_second() -> None:
    rig = RobotRig()
    rig.begin()
    began_ns, way = rig.bench.clock.now_ns(), rig.bench.network.from_robot
    while rig.state == "ENABLED" and rig.bench.clock.now_ns() - began_ns < 2e9:
        way.delay_s = GROWTH * (rig.bench.clock.now_ns() - began_ns) * 1e-9
        rig.turn()
    state, causes, left_ns = rig.left_enabled()
    assert state == "FAULT"
    assert causes & {Cause.STAGE_STALE, Cause.STAGE_FAULT}
    assert (left_ns - began_ns) * 1e-9 < 0.7


@pytest.mark.parametrize("field", ["depth_mm", "velocity_mm_s", "roll_rad"])
def test_a_stage_that_is_not_finite_is_suspect_and_not_on_the_wrong_way(field: str, tmp_path: Path) -> None:
    rig = Rig(tmp_path / "run.mcap")
    rig.begin()
    read = rig.stage.read

    def broken(timeout_s: float):  # type: ignore[no-untyped-def]
        from dataclasses import replace

        return replace(read(timeout_s), **{field: float("nan")})

    rig.stage.read = broken  # type: ignore[method-assign]
    took_s = rig.turns_until_stop(0.2)
    first = rig.first_stop()
    assert first is not None
    assert first.causes == {Cause.STAGE_SUSPECT}
    assert took_s <= 0.04
    rig.close()
