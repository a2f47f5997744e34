"""Faults 28 to 31 on a bus in this process, and what a drive does by itself when nobody is left to tell it."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import pytest

pytest.importorskip("canopen", reason="the library canopen is not installed (extra: canopen)")

from needleplan.devices import halt
from needleplan.devices.cia402 import CanopenStage, Cia402DriveFaults, SimulatedDrives
from needleplan.devices.cia402.objects import Cia402Entry, Cia402State, decode_emergency, state_of
from needleplan.errors import DeviceFault
from needleplan.stopping import StopLimits
from tests.devices.cia402.bench import PATIENT, drives, next_of, stage_on, wait_for
from tests.devices.contract import heard_and_read

QUICK = replace(PATIENT, silence_s=1.0, answer_s=1.0, change_s=1.5)
"""For faults that are there before anything is asked."""


def moving(stage: CanopenStage) -> None:
    stage.insert(100.0, 20.0)
    while next_of(stage).depth_mm < 0.5:
        pass


def fault_of(stage: CanopenStage, cause: str) -> None:
    """Read until the stage gives up, and see that it stays given up, and takes no motion."""
    with pytest.raises(DeviceFault, match=cause):
        deque((heard_and_read(stage, 0.02) for _ in range(5000)), maxlen=0)
    for again in (lambda: stage.read(0), lambda: stage.insert(1.0, 1.0), lambda: stage.rotate(1.0, 1.0)):
        with pytest.raises(DeviceFault, match=cause):
            again()


def stands_still(there: SimulatedDrives) -> None:
    """See that both axes come to rest, with nothing that could set them in motion."""
    for drive in (there.insertion, there.roll):
        wait_for(lambda drive=drive: drive.at_rest and drive.state is not Cia402State.ENABLED)  # type: ignore[misc]
        before = drive.position
        for _ in range(20):
            drive.tick()
        assert drive.position == before


@pytest.mark.parametrize("which", ["insertion", "roll"])
def test_28_an_emergency_message_is_a_fault_with_its_code(which: str) -> None:
    with drives() as there, stage_on(there) as stage:
        moving(stage)
        getattr(there, which).trip(0x2310)
        fault_of(stage, rf"{which} drive .*: (error 0x2310 \(current\)|FAULT: error 0x2310), register 0x81")
        stands_still(there)
        stage.start()
        assert not next_of(stage).moving
        stage.insert(next_of(stage).depth_mm + 0.2, 5.0)


def test_28_a_fault_without_a_message_is_told_with_what_the_drive_says_when_asked() -> None:
    with drives() as there, stage_on(there) as stage:
        moving(stage)
        there.roll.faults.mute = True
        there.roll.trip(0x4210)
        there.roll.faults.mute = False
        fault_of(stage, r"roll drive \(node 2\): FAULT: error 0x4210, register 0x81")
        stands_still(there)


def test_28_a_fault_that_stays_is_not_reset() -> None:
    with drives() as there, stage_on(there, QUICK) as stage:
        there.roll.trip(0x2310)
        fault_of(stage, "0x2310")
        there.roll.faults.ignore.add(Cia402Entry.CONTROLWORD)
        with pytest.raises(DeviceFault, match="the fault stays: error 0x2310"):
            stage.start()


def test_29_a_drive_that_hears_nothing_of_us_stops_by_itself() -> None:
    timing = replace(PATIENT, watchdog_s=0.5)
    with drives() as there, stage_on(there, timing) as stage:
        stage.insert(100.0, 20.0)
        # Nobody reads: nothing says that we live any more.
        wait_for(lambda: there.insertion.stopped_after_s is not None)
        assert there.insertion.state is Cia402State.QUICK_STOP
        assert there.insertion.stopped_after_s < 0.5 + 1.0  # type: ignore[operator]  a late tick of the simulation
        stands_still(there)
        assert there.insertion.position < 100
        fault_of(stage, r"(error 0x8130 \(monitoring\)|left OPERATION ENABLED for QUICK STOP ACTIVE)")


def test_29_a_drive_that_says_nothing_is_a_fault_and_the_other_stops() -> None:
    with drives() as there, stage_on(there, QUICK) as stage:
        moving(stage)
        there.roll.faults.mute = True
        fault_of(stage, r"^roll drive \(node 2\): silent for")
        wait_for(lambda: there.insertion.state is Cia402State.QUICK_STOP)
        there.roll.faults.mute = False


def test_29_a_question_without_an_answer_is_a_fault() -> None:
    with drives() as there, stage_on(there, QUICK) as stage:
        next_of(stage)
        there.insertion.faults.deaf = True
        with pytest.raises(DeviceFault, match=r"insertion drive .*: write 0x607A:00 .*: No SDO response"):
            stage.insert(5.0, 5.0)
        fault_of(stage, "No SDO response")
        # A stop goes out all the same, and says that it was not acknowledged.
        with pytest.raises(DeviceFault, match="No SDO response"):
            stage.stop()
        assert there.insertion.state is Cia402State.QUICK_STOP
        there.insertion.faults.deaf = False


def test_29_a_question_that_is_refused_is_a_fault_with_the_reason() -> None:
    with drives() as there, stage_on(there) as stage:
        there.insertion.faults.refuse[Cia402Entry.TARGET_POSITION] = 0x06090030
        with pytest.raises(DeviceFault, match="Value range of parameter exceeded"):
            stage.insert(5.0, 5.0)
        fault_of(stage, "Value range of parameter exceeded")


def test_29_a_bus_that_is_gone_is_a_fault() -> None:
    with drives() as there, stage_on(there, QUICK) as stage:
        moving(stage)
        stage._bus.network.bus.shutdown()
        fault_of(stage, "canopen://bench")


def test_29_a_drive_that_restarts_is_a_fault() -> None:
    with drives() as there, stage_on(there) as stage:
        next_of(stage)
        there.roll.restart()
        fault_of(stage, "is in NMT state 0 instead of OPERATIONAL")
        stage.start()
        assert not next_of(stage).moving


@pytest.mark.parametrize(
    ("wrong", "cause"),
    [
        (lambda there: setattr(there.insertion.faults, "following", True), "following error"),
        (lambda there: setattr(there.insertion.faults, "limit", True), "a limit is active"),
        (lambda there: there.insertion.jump(15.0), "its encoder jumped by 1"),
        (lambda there: there.roll.jump(-5.0), "its encoder jumped by 5"),
    ],
    ids=["following error", "limit", "insertion jumps", "roll jumps"],
)
def test_30_what_goes_wrong_on_the_way_is_a_fault(wrong: Callable[[SimulatedDrives], None], cause: str) -> None:
    with drives() as there, stage_on(there) as stage:
        stage.insert(100.0, 5.0)
        while next_of(stage).depth_mm < 0.1:
            pass
        wrong(there)
        fault_of(stage, cause)
        stands_still(there)


@pytest.mark.parametrize(
    ("faults", "cause"),
    [(Cia402DriveFaults(stuck=True), r"does not move: 50 from its target for 0\.\d+ s"),
     (Cia402DriveFaults(backwards=True), "moves away from its target")],
    ids=["no motion", "wrong way"],
)  # fmt: skip
def test_30_a_motion_that_is_none_is_a_fault(faults: Cia402DriveFaults, cause: str) -> None:
    with drives() as there, stage_on(there, replace(PATIENT, slack_s=0.3)) as stage:
        there.insertion.faults = faults
        stage.insert(50.0, 10.0)
        fault_of(stage, cause)
        stands_still(there)


def test_31_an_emergency_stop_that_is_released_sets_nothing_in_motion() -> None:
    with drives() as there, stage_on(there, QUICK) as stage:
        moving(stage)
        there.insertion.press_stop()
        fault_of(stage, "left OPERATION ENABLED for SWITCH ON DISABLED: emergency stop, STO")
        with pytest.raises(DeviceFault, match="stays in SWITCH ON DISABLED: is power or enable missing"):
            stage.start()
        there.insertion.release_stop()
        stands_still(there)
        fault_of(stage, "stays in SWITCH ON DISABLED")
        stage.start()
        before = next_of(stage)
        assert not any(next_of(stage).moving for _ in range(20))
        assert next_of(stage).depth_mm == before.depth_mm
        stage.insert(before.depth_mm + 0.3, 5.0)
        assert next_of(stage).moving


@pytest.mark.parametrize("entry", [Cia402Entry.ABORT_CONNECTION, Cia402Entry.CONSUMER_HEARTBEAT, Cia402Entry.MODE])
def test_a_drive_that_would_not_stop_by_itself_is_not_enabled(entry: Cia402Entry) -> None:
    with drives() as there:
        there.roll.faults.ignore.add(entry)
        with pytest.raises(DeviceFault, match=r"roll drive .* was written"), stage_on(there):
            pass
        there.roll.faults = Cia402DriveFaults(refuse={entry: 0x06020000})
        with pytest.raises(DeviceFault, match=f"{entry.index:04X}.*Object does not exist"), stage_on(there):
            pass
        assert Cia402State.ENABLED not in (there.insertion.state, there.roll.state)


def test_stopping_is_allowed_in_a_fault() -> None:
    with drives() as there, stage_on(there) as stage:
        moving(stage)
        there.roll.trip(0x2310)
        fault_of(stage, "0x2310")
        stage.stop()
        stands_still(there)
        fault_of(stage, "0x2310")


@pytest.mark.parametrize("trips", [False, True])
def test_that_it_rests_is_measured_also_after_a_fault(trips: bool) -> None:
    with drives() as there, stage_on(there) as stage:
        moving(stage)
        if trips:
            there.roll.trip(0x2310)
            fault_of(stage, "0x2310")
        outcome = halt(stage, 20.0, limits=StopLimits(motion_s=20.0, silent_s=20.0))
        assert outcome.is_confirmed
        stands_still(there)


def test_a_stop_is_sent_also_by_who_holds_the_lock_of_the_bus() -> None:
    """As a signal handler does, within the sending of another frame."""
    with drives() as there, stage_on(there) as stage:
        moving(stage)
        with stage._bus.network.send_lock:
            stage.send_stop()
        wait_for(lambda: there.insertion.state == "QUICK STOP ACTIVE")


def test_samples_that_were_asked_for_in_vain_are_counted() -> None:
    with drives() as there, stage_on(there) as stage:
        first = next_of(stage)
        there.insertion.faults.mute = True
        for _ in range(30):
            assert heard_and_read(stage, 0.01) is None
        there.insertion.faults.mute = False
        after = next_of(stage)
        assert after.stamp.lost > 0
        assert after.stamp.sequence == first.stamp.sequence + after.stamp.lost + 1


def test_states_are_those_of_the_profile() -> None:
    words = {0x0000: Cia402State.NOT_READY, 0x0250: Cia402State.SWITCH_ON_DISABLED, 0x0231: Cia402State.READY,
             0x0233: Cia402State.SWITCHED_ON, 0x0637: Cia402State.ENABLED, 0x0617: Cia402State.QUICK_STOP,
             0x021F: Cia402State.FAULT_REACTION, 0x0218: Cia402State.FAULT}  # fmt: skip
    assert {word: state_of(word) for word in words} == words
    from canopen.profiles.p402 import State402

    # The library has the same table, by the names of the profile.
    for word in range(0x80):
        named = [name for name, (mask, bits) in State402.SW_MASK.items() if word & mask == bits]
        assert [str(state_of(word))] == named or (state_of(word) is None and not named)


def test_a_short_emergency_message_is_none() -> None:
    assert decode_emergency(b"\x10\x23") is None
    assert str(decode_emergency(b"\x10\x23\x81\0\0\0\0\0")) == "error 0x2310 (current), register 0x81"
