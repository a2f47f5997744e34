"""What ends a command while the needle moves: the exit code is 3, whatever else happens to the process.

Each command is a process of its own, because the exit code of a process is also decided after `main`.
"""

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from needleplan.devices.robot import RobotMachine, RobotServer, SteadyDrive
from tests.cli.commands import needleplan
from tests.cli.moving_robot import Rig, moving_robot
from tests.recording.samples import wait_for

TIMEOUT_S = 60


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("moving")


@pytest.fixture
def rig(folder: Path) -> Iterator[Rig]:
    with moving_robot(folder) as rig:
        rig.drive.lies = True
        yield rig


def started(*words: str) -> subprocess.Popen[str]:
    """Start a command whose interrupts are not ignored, as those of a background job would be."""
    return subprocess.Popen(
        [sys.executable, "-m", "needleplan", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip


def wait_for_motion(rig: Rig, process: subprocess.Popen[str]) -> None:
    """Wait until the needle is 1 mm deep; a command that ends before fails with what it said."""
    wait_for(lambda: rig.depth_mm > 1.0 or process.poll() is not None)
    assert process.stderr is not None
    assert process.poll() is None, process.stderr.read()


def goes_on(depth_mm: Callable[[], float]) -> None:
    """See that the needle moves."""
    before_mm = depth_mm()
    wait_for(lambda: depth_mm() > before_mm)


def keeps_sending(process: subprocess.Popen[str], number: signal.Signals) -> None:
    """Send a signal again and again until the process has ended."""
    while True:
        try:
            process.wait(0.02)
        except subprocess.TimeoutExpired:
            process.send_signal(number)
        else:
            return


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.study)])
def test_signals_after_the_answer_do_not_change_the_exit_code(rig: Rig, number: signal.Signals) -> None:
    with started(*rig.words()) as process:
        wait_for_motion(rig, process)
        keeps_sending(process, number)
        assert process.stderr is not None
        said = process.stderr.read()
    assert process.returncode == 3, said
    assert "the needle still moves at the end of the run" in said
    goes_on(lambda: rig.depth_mm)


@pytest.mark.slow
def test_an_insertion_whose_answer_nobody_reads(rig: Rig) -> None:
    with started(*rig.words("--json")) as process:
        assert process.stdout is not None
        process.stdout.close()
        wait_for_motion(rig, process)
        process.send_signal(signal.SIGINT)
        process.wait(TIMEOUT_S)
    assert process.returncode == 3
    goes_on(lambda: rig.depth_mm)


@pytest.mark.slow
def test_an_answer_that_cannot_be_written(rig: Rig, tmp_path: Path) -> None:
    """The folder of the figure vanishes during the run."""
    (tmp_path / "gone").mkdir()
    with started(*rig.words("--figure", str(tmp_path / "gone" / "run.png"))) as process:
        wait_for_motion(rig, process)
        (tmp_path / "gone").rmdir()
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 3, said
    assert "Traceback" not in said
    goes_on(lambda: rig.depth_mm)


@pytest.fixture
def running() -> Iterator[tuple[RobotServer, Callable[[], float]]]:
    """A robot that nobody controls, that answers ACCEPTED to a stop and goes on; and the depth of its needle."""
    drive = SteadyDrive()
    drive.faults.missed_stops, drive.faults.claims_rest = 10**9, True
    with RobotServer(RobotMachine(drive)) as server:
        drive.insert(170.0, 2.0)
        yield server, lambda: drive.advance(time.monotonic()).depth_mm


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_to_a_stop(running: tuple[RobotServer, Callable[[], float]], number: signal.Signals) -> None:
    server, depth_mm = running
    with started("stop", "--robot", server.address) as process:
        wait_for(lambda: server.machine.counts.foreign_stops > 0)
        keeps_sending(process, number)
        assert process.stderr is not None
        said = process.stderr.read()
    assert process.returncode == 3, said
    assert "Traceback" not in said
    goes_on(depth_mm)


@pytest.mark.parametrize("words", [["stop", "--within", "1"], ["pause", "--within", "0.1"]], ids=["stop", "pause"])
def test_an_alarm_that_nobody_reads(running: tuple[RobotServer, Callable[[], float]], words: list[str]) -> None:
    server, depth_mm = running
    with started(words[0], "--robot", server.address, *words[1:]) as process:
        assert process.stderr is not None
        process.stderr.close()
        process.wait(TIMEOUT_S)
    assert process.returncode == 3
    if words[0] == "stop":
        assert server.machine.counts.foreign_stops > 40  # every 10 ms, without a gap after the alarm
    goes_on(depth_mm)


def test_a_retraction_whose_needle_does_not_stay(rig: Rig) -> None:
    """The robot goes inward at the last stop: the needle was at the depth, and nothing says that it rests there."""
    rig.drive.lies = False
    rig.drive.insert(20.0, 40.0)
    wait_for(lambda: rig.depth_mm > 19.9)

    def deceive() -> None:
        wait_for(lambda: rig.depth_mm < 15.0)
        rig.drive.lies = True

    thread = threading.Thread(target=deceive)
    thread.start()
    done = needleplan("retract", "--robot", rig.address, "--depth", "5", "--speed", "20", "--json", *rig.limits())
    thread.join()
    assert done.returncode == 3, done.stderr
    record = json.loads(done.stdout)
    assert (record["ending"], record["rest"]) == ("fault", "moves"), record
    assert "rests" not in record["cause"]
    goes_on(lambda: rig.depth_mm)
