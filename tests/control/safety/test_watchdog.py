"""The watchdog, in real time: a loop that hangs is stopped, also while it holds the guard."""

import gc
import threading
import time
from collections.abc import Iterator

import pytest

from needleplan.control.safety import (
    Cause,
    GuardedStage,
    OperatingState,
    Order,
    SafetyEvent,
    SafetyEventName,
    SafetyLimits,
    Watchdog,
)
from needleplan.devices import ForceSample, PoseSample, Source, Stage, StageSample, Stamp
from needleplan.errors import DeviceFault, MotionRefused
from tests.recording.samples import wait_for

AGES = {"force_age_s": 10.0, "pose_age_s": 10.0, "stage_age_s": 10.0}


class HangingStage(Stage):
    """Notes stops; a command to insert hangs until `free`."""

    def __init__(self) -> None:
        self.free = threading.Event()
        self.free.set()
        self.stopped = threading.Event()
        self.inserted = False
        self.number = 0

    def insert(self, *_: float) -> None:
        assert self.free.wait(30)
        self.inserted = True

    def rotate(self, *_: float) -> None:
        raise AssertionError

    def stop(self) -> None:
        self.stopped.set()

    def read(self, _: float) -> StageSample | None:
        self.number += 1
        return StageSample(Stamp(time.monotonic_ns(), self.number), 0.0, 0.0, 0.0, False)

    def close(self) -> None:
        self.stopped.set()


class Rig:
    def __init__(self) -> None:
        self.stage = HangingStage()
        self.events: list[SafetyEvent] = []
        self.guard = GuardedStage(
            self.stage, SafetyLimits(**AGES), listener=self.events.append, accepted_limits="a busy machine"
        )
        stamp = Stamp(time.monotonic_ns(), 1)
        self.guard.observe(ForceSample(stamp, (0, 0, 1), (0, 0, 0)))
        self.guard.observe(PoseSample(stamp, (0, 0, 0), (1, 0, 0, 0), 0.1), tip_mm=(0, 0), out_of_plane_mm=0)
        self.guard.read(0)
        self.guard.tick()
        self.guard.order(Order.HOME)

    def rest(self) -> None:
        """Read the stage until an order to go on has seen the needle at rest, or is void."""
        while self.guard.state.waits:
            time.sleep(0.002)
            self.guard.read(0)
            self.guard.tick()

    def enable(self) -> None:
        # A loaded machine may be late here already; then a person would do the same again.
        for _ in range(100):
            try:
                self.guard.tick()
                self.guard.order(Order.RESET)
                self.guard.order(Order.ENABLE)
                self.rest()
                self.guard.insert(10.0, 5.0)
                return
            except MotionRefused:
                continue
        raise AssertionError("never on time")


@pytest.fixture
def rig() -> Iterator[Rig]:
    rig = Rig()
    yield rig
    rig.stage.free.set()
    rig.guard.close()


def test_a_loop_that_hangs_is_stopped(rig: Rig) -> None:
    rig.enable()
    rig.stage.stopped.clear()
    with Watchdog(rig.guard) as watchdog:
        assert rig.stage.stopped.wait(20)
        wait_for(lambda: rig.guard.state.operating is OperatingState.FAULT)
        assert rig.guard.state.latched == {Cause.LOOP_LATE}
        assert watchdog.alive
    assert not watchdog.alive
    # The loop comes back: it is too late, and stays so until a person has been there.
    with pytest.raises(MotionRefused, match="loop_late"):
        rig.guard.insert(10.0, 5.0)
    assert rig.guard.tick().operating is OperatingState.DISABLED


def test_a_loop_that_hangs_in_a_command_is_stopped_over_its_head(rig: Rig) -> None:
    rig.enable()
    rig.guard.order(Order.DISABLE)
    rig.stage.free.clear()
    rig.stage.stopped.clear()
    rig.stage.inserted = False
    loop = threading.Thread(target=rig.enable, daemon=True)
    loop.start()
    with Watchdog(rig.guard):
        wait_for(lambda: rig.guard.state.operating is OperatingState.FAULT)
        assert rig.stage.stopped.wait(20)
        assert not rig.stage.inserted
        # The command goes out after all; another stop must follow it.
        rig.stage.stopped.clear()
        rig.stage.free.set()
        loop.join(20)
        assert rig.stage.stopped.wait(20)
    assert rig.guard.state.operating is not OperatingState.ENABLED
    assert Cause.LOOP_LATE in rig.guard.state.latched


def test_a_person_stops_a_loop_that_hangs_in_a_command(rig: Rig) -> None:
    rig.enable()
    with rig.guard._held():
        rig.stage.stopped.clear()
        person = threading.Thread(target=rig.guard.stop)
        person.start()
        assert rig.stage.stopped.wait(20)
        person.join(20)
    assert rig.guard.check().operating is OperatingState.FAULT


def test_a_stop_that_meets_a_blocked_guard_is_carried_out_when_the_block_ends(rig: Rig) -> None:
    rig.enable()
    rig.events.clear()
    with rig.guard._held():
        person = threading.Thread(target=rig.guard.stop)
        person.start()
        person.join(20)
        assert rig.events == []
    with pytest.raises(MotionRefused, match="not_enabled"):
        rig.guard.insert(20.0, 5.0)
    assert Cause.STOP_ORDERED in rig.guard.state.latched
    assert [each.text for each in rig.events if each.name is SafetyEventName.ORDER] == ["stop by stop()"]
    # It is carried out once; after a reset by a person it is over.
    rig.enable()
    assert rig.guard.state.latched == set()


def test_a_stop_that_met_a_blocked_guard_does_not_stop_a_later_retraction(rig: Rig) -> None:
    rig.enable()
    with rig.guard._held():
        person = threading.Thread(target=rig.guard.stop)
        person.start()
        person.join(20)
    rig.guard.retract(-10.0, 5.0, "anna")
    rig.stage.stopped.clear()
    rig.guard.check()
    assert not rig.stage.stopped.is_set()
    assert Cause.STOP_ORDERED in rig.guard.state.latched


def test_a_pause_of_the_whole_process_is_seen_by_the_next_command(rig: Rig) -> None:
    """What SIGSTOP and a long collection of garbage do: no thread runs, so the loop itself is the first to be late."""
    gc.disable()
    try:
        rig.enable()
        rig.stage.inserted = False
        rig.stage.stopped.clear()
        began = time.monotonic()
        while time.monotonic() - began < 0.05:
            pass
        with pytest.raises(MotionRefused, match="loop_late"):
            rig.guard.insert(20.0, 5.0)
    finally:
        gc.enable()
    assert not rig.stage.inserted
    assert rig.stage.stopped.is_set()
    assert rig.guard.state.operating is OperatingState.FAULT


class StubbornStage(HangingStage):
    """A stage that answers no stop for `silent_s`."""

    silent_s = 0.0

    def stop(self) -> None:
        super().stop()
        time.sleep(self.silent_s)
        if self.silent_s:
            raise DeviceFault("no answer")


def test_a_stop_without_an_answer_blocks_nobody_and_its_first_cause_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.control.safety.test_watchdog.HangingStage", StubbornStage)
    rig = Rig()
    rig.enable()
    assert isinstance(rig.stage, StubbornStage)
    rig.stage.silent_s = 0.4
    rig.guard.device_failed(Source.FORCE, DeviceFault("its cable is out"))  # the loop itself waits for the answer
    with Watchdog(rig.guard):
        assert rig.guard.state.first == {Cause.FORCE_FAULT}
        assert Cause.LOOP_LATE not in rig.guard.state.latched
        waiting = threading.Thread(target=rig.guard.order, args=(Order.DISABLE, "anna"))
        waiting.start()
        time.sleep(0.05)
        assert waiting.is_alive()
        began = time.monotonic()
        rig.guard.observe_tip((0, 0), 0.0)
        assert time.monotonic() - began < 0.3  # a loaded machine may be slow, but not as slow as the stop
        waiting.join(20)
    rig.stage.silent_s = 0.0
    rig.guard.close()


def test_a_validation_that_fails_stops_the_needle_and_says_so(rig: Rig) -> None:
    rig.enable()
    rig.stage.stopped.clear()

    def fail(*_: object, **__: object) -> set[Cause]:
        raise ZeroDivisionError("by accident")

    rig.guard._monitor.causes = fail  # type: ignore[method-assign]
    with Watchdog(rig.guard) as watchdog:
        assert rig.stage.stopped.wait(20)
        wait_for(lambda: rig.guard.state.operating is OperatingState.FAULT)
        assert watchdog.alive
        assert Cause.GUARD_FAILED in rig.guard.state.latched
        wait_for(lambda: any("by accident" in each.text for each in rig.events))
