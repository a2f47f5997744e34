"""The end of a run says what was measured: at rest, or that the needle still moves."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli.moving_robot import Rig, moving_robot
from tests.recording.samples import wait_for


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("moving")


@pytest.fixture
def rig(folder: Path) -> Iterator[Rig]:
    with moving_robot(folder) as rig:
        yield rig


def signalled(rig: Rig, number: signal.Signals = signal.SIGINT) -> threading.Thread:
    """Send this process a signal when the needle is 1 mm deep; from then on the robot lies if it is to."""

    def send() -> None:
        wait_for(lambda: rig.depth_mm > 1.0)
        os.kill(os.getpid(), number)

    thread = threading.Thread(target=send)
    thread.start()
    return thread


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_and_a_robot_that_goes_on(
    rig: Rig, number: signal.Signals, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The robot answers ACCEPTED and claims rest. Never 130 while the needle moves; the emergency stop is called."""
    rig.drive.lies = True
    calls = tmp_path / "calls"
    estop = f"{sys.executable} -c \"open('{calls}', 'a').write('called ')\""
    thread = signalled(rig, number)
    code = rig.insert("--estop", estop)
    thread.join()
    said = capsys.readouterr()
    assert code == 3, said.err
    assert "the needle still moves" in said.err
    assert calls.read_text() == "called "
    before_mm = rig.depth_mm
    wait_for(lambda: rig.depth_mm > before_mm)  # it does


def test_ctrl_c_and_a_robot_that_obeys(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    thread = signalled(rig)
    code = rig.insert()
    thread.join()
    said = capsys.readouterr()
    assert code == 130, said.err
    assert "still moves" not in said.err
    depth_mm = rig.depth_mm
    time.sleep(0.1)
    assert rig.depth_mm == depth_mm
