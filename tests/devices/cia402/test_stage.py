"""The contract of a stage on drives of a bus in this process, and on hardware where there is some that may move."""

import os
import struct
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from needleplan.devices import Stage, StageSample

pytest.importorskip("canopen", reason="the library canopen is not installed (extra: canopen)")

from needleplan.devices.cia402 import CanopenStage
from needleplan.devices.cia402.objects import AbortOption, Cia402Entry
from needleplan.errors import AddressError, DeviceFault, LinkClosed
from tests.devices.cia402.bench import LONG_S, PATIENT, drives, next_of, setup_file, stage_on, wait_for
from tests.devices.contract import StageContract

HARDWARE = "NEEDLEPLAN_TEST_CANOPEN"


class TestOnABusInThisProcess(StageContract):
    @pytest.fixture
    def sensor(self, tmp_path: Path) -> Iterator[Stage]:
        with (
            drives() as there,
            CanopenStage.open(f"{there.address}&setup={setup_file(tmp_path)}", timing=PATIENT) as opened,
        ):
            yield opened


@pytest.mark.skipif(HARDWARE not in os.environ, reason=f"set {HARDWARE} to the address of drives that may move 40 mm")
class TestOnHardware(StageContract):
    @pytest.fixture
    def sensor(self) -> Iterator[Stage]:
        with CanopenStage.open(os.environ[HARDWARE]) as opened:
            yield opened


def test_the_drives_are_told_to_stop_by_themselves() -> None:
    with drives() as there, stage_on(there):
        for drive in (there.insertion, there.roll):
            assert drive._values[Cia402Entry.ABORT_CONNECTION] == AbortOption.QUICK_STOP
            assert drive._values[Cia402Entry.CONSUMER_HEARTBEAT] == 127 << 16 | 20_000
            assert drive._values[Cia402Entry.QUICK_STOP] == 6
            assert drive._values[Cia402Entry.MODE] == 1


def test_a_motion_is_in_counts_of_the_encoder_and_units_of_the_drive() -> None:
    with drives() as there, stage_on(there) as stage:
        stage.insert(10.0, 5.0)
        stage.rotate(1.0, 2.0)
        insertion, roll = there.insertion._values, there.roll._values
        assert insertion[Cia402Entry.TARGET_POSITION] == 1000 + 10 * 4096 * 14 // 2
        assert insertion[Cia402Entry.PROFILE_VELOCITY] == 5 / 2 * 14 * 60  # turns of the motor in a minute
        assert roll[Cia402Entry.TARGET_POSITION] == -round(2048 * 23 / (2 * 3.141592653589793))
        assert roll[Cia402Entry.PROFILE_VELOCITY] == round(2 * 2048 * 23 / (2 * 3.141592653589793))
        sample = next_of(stage)
        while sample.velocity_mm_s < 4.9:
            sample = next_of(stage)
            assert sample.moving
        assert sample.velocity_mm_s == pytest.approx(5, rel=0.02)


def test_a_motion_takes_the_place_of_another() -> None:
    with drives() as there, stage_on(there) as stage:
        stage.insert(100.0, 20.0)
        while next_of(stage).depth_mm < 2:
            pass
        stage.insert(0.5, 20.0)
        while next_of(stage).moving:
            pass
        assert next_of(stage).depth_mm == pytest.approx(0.5, abs=0.001)


def test_after_a_stop_the_next_motion_goes_on_from_there() -> None:
    with drives() as there, stage_on(there) as stage:
        stage.insert(100.0, 20.0)
        while next_of(stage).depth_mm < 1:
            pass
        stage.stop()
        while (stopped := next_of(stage)).moving:
            pass
        # The other axis moves, and the stopped one keeps its place: the old target is forgotten.
        stage.rotate(0.5, 5.0)
        stage.insert(stopped.depth_mm + 0.5, 5.0)
        while (sample := next_of(stage)).moving:
            pass
        assert sample.depth_mm == pytest.approx(stopped.depth_mm + 0.5, abs=0.001)
        assert sample.roll_rad == pytest.approx(0.5, abs=0.001)


def test_closing_takes_the_power_away() -> None:
    with drives() as there:
        with stage_on(there) as stage:
            stage.insert(100.0, 20.0)
            assert next_of(stage).moving
        assert there.insertion.state == there.roll.state == "SWITCH ON DISABLED"
        assert there.insertion.position < 50
        with pytest.raises(LinkClosed):
            stage.stop()
        with pytest.raises(LinkClosed):
            stage.insert(1.0, 1.0)


@pytest.mark.parametrize(
    ("address", "rule"),
    [("udp://can0", "must name a bus"), ("canopen://", "must name a bus"), ("canopen://can0:5?setup=x", "name a bus"),
     ("canopen://can0", "setup: is missing"), ("canopen://can0?setup=x&nod=3", "did you mean"),
     ("canopen://can0?setup=x&node=200", "from 1 to 127"), ("canopen://can0?setup=x&watchdog_s=0", "at least 0.02"),
      ("canopen://can0?setup=SETUP&node=2", "must differ")],
)  # fmt: skip
def test_wrong_addresses_are_refused(tmp_path: Path, address: str, rule: str) -> None:
    with pytest.raises(AddressError, match=rule):
        CanopenStage.open(address.replace("SETUP", str(setup_file(tmp_path))))


@pytest.mark.parametrize("bus", ["canopen://no-such-bus?", "canopen://x?interface=no-such-interface&"])
def test_a_bus_that_is_not_there_is_a_fault(tmp_path: Path, bus: str) -> None:
    with pytest.raises(DeviceFault, match="cannot be opened by"):
        CanopenStage.open(f"{bus}setup={setup_file(tmp_path)}")


def test_nobody_on_the_bus_is_a_fault_that_names_the_drive(tmp_path: Path) -> None:
    with pytest.raises(DeviceFault, match=r"insertion drive \(node 1\): write 0x6040:00 .*: No SDO response"):
        CanopenStage.open(f"canopen://nobody?interface=virtual&setup={setup_file(tmp_path)}")


def test_without_the_library_one_error_names_the_extra(tmp_path: Path) -> None:
    """In a process of its own, in which there is no canopen."""
    program = (
        "import sys; sys.modules['canopen'] = None\n"
        "from needleplan.devices.cia402 import CanopenStage\n"
        "from needleplan.errors import ConfigurationError\n"
        "try:\n    CanopenStage.open(sys.argv[1])\n"
        "except ConfigurationError as error:\n    print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, f"canopen://can0?setup={setup_file(tmp_path)}"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert "pip install needleplan[canopen]" in done.stdout


def test_a_drive_has_the_bytes_of_the_profile_on_the_wire() -> None:
    """What the stage sends, seen by somebody else on the bus."""
    import can

    with drives() as there:
        seen: list[can.Message] = []
        with can.Bus(channel=there.channel, interface="virtual") as other, stage_on(there) as stage:
            stage.insert(1.0, 5.0)
            while next_of(stage).moving:
                pass
            stage.stop()
            while (message := other.recv(0)) is not None:
                seen.append(message)
    sent = {(each.arbitration_id, bytes(each.data)) for each in seen}
    target = 1000 + 4096 * 14 // 2
    assert (0x601, b"\x23\x7a\x60\x00" + struct.pack("<i", target)) in sent
    assert (0x601, b"\x2b\x40\x60\x00\x3f\x00\x00\x00") in sent
    assert {(0x201, b"\x02\x00"), (0x202, b"\x02\x00"), (0x77F, b"\x05"), (0x080, b"")} <= sent
    assert any(each.arbitration_id == 0x181 and len(each.data) == 6 for each in seen)


def test_two_threads_may_read_and_command() -> None:
    with drives() as there, stage_on(there) as stage:
        samples: list[StageSample] = []
        enough = threading.Event()

        def read() -> None:
            while not enough.is_set():
                samples.append(next_of(stage))

        reading = threading.Thread(target=read)
        reading.start()
        for _ in range(10):
            stage.insert(20.0, 20.0)
            stage.rotate(3.0, 10.0)
            stage.stop()
        enough.set()
        reading.join()
        numbers = [each.stamp.sequence for each in samples]
        assert numbers == sorted(set(numbers))
        while (last := next_of(stage)).moving:
            pass
        assert 0 < last.depth_mm < 20


def test_a_thread_that_reads_does_not_hide_a_loop_that_has_died(tmp_path: Path) -> None:
    timing = replace(PATIENT, watchdog_s=0.5)
    with drives() as there:
        address = f"{there.address}&setup={setup_file(tmp_path)}"
        with CanopenStage.open(address, timing=timing) as stage:
            stage.insert(100.0, 5.0)
            stage.heartbeat()
            with pytest.raises(DeviceFault, match=r"0x8130|QUICK STOP ACTIVE"):
                deque((stage.read(LONG_S) for _ in range(10_000)), maxlen=0)
            # The drive that is late first has the stage stop the other one, which then need not stop by itself.
            assert (there.insertion.stopped_after_s, there.roll.stopped_after_s) != (None, None)
            wait_for(lambda: there.insertion.at_rest)
