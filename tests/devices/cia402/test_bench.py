"""Drives, force sensor and a tracker behind PLUS, opened by address as `needleplan insert` opens them."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("canopen", reason="the library canopen is not installed (extra: canopen)")

from needleplan.devices.ati import NetFtBox, NetFtServer
from needleplan.devices.cia402 import CanopenStage
from needleplan.devices.igtl import IgtlTracker, PlusServer
from needleplan.errors import AddressError
from needleplan.simulation import open_insertion_station
from tests.control.scenes import small_table
from tests.devices.cia402.bench import drives, setup_file
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
