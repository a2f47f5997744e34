"""Fault 35: what becomes of the run where the recorder stalls, loses messages, dies or cannot keep up."""

import errno
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from needleplan.control.safety import Cause, OperatingState, Order, SafetyEvent
from needleplan.errors import MotionRefused
from needleplan.recording import EVENT, Recorder, Recording, Session
from needleplan.recording import _journal as journal
from tests.control.safety.bench import Bench
from tests.recording.samples import wait_for

DISK = os.write


@dataclass
class Disk:
    """What the disk does with what is written to it."""

    full: bool = False
    broken: bool = False
    answers: threading.Event = threading.Event()

    def write(self, descriptor: int, data: memoryview) -> int:
        self.answers.wait(30)
        if self.broken:
            raise MemoryError("the writer dies of it")
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        return DISK(descriptor, data)


class Recorded(Bench):
    """A guard whose events are recorded in real time, while its own time stands unless somebody moves it."""

    is_watched = False

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.recorder = Recorder(path, Session("fault 35", monotonic_ns=10**12), capacity=60)
        self.channel = self.recorder.channel("/events", EVENT)
        self.guard._wire.events._listener = self.record
        # On a busy machine the new recorder may be behind for a moment, which would refuse the first order.
        self.enabled().insert(50.0, 5.0)
        self.is_watched = True

    def record(self, event: SafetyEvent) -> None:
        self.events.append(event)
        self.channel.put(event.time_ns, event.entry())

    def turn(self, seconds: float = 0.005) -> None:
        super().turn(seconds)
        if self.is_watched:
            self.guard.observe_recording(self.recorder.status)

    def until(self, operating: OperatingState) -> None:
        """Look at the recorder in real time until a state is reached; the clock of the run stands.

        The recorder gets a message first: it may have written all that it had, and then no disk keeps it waiting.
        """
        self.channel.put(self.clock.now_ns(), {"name": "a message", "cause": "", "text": ""})
        wait_for(lambda: self.guard.observe_recording(self.recorder.status).operating is operating)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    disk = Disk(answers=threading.Event())
    disk.answers.set()
    monkeypatch.setattr(journal.os, "write", disk.write)
    return disk


@pytest.fixture
def bench(tmp_path: Path, disk: Disk) -> Iterator[Recorded]:
    bench = Recorded(tmp_path / "run.mcap")
    yield bench
    disk.full = disk.broken = False
    disk.answers.set()
    bench.recorder.close()


def test_a_full_disk_pauses_and_room_lets_a_person_resume(bench: Recorded, disk: Disk) -> None:
    disk.full = True
    bench.until(OperatingState.PAUSED)
    assert bench.causes == {Cause.RECORDING_BEHIND}
    assert bench.stage.wire[-1] == ("stop",)
    with pytest.raises(MotionRefused, match="recording_behind"):
        bench.guard.order(Order.RESUME, "anna")
    disk.full = False

    def resumed() -> bool:
        bench.turn()
        if not bench.guard.state.present:
            bench.guard.order(Order.RESUME, "anna")
        return bench.guard.state.operating is OperatingState.ENABLED

    wait_for(resumed)
    bench.recorder.close()
    told = [each.values for each in Recording.read(bench.recorder.path).messages(["/events"])]
    assert any(each["cause"] == "recording_behind" and "No space left" in each["text"] for each in told)


def test_a_disk_that_does_not_answer_pauses(bench: Recorded, disk: Disk) -> None:
    disk.answers.clear()
    bench.until(OperatingState.PAUSED)
    assert bench.causes == {Cause.RECORDING_BEHIND}
    assert bench.recorder.status.behind_s > 0.5


def test_a_lost_message_is_a_fault_until_somebody_has_seen_it(bench: Recorded, disk: Disk) -> None:
    disk.answers.clear()
    for number in range(70):
        bench.channel.put(bench.clock.now_ns(), {"name": str(number)})
    bench.turn()
    assert bench.guard.state.operating is OperatingState.FAULT
    assert bench.causes == {Cause.RECORDING_LOST}
    disk.answers.set()
    bench.turns(0.6)
    with pytest.raises(MotionRefused, match="recording_lost"):
        bench.guard.order(Order.ENABLE)
    wait_for(lambda: bool(bench.turn() or not bench.guard.state.present))
    bench.guard.order(Order.RESET, "anna")
    bench.guard.order(Order.ENABLE, "anna")


def test_a_writer_that_dies_is_a_fault_for_the_rest_of_the_run(bench: Recorded, disk: Disk) -> None:
    disk.broken = True
    bench.until(OperatingState.FAULT)
    assert bench.causes == {Cause.RECORDING_LOST}
    assert bench.stage.wire[-1] == ("stop",)
    bench.turns(1.0)
    assert bench.guard.state.operating is OperatingState.FAULT
    bench.guard.retract(-1.0, 5.0, "anna")
    assert bench.stage.wire[-1] == ("insert", -1.0, 5.0)


def test_a_recorder_that_was_closed_too_early_is_a_fault(bench: Recorded) -> None:
    bench.recorder.close()
    bench.turn()
    assert bench.guard.state.operating is OperatingState.FAULT
    assert bench.causes == {Cause.RECORDING_LOST}
