"""`needleplan retract`, on the sockets of a simulated robot."""

import json
import os
import pty
import re
import signal
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from needleplan.control import DeadmanSender, KeyDeadman, PedalDeadman
from needleplan.devices import stop_stage
from needleplan.devices.robot import Fault, RobotLimits, RobotMachine, RobotServer, RobotStage, RobotState, SteadyDrive
from needleplan.errors import DeviceFault
from tests.cli.commands import Done, needleplan, refused
from tests.recording.samples import wait_for

PATIENT = "watchdog_s=5&valid_s=1"


@dataclass(frozen=True)
class Inserted:
    """A robot whose needle is 20 mm deep, and that nobody controls."""

    server: RobotServer
    drive: SteadyDrive

    @property
    def address(self) -> str:
        return f"{self.server.address}?{PATIENT}"

    @property
    def depth_mm(self) -> float:
        return self.drive.advance(time.monotonic()).depth_mm


@pytest.fixture
def robot() -> Iterator[Inserted]:
    drive = SteadyDrive()
    limits = RobotLimits(longest_silence_s=10.0, release_s=2.0)
    with RobotServer(RobotMachine(drive, limits)) as server:
        found = Inserted(server, drive)
        with RobotStage.open(found.address) as stage:
            stage.insert(20.0, 40.0)
            wait_for(lambda: found.depth_mm > 19.9)
        yield found


@pytest.fixture
def insecure(tmp_path: Path) -> tuple[str, ...]:
    """Options with limits that a busy machine meets."""
    path = tmp_path / "limits.toml"
    path.write_text("[safety]\nstage_age_s = 5.0\nmotion_s = 5.0\nfollowing_mm = 1.0\n")
    return "--limits", str(path), "--accept-limits", "a busy machine"


def retract(robot: Inserted, *words: str) -> Done:
    """Retract, again and again where a busy machine is too slow for the link to the robot."""
    for _ in range(5):
        done = needleplan("retract", "--robot", robot.address, *words)
        if done.returncode != 1 or "silent" not in done.stderr:
            break
    return done


def once(robot: Inserted, what: Callable[[], object]) -> threading.Thread:
    """Call something when the needle has gone back by a millimetre."""

    def watch() -> None:
        wait_for(lambda: robot.depth_mm < 19.0)
        what()

    thread = threading.Thread(target=watch)
    thread.start()
    return thread


def stays(robot: Inserted) -> bool:
    """Return whether the needle is where it was after fifty more ticks of the robot."""
    depth_mm, ticks = robot.depth_mm, robot.server.ticks
    wait_for(lambda: robot.server.ticks > ticks + 50)
    return robot.depth_mm == depth_mm


def test_it_pulls_the_needle_to_the_depth(robot: Inserted, insecure: tuple[str, ...]) -> None:
    done = retract(robot, "--depth", "5", "--speed", "20", *insecure, "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["ending"] == "reached"
    assert 5.0 < answer["began_mm"] < 20.3  # less than 20 if a busy machine needed two attempts
    assert answer["ended_mm"] == pytest.approx(5.0, abs=1.0)
    assert robot.depth_mm == pytest.approx(5.0, abs=0.1)


def test_after_a_fault_of_the_robot(robot: Inserted, insecure: tuple[str, ...]) -> None:
    assert needleplan("stop", "--robot", robot.server.address).returncode == 0
    with RobotStage.open(robot.address):
        assert needleplan("stop", "--robot", robot.server.address, "--json").returncode == 0
        wait_for(lambda: robot.server.machine.state is RobotState.FAULT)
        assert robot.server.machine.faults & Fault.FOREIGN_STOP
    done = retract(robot, "--speed", "20", *insecure)
    assert done.returncode == 0, done.stderr
    assert robot.depth_mm == pytest.approx(0.0, abs=0.1)


@pytest.mark.slow
def test_after_a_crash_of_its_controller_it_waits_until_the_robot_is_free(
    robot: Inserted, insecure: tuple[str, ...]
) -> None:
    crashed = RobotStage.open(robot.address)
    crashed._wire.close()  # nothing says goodbye
    began_s = time.monotonic()
    done = retract(robot, "--speed", "20", *insecure)
    assert done.returncode == 0, done.stderr
    assert "waiting for the robot" in done.stderr
    assert "another controller" in done.stderr
    assert time.monotonic() - began_s > 1.0
    assert robot.depth_mm == pytest.approx(0.0, abs=0.1)


def test_it_stops_first_whoever_moves_the_needle(robot: Inserted, insecure: tuple[str, ...]) -> None:
    """The controller notices nothing of the person; the needle goes out from where the stop found it."""
    crossed = threading.Event()

    def control(stage: RobotStage) -> None:
        with suppress(DeviceFault):
            stage.insert(100.0, 5.0)
            crossed.set()
            while stage.read(0.1) is not None:
                stage.heartbeat()
        stage.close()

    thread = threading.Thread(target=control, args=[RobotStage.open(robot.address)])
    thread.start()
    crossed.wait()
    wait_for(lambda: robot.depth_mm > 20.5)
    done = needleplan("retract", "--robot", robot.address, "--speed", "20", *insecure, "--json")
    thread.join()
    answer = json.loads(done.stdout)
    if done.returncode == 1 and "silent" in done.stderr:  # a busy machine is too slow for the link to the robot
        done = retract(robot, "--speed", "20", *insecure)
    assert done.returncode == 0, done.stderr
    assert answer["began_mm"] < 30.0  # where it was when the first datagram arrived, and not 10 s later
    assert answer["rest"] == "rests"
    assert robot.depth_mm == pytest.approx(0.0, abs=0.1)


@pytest.mark.slow
def test_a_needle_that_does_not_rest_is_pulled_out_only_with_the_word_of_a_person(
    robot: Inserted, insecure: tuple[str, ...], tmp_path: Path
) -> None:
    """A drive that runs away is told of, and the emergency stop is called; nothing else is done without --anyway."""
    robot.drive.faults.runaway = (2.0, 0.0)
    done = needleplan("retract", "--robot", robot.address, "--estop", f"touch {tmp_path / 'called'}", *insecure)
    assert done.returncode == 3
    assert "the needle still moves" in done.stderr
    assert "--anyway pulls the needle out all the same" in done.stderr
    assert (tmp_path / "called").exists()
    assert robot.server.machine.controller is None
    robot.drive.faults.runaway = (-1.0, 0.0)
    done = retract(robot, "--speed", "20", "--depth", "10", *insecure, "--anyway")
    assert done.returncode == 3, done.stderr  # it still runs away at the end
    assert robot.depth_mm < 11.0


@pytest.mark.slow
def test_a_slow_retraction_is_no_shorter_than_it_must_be(robot: Inserted, insecure: tuple[str, ...]) -> None:
    done = retract(robot, "--depth", "17", "--speed", "1", *insecure)
    assert done.returncode == 0, done.stderr
    assert robot.depth_mm == pytest.approx(17.0, abs=0.1)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--depth", "25"), "not_a_retraction"),
        (("--depth", "-101"), "--depth = -101.0: must be a finite number in mm, within the limits"),
        (("--speed", "21"), "within the limits, above 0 and at most 20"),
        (("--speed", "nan"), "--speed = nan"),
        (("--wait", "-1"), "--wait = -1"),
        (("--hold-to-run", "voice"), "--hold-to-run = voice: must be key"),
        (("--hold-to-run", "evdev:///dev/input/none"), "No such file"),
    ],
)
def test_what_is_refused(robot: Inserted, words: tuple[str, ...], message: str) -> None:
    refused(retract(robot, *words), message)
    assert robot.depth_mm == pytest.approx(20.0, abs=0.1)


@pytest.mark.parametrize(
    ("address", "message"), [("sim://", "must begin with udp://, canopen://"), ("robot", "--robot")]
)
def test_a_wrong_address(address: str, message: str) -> None:
    refused(needleplan("retract", "--robot", address), message)


def test_lax_limits_need_a_reason(tmp_path: Path) -> None:
    (tmp_path / "limits.toml").write_text("[safety]\nretraction_velocity_mm_s = 40.0\nforce_n = 4.0\n")
    words = ("retract", "--robot", "udp://127.0.0.1:9", "--limits", tmp_path / "limits.toml")
    refused(needleplan(*words), "safety.retraction_velocity_mm_s = 40: is laxer than the default, 20; give the reason")
    refused(needleplan(*words, "--accept-limits", " "), "--accept-limits: must be a reason")


@pytest.mark.slow
def test_without_a_robot_it_ends() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        address = f"udp://127.0.0.1:{silent.getsockname()[1]}"
        done = needleplan("retract", "--robot", address, "--wait", "0")
        assert done.returncode == 3
        assert re.search(r"has not confirmed the stop within 2(\.\d+)? s", done.stderr)
        done = needleplan("retract", "--robot", address, "--wait", "0", "--anyway")
        assert (done.returncode, done.stdout) == (3, "")
        assert "hello: no answer" in done.stderr


def test_ctrl_c_stops_it(robot: Inserted, insecure: tuple[str, ...]) -> None:
    person = once(robot, lambda: os.kill(os.getpid(), signal.SIGINT))
    done = retract(robot, "--speed", "2", *insecure)
    person.join()
    assert done.returncode == 130, done.stderr
    assert 5.0 < robot.depth_mm < 20.0
    assert stays(robot)


def test_a_stop_by_another_program_ends_it(robot: Inserted, insecure: tuple[str, ...]) -> None:
    other = once(robot, lambda: stop_stage(robot.server.address))
    done = retract(robot, "--speed", "2", *insecure)
    other.join()
    assert done.returncode == 1, done.stderr
    assert robot.depth_mm > 5.0
    # It may be ordered again.
    assert retract(robot, "--speed", "20", *insecure).returncode == 0


@pytest.mark.slow
def test_it_moves_only_while_the_switch_is_held(robot: Inserted, insecure: tuple[str, ...], tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        port = found.getsockname()[1]
    stopping, at_mm = threading.Event(), []

    def hold(held: bool, until: Callable[[], bool]) -> None:
        while not until() and not stopping.is_set():
            sender.send(held=held)
            time.sleep(0.02)

    def after(seconds: float) -> Callable[[], bool]:
        end_s = time.monotonic() + seconds
        return lambda: time.monotonic() >= end_s

    def person() -> None:
        hold(False, after(1.0))
        at_mm.append(robot.depth_mm)
        hold(True, lambda: robot.depth_mm < 17.0)
        hold(False, lambda: stays(robot))
        at_mm.append(robot.depth_mm)
        hold(False, after(0.3))
        at_mm.append(robot.depth_mm)
        hold(True, lambda: False)

    with ExitStack() as stack:
        (tmp_path / "key").write_text("5a" * 32)
        switch = f"udp://127.0.0.1:{port}?key_file={tmp_path / 'key'}"
        sender = stack.enter_context(DeadmanSender(switch))
        thread = threading.Thread(target=person)
        thread.start()
        done = retract(
            robot, "--speed", "10", *insecure,
            "--hold-to-run", switch,
        )  # fmt: skip
        stopping.set()
        thread.join()
    assert done.returncode == 0, done.stderr
    before_mm, between_mm, still_mm = at_mm
    assert before_mm == pytest.approx(20.0, abs=0.1)
    assert 1.0 < between_mm < 17.0
    assert still_mm == between_mm
    assert robot.depth_mm == pytest.approx(0.0, abs=0.1)


class Clock:
    """The time of the module of the switches, which passes when a test says so."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("needleplan.control._deadman.time", clock)
    return clock


def test_a_key_is_held_while_the_terminal_repeats_it(clock: Clock) -> None:
    master, terminal = pty.openpty()
    with KeyDeadman(terminal) as switch:
        assert not switch.is_held(0.0)
        os.write(master, b" ")
        assert not switch.is_held(1.0)  # a tap holds nothing
        clock.now_s += 0.5  # a terminal waits before it repeats
        os.write(master, b" ")
        assert not switch.is_held(1.0)
        for _ in range(5):
            clock.now_s += 0.1
            os.write(master, b" ")
            assert switch.is_held(1.0)
        clock.now_s += 0.14
        assert switch.is_held(0.0)
        clock.now_s += 0.02
        assert not switch.is_held(0.0)
    os.close(master)
    os.close(terminal)
    with Path(os.devnull).open() as file, pytest.raises(DeviceFault, match="not a terminal"):
        KeyDeadman(file.fileno())


def test_a_pedal_is_held_from_press_to_release(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "event5")
    reader = os.open(tmp_path / "event5", os.O_RDONLY | os.O_NONBLOCK)
    pedal = os.open(tmp_path / "event5", os.O_WRONLY)
    with PedalDeadman(str(tmp_path / "event5")) as switch:
        os.close(reader)
        for value, kind, held in [(1, 1, True), (2, 1, True), (0, 0, True), (0, 1, False), (1, 1, True)]:
            event = struct.pack("qqHHi", 0, 0, kind, 256, value)
            os.write(pedal, event[:10])
            switch.is_held(0.5)
            os.write(pedal, event[10:])
            assert switch.is_held(0.5) == held
        os.close(pedal)  # the cable is out
        assert not switch.is_held(0.01)
