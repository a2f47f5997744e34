"""The end of a run says what was measured: at rest, or that the needle still moves."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from needleplan.control import send_order
from needleplan.control.safety import Order
from tests.cli.commands import Done, needleplan, refused
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


class Run:
    """`insert` in the main thread, and what another thread does when the needle is 1 mm deep; then it sends Ctrl-C."""

    def __init__(self, rig: Rig, person: Callable[[], None], *, interrupts: bool = True) -> None:
        self.interrupts = interrupts
        self.thread = threading.Thread(target=self.act)
        self.rig, self.person = rig, person
        self.code: int | None = None
        self.failure: BaseException | None = None

    def act(self) -> None:
        try:
            wait_for(lambda: self.rig.depth_mm > 1.0)
            self.person()
        except BaseException as failure:
            self.failure = failure
        if self.interrupts and self.code is None:
            os.kill(os.getpid(), signal.SIGINT)

    def insert(self) -> int | None:
        self.thread.start()
        self.code = self.rig.insert()
        self.thread.join()
        if self.failure is not None:
            raise self.failure
        return self.code


def program(*words: str) -> Done:
    """Run a command as another terminal does."""
    return subprocess.run(
        [sys.executable, "-m", "needleplan", *words], capture_output=True, text=True, timeout=60, check=False
    )


def test_pause_and_resume_from_another_terminal(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    depths_mm: list[float] = []

    def person() -> None:
        for address in (rig.robot.address, rig.robot.address.replace("127.0.0.1", "localhost")):
            done = program("pause", "--robot", address, "--json")
            assert done.returncode == 0, done.stderr
            assert json.loads(done.stdout) == {"state": "PAUSED", "rest": "rests"}
            depths_mm.append(rig.depth_mm)
        done = program("resume", "--robot", rig.robot.address)
        assert done.returncode == 0, done.stderr
        assert "ENABLED: the run goes on" in done.stdout
        wait_for(lambda: rig.depth_mm > depths_mm[0] + 1.0)
        done = program("resume", "--robot", rig.robot.address)
        assert (done.returncode, done.stdout) == (1, "")
        assert "not_possible" in done.stderr

    code = Run(rig, person).insert()
    assert code == 130, capsys.readouterr().err
    assert depths_mm[0] == depths_mm[1]


@pytest.mark.slow
@pytest.mark.parametrize("command", ["stop", "retract"])
def test_another_terminal_ends_the_run(rig: Rig, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A stop and a retraction stop the needle at once; the run ends as a fault, and says that the needle rests."""
    stopped_mm: list[float] = []

    def person() -> None:
        more = () if command == "stop" else ("--speed", "20", *rig.limits())
        for _ in range(5):
            done = program(command, "--robot", rig.address, *more)
            if "silent" not in done.stderr:  # a busy machine is too slow for the link to the robot
                break
        stopped_mm.append(rig.depth_mm)
        assert done.returncode == 0, done.stderr

    code = Run(rig, person, interrupts=False).insert()
    said = capsys.readouterr().err
    assert code == 1, said
    assert "another sender ordered a stop" in said
    assert "still move" not in said
    assert rig.depth_mm == stopped_mm[0]
    assert command == "stop" or rig.depth_mm == pytest.approx(0.0, abs=0.1)


def test_a_pause_that_a_robot_does_not_obey(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    rig.drive.lies = True

    def person() -> None:
        done = program("pause", "--robot", rig.robot.address)
        assert done.returncode == 3, done.stderr
        assert "the needle still moves" in done.stderr

    assert Run(rig, person).insert() == 3
    assert "the needle still moves" in capsys.readouterr().err


@pytest.mark.parametrize(("command", "code"), [("pause", 3), ("resume", 2)])
def test_without_a_run_a_pause_is_no_stop(command: str, code: int) -> None:
    done = needleplan(command, "--robot", "udp://127.0.0.1:9")
    assert (done.returncode, done.stdout) == (code, "")
    assert "no run on this machine answers for this robot" in done.stderr
    refused(needleplan(command, "--robot", "robot"), "robot")
    refused(needleplan(command, "--robot", "udp://127.0.0.1:9", "--within", "nan"), "--within = nan")


def test_a_resume_soon_after_a_pause_waits_for_rest(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    """In the same moment, as from a script: the run goes on, every time."""

    def person() -> None:
        for number in range(4):
            at_mm = rig.depth_mm
            send_order(rig.robot.address, Order.PAUSE, "anna", 0.02 * number + 0.001)  # waits no longer for its reply
            reply = send_order(rig.robot.address, Order.RESUME, "anna", 10.0)
            assert reply is not None
            assert (reply.state, reply.refused) == ("ENABLED", "")
            wait_for(lambda at_mm=at_mm: rig.depth_mm > at_mm + 0.3)

    assert Run(rig, person).insert() == 130, capsys.readouterr().err


def test_ctrl_c_again_and_again_does_not_change_what_is_true(rig: Rig, capsys: pytest.CaptureFixture[str]) -> None:
    """A person presses the keys again while the program waits for rest, closes the devices and prints its answer."""
    rig.drive.lies = True
    ended = threading.Event()

    def person() -> None:
        while not ended.wait(0.02):
            os.kill(os.getpid(), signal.SIGINT)

    run = Run(rig, person, interrupts=False)
    before = signal.signal(signal.SIGINT, lambda *_: None)  # what comes after the answer
    try:
        run.thread.start()
        code = rig.insert()
    finally:
        ended.set()
        run.thread.join()
        signal.signal(signal.SIGINT, before)
    assert code == 3, capsys.readouterr().err


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
