"""Drives, force sensor and a tracker behind PLUS, opened by address as `needleplan insert` opens them."""

import time
from collections import deque
from pathlib import Path

import pytest

pytest.importorskip("canopen", reason="the library canopen is not installed (extra: canopen)")

from needleplan.control.safety import GuardedStage, OperatingState, Order
from needleplan.devices.ati import NetFtBox, NetFtServer
from needleplan.devices.cia402 import CanopenStage, _stage
from needleplan.devices.igtl import IgtlTracker, PlusServer
from needleplan.errors import AddressError, DeviceFault
from needleplan.simulation import open_insertion_station
from tests.control.faults.test_drives import LIMITS, turn
from tests.control.scenes import small_table
from tests.devices.cia402.bench import LONG_S, PATIENT, drives, setup_file, wait_for
from tests.devices.igtl.bench import TIP, plus


def test_all_three_are_opened(tmp_path: Path) -> None:
    table = small_table()
    with drives() as there, NetFtServer(NetFtBox(lambda _: (0, 0, 0.1, 0, 0, 0))) as force, PlusServer(plus()) as coils:
        robot = f"{there.address}&setup={setup_file(tmp_path)}&watchdog_s=10"
        station = open_insertion_station(robot, force.address, f"{coils.address}/{TIP}", table, table.best_entry().pose)
        with station.stage as stage, station.tracker as tracker, station.force_sensor:
            assert isinstance(stage, CanopenStage)
            assert isinstance(tracker, IgtlTracker)
            assert there.insertion.state == there.roll.state == "OPERATION ENABLED"
        assert there.insertion.state == there.roll.state == "SWITCH ON DISABLED"


def test_the_heartbeat_of_the_loop_keeps_the_drives_moving(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The guard before the station's stage passes it on; without it the drives stop, although samples are read."""
    monkeypatch.setattr(_stage, "DriveTiming", lambda: PATIENT)
    table, watchdog_s = small_table(), 1.0
    with drives() as there, NetFtServer(NetFtBox(lambda _: (0, 0, 0.1, 0, 0, 0))) as force, PlusServer(plus()) as coils:
        robot = f"{there.address}&setup={setup_file(tmp_path)}&watchdog_s={watchdog_s}"
        station = open_insertion_station(robot, force.address, f"{coils.address}/{TIP}", table, table.best_entry().pose)
        with station.stage, station.tracker, station.force_sensor:
            guard = GuardedStage(station.stage, LIMITS, accepted_limits="a busy machine")
            turn(guard, 0)
            turn(guard, 1)
            guard.order(Order.HOME, "anna")
            guard.order(Order.ENABLE, "anna")
            guard.insert(100.0, 5.0)
            end_s = time.monotonic() + 1.5 * watchdog_s
            number = 2
            while time.monotonic() < end_s:
                turn(guard, number)
                number += 1
            assert there.insertion.stopped_after_s is there.roll.stopped_after_s is None
            sample = guard.read(LONG_S)
            assert sample is not None
            assert sample.moving
            assert 5.0 < sample.depth_mm < 100.0
            assert guard.state.operating is OperatingState.ENABLED
            with pytest.raises(DeviceFault, match=r"0x8130|QUICK STOP ACTIVE"):
                deque((guard.read(LONG_S) for _ in range(10_000)), maxlen=0)
            # The drive that is late first has the stage stop the other one, which then need not stop by itself.
            late_s = [s for s in (there.insertion.stopped_after_s, there.roll.stopped_after_s) if s is not None]
            assert late_s
            assert min(late_s) > watchdog_s
            wait_for(lambda: there.insertion.at_rest)


def test_drives_without_a_setup_are_refused() -> None:
    table = small_table()
    with (
        NetFtServer(NetFtBox(lambda _: (0, 0, 0.1, 0, 0, 0))) as force,
        PlusServer(plus()) as coils,
        pytest.raises(AddressError, match="setup: is missing"),
    ):
        open_insertion_station(
            "canopen://can0", force.address, f"{coils.address}/{TIP}", table, table.best_entry().pose
        )
