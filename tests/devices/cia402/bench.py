"""Two simulated drives on a CAN bus inside this process."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path

from needleplan.devices import StageSample, SystemClock
from needleplan.devices.cia402 import (
    CanopenStage,
    DrivesSetup,
    DriveTiming,
    InsertionSetup,
    RollSetup,
    SimulatedDrives,
)
from needleplan.devices.cia402._drive import CanBus

SETUP = DrivesSetup(
    InsertionSetup(node=1, counts_per_turn=4096, gear=14.0, lead_mm=2.0, zero_counts=1000),
    RollSetup(node=2, counts_per_turn=2048, gear=23.0, direction=-1, velocity_unit="counts/s"),  # type: ignore[arg-type]
)
PATIENT = DriveTiming(watchdog_s=20.0, silence_s=20.0, answer_s=20.0, change_s=20.0, slack_s=20.0)
"""For a machine with other things to do than to run simulated drives."""
LONG_S = 20.0

_CHANNELS = count(1)

FILE = """\
schema = "needleplan.drives/1"

[insertion]
node = 1
counts_per_turn = 4096
gear = 14.0
lead_mm = 2.0
zero_counts = 1000

[roll]
node = 2
counts_per_turn = 2048
gear = 23.0
direction = -1
velocity_unit = "counts/s"
"""


def drives() -> SimulatedDrives:
    return SimulatedDrives(SETUP, f"bench{next(_CHANNELS)}")


@contextmanager
def stage_on(there: SimulatedDrives, timing: DriveTiming = PATIENT) -> Iterator[CanopenStage]:
    with CanopenStage(CanBus(there.channel, there.interface, SystemClock()), SETUP, timing=timing) as opened:
        yield opened


def setup_file(folder: Path, text: str = FILE) -> Path:
    path = folder / "drives.toml"
    path.write_text(text)
    return path


def next_of(stage: CanopenStage) -> StageSample:
    stage.heartbeat()
    sample = stage.read(LONG_S)
    assert sample is not None
    return sample


def wait_for(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + LONG_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.002)
