"""The alarm of the guard: a needle that moves in spite of a stop, or whose rest is unknown."""

import pytest

from needleplan.control.safety import OperatingState, Order
from needleplan.stopping import Rest
from tests.control.safety.bench import Bench


@pytest.mark.parametrize("fails", [False, True])
def test_an_alarm_is_raised_once_and_the_heartbeats_are_withheld_until_the_needle_rests(fails: bool) -> None:
    alarms: list[Rest] = []

    def alarm(rest: Rest) -> None:
        alarms.append(rest)
        if fails:
            raise OSError("the terminal is gone")

    bench = Bench(on_alarm=alarm)
    guard = bench.enabled()
    guard.insert(50.0, 5.0)
    guard.order(Order.PAUSE)
    beats: list[int] = []
    bench.stage.heartbeat = lambda: beats.append(bench.clock.now_ns())  # type: ignore[method-assign]
    for _ in range(60):
        bench.stage.depth_mm += 0.025
        bench.turn()
    assert alarms == [Rest.MOVES]
    assert guard.rest is Rest.MOVES
    assert guard.state.operating is OperatingState.FAULT
    assert 20 < len(beats) < 30  # as long as it may brake: 0.625 mm at 5 mm/s
    count = len(bench.stage.wire)
    bench.turns(0.1)
    assert guard.rest is Rest.RESTS
    assert len(bench.stage.wire) <= count + 2
    assert len(beats) > 30


def test_an_unknown_rest_is_an_alarm_only_after_a_motion() -> None:
    for moves in (False, True):
        alarms: list[Rest] = []
        bench = Bench(on_alarm=alarms.append)
        guard = bench.enabled()
        if moves:
            guard.insert(50.0, 5.0)
        guard.stop()
        bench.without = {"stage"}
        bench.turns(0.2)
        assert guard.rest is Rest.UNKNOWN
        assert alarms == [Rest.UNKNOWN] * moves


@pytest.mark.parametrize("speed_rad_s", [0.03, 0.07, 3.0])
def test_a_needle_that_turns_on_after_a_rotation_never_rests(speed_rad_s: float) -> None:
    alarms: list[Rest] = []
    bench = Bench(on_alarm=alarms.append)
    guard = bench.enabled()
    guard.rotate(6.0, speed_rad_s)
    guard.stop()
    seen = set()
    for _ in range(200):
        bench.stage.roll_rad += 0.005 * speed_rad_s
        bench.turn()
        seen.add(guard.rest)
    assert Rest.RESTS not in seen
    assert alarms == [Rest.MOVES]
