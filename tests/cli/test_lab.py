"""The program `needleplan lab` as a user runs it, seen through the clients of the real devices."""

import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from needleplan.devices import Health, PoseSample
from needleplan.devices.ati import ForceLimits, NetFt
from needleplan.devices.ndi import NdiPoseLimits, NdiTracker
from needleplan.devices.robot import RobotLimits, RobotMachine, RobotServer, RobotStage, RobotTiming, SteadyDrive
from needleplan.errors import DeviceFault
from needleplan.estimation.registration import Registration
from needleplan.planning import PolicyTable
from tests.cli.commands import needleplan, program, refused
from tests.control.space_scenes import box_table

PATIENT = {"silence_s": 20.0, "valid_s": 20.0, "answer_s": 20.0, "lost_s": 20.0}
BEARING = ForceLimits(silence_s=20.0, start_s=20.0, frozen_samples=10_000)
SLOW = NdiPoseLimits(silence_s=20.0, step_mm=500.0)


class Running:
    """The program, with what it has said first."""

    def __init__(self, *arguments: str) -> None:
        command = [sys.executable, "-m", "needleplan", "lab", "--json", "--longest-silence", "60", *arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        lines = []
        while not lines or lines[-1] not in ("}\n", ""):
            lines.append(self.process.stdout.readline())
        self.said: dict[str, Any] = json.loads("".join(lines) or "{}")
        self.pids: dict[str, int] = self.said["processes"]

    def end(self, by: signal.Signals) -> tuple[int, str]:
        """Send a signal to the program alone, and return its exit code and what it said on standard error."""
        self.process.send_signal(by)
        _, errors = self.process.communicate(timeout=60)
        return self.process.returncode, errors


def runs(pid: int) -> bool:
    """Whether a process is there and no zombie that a starved init has not fetched yet."""
    try:
        with open(f"/proc/{pid}/stat") as file:  # noqa: PTH123
            return file.read().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def before(limit_s: float, condition: Callable[[], bool]) -> bool:
    """Wait for something that happens in other processes."""
    end_s = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end_s:
            return False
        time.sleep(0.01)
    return True


@pytest.fixture
def start() -> Iterator[Callable[..., Running]]:
    """Start the program; whatever becomes of the test, it ends."""
    started: list[Running] = []

    def begin(*arguments: str) -> Running:
        started.append(Running(*arguments))
        return started[-1]

    yield begin
    for each in started:
        if each.process.poll() is None:
            each.end(signal.SIGTERM)
        for stream in (each.process.stdout, each.process.stderr):
            if stream is not None:
                stream.close()


@pytest.mark.study
@pytest.mark.parametrize("follows", [False, True], ids=["its own robot", "a robot outside"])
def test_three_clients_see_one_needle_go_in(start: Callable[..., Running], *, follows: bool) -> None:
    patient = RobotLimits(longest_silence_s=20.0, longest_valid_s=20.0)
    outside = RobotServer(RobotMachine(SteadyDrive(), patient))
    lab = start("insertion", *(("--follow", outside.address) if follows else ()))
    with (
        outside,
        NetFt.open(lab.said["force"], limits=BEARING) as force,
        NdiTracker.open(lab.said["tracker"], limits=SLOW) as tracker,
        RobotStage.open(lab.said["robot"], timing=RobotTiming(**PATIENT)) as stage,
    ):
        poses: list[PoseSample] = []
        assert before(30, lambda: _pose(tracker, poses).health is Health.GOOD)
        first = poses[-1]
        at_rest_n = [sample.force_n[2] for sample in (force.read(20.0) for _ in range(20)) if sample]
        stage.insert(20.0, 20.0)
        sample = stage.read(20.0)
        while sample is not None and sample.moving:
            stage.heartbeat()
            sample = stage.read(20.0)
        assert sample is not None
        assert sample.depth_mm == pytest.approx(20.0, abs=0.05)
        loads_n: list[float] = []
        assert before(30, lambda: _last(force, loads_n) > max(at_rest_n) + 0.2)
        # From 2 mm before the tissue, or from the first position of the robot: by what the coil behind the tip goes.
        least_mm = 19 if follows else 21
        assert before(30, lambda: _pose(tracker, poses).position_mm[0] - first.position_mm[0] > least_mm)
        assert poses[-1].position_mm[0] - first.position_mm[0] < 23
    code, errors = lab.end(signal.SIGINT)
    assert code == 0, errors
    assert "ticks" in errors
    assert "Traceback" not in errors
    assert not any(map(runs, lab.pids.values()))


@pytest.mark.study
def test_with_a_table_in_space_the_coil_is_behind_the_entry_in_ras(
    start: Callable[..., Running], tmp_path: Path
) -> None:
    box_table().write(tmp_path / "space.h5")
    file = tmp_path / "registration.toml"
    lab = start("steering", "--tracker-line", "tcp", "--table", str(tmp_path / "space.h5"), "--output", str(file))
    with NdiTracker.open(lab.said["tracker"], limits=SLOW) as tracker:
        poses: list[PoseSample] = []
        assert before(30, lambda: _pose(tracker, poses).health is Health.GOOD)
    frame, entry = box_table().scenario.grid.frame, box_table().best_entry().pose
    coil = Registration.read(file).place(poses[-1].position_mm, poses[-1].quaternion)
    # The simulation begins 2 mm before the surface, and its coil is 3 mm behind the tip.
    behind = [at - 5 * along for at, along in zip(entry.position_mm, entry.tangent, strict=True)]
    assert math.dist(coil.position_mm, frame.world(behind)) < 1.0
    assert coil.direction == pytest.approx(entry.tangent @ frame.axes, abs=0.1)


@pytest.mark.slow
def test_with_a_table_the_needle_is_where_its_insertion_begins_and_a_kill_leaves_nothing(
    start: Callable[..., Running], table: PolicyTable, table_file: Path, tmp_path: Path
) -> None:
    file = tmp_path / "registration.toml"
    lab = start("--tracker-line", "tcp", "--table", str(table_file), "--output", str(file))
    with NdiTracker.open(lab.said["tracker"], limits=SLOW) as tracker:
        poses: list[PoseSample] = []
        assert before(30, lambda: _pose(tracker, poses).health is Health.GOOD)
    # The simulation begins 2 mm before the surface, and its coil is 3 mm behind the tip.
    registration = Registration.read(file)
    assert registration.coil_offset_mm == 3.0
    pose = table.best_entry().pose
    coil = registration.place(poses[-1].position_mm, poses[-1].quaternion)
    assert math.dist(coil.position_mm, (
        pose.x_mm - 5 * math.cos(pose.heading_rad), pose.y_mm - 5 * math.sin(pose.heading_rad), 0.0
    )) < 1.0  # fmt: skip
    assert coil.direction == pytest.approx((math.cos(pose.heading_rad), math.sin(pose.heading_rad), 0.0), abs=0.1)
    lab.process.kill()
    lab.process.wait()
    assert before(30, lambda: not any(map(runs, lab.pids.values())))


def _last(force: NetFt, seen_n: list[float]) -> float:
    sample = force.read(20.0)
    assert sample is not None
    seen_n.append(sample.force_n[2])
    return sample.force_n[2]


def _pose(tracker: NdiTracker, seen: list[PoseSample]) -> PoseSample:
    sample = tracker.read(20.0)
    assert sample is not None
    seen.append(sample)
    return sample


@pytest.mark.study
def test_one_that_is_killed_leaves_the_others_and_all_end_with_the_program(start: Callable[..., Running]) -> None:
    lab = start("--tracker-line", "tcp")
    with (
        RobotStage.open(lab.said["robot"], timing=RobotTiming(**PATIENT)) as stage,
        NetFt.open(lab.said["force"]) as force,
    ):
        os.kill(lab.pids["tracker"], signal.SIGKILL)
        stage.insert(2.0, 20.0)
        sample = stage.read(20.0)
        while sample is not None and sample.moving:
            stage.heartbeat()
            sample = stage.read(20.0)
        assert sample is not None
        assert sample.depth_mm == pytest.approx(2.0, abs=0.05)
        # Without a plant the force sensor does not pass old values for new.
        os.kill(lab.pids["robot"], signal.SIGKILL)
        with pytest.raises(DeviceFault, match=r"has not measured|silent"):
            deque((force.read(1.0) for _ in range(5000)), maxlen=0)
    os.kill(lab.pids["force sensor"], signal.SIGSTOP)
    code, errors = lab.end(signal.SIGTERM)
    assert code == 0
    assert "the process of the robot has ended: SIGKILL" in errors
    assert "the process of the tracker has ended: SIGKILL" in errors
    assert not any(map(runs, lab.pids.values()))


@pytest.mark.study
@pytest.mark.parametrize(
    ("option", "kind", "device"),
    [("--robot-port", socket.SOCK_DGRAM, "robot"), ("--http-port", socket.SOCK_STREAM, "force sensor"),
     ("--tracker-port", socket.SOCK_STREAM, "tracker")],
)  # fmt: skip
def test_a_port_that_is_taken_is_one_clear_error(option: str, kind: socket.SocketKind, device: str) -> None:
    with socket.socket(socket.AF_INET, kind) as taken:
        taken.bind(("127.0.0.1", 0))
        if kind == socket.SOCK_STREAM:
            taken.listen()
        port = taken.getsockname()[1]
        refused(program("lab", option, port, "--tracker-line", "tcp"), device, str(port), "already in use")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "words"),
    [(("insertoin",), ("did you mean",)), (("--robot-port", "70000"), ("--robot-port = 70000", "from 0 to 65535")),
     (("--start", "0,20,0"), ("needs --table",)), (("--table", "no.h5"), ("no.h5",)),
     (("--tracker-port", "8765"), ("needs --tracker-line tcp",)), (("--duration", "nan"), ("in s above 0",)),
     (("--longest-silence", "0"), ("at least 0.005 and at most 60",)), (("--seed", "-1"), ("whole number",)),
     (("--host", "name.invalid"), ("name.invalid",)), (("--follow", ""), ("must begin with the kind of link",)),
     (("--follow", "udp://name.invalid"), ("host = name.invalid",)),
     (("--follow", "serial:///dev/nowhere"), ("--follow = serial:///dev/nowhere", "there is no such port")),
     (("--follow", "udp://127.0.0.1:9", "--longest-silence", "1", "--robot-line", "pty"),
      ("--longest-silence = 1: is that of the robot at --follow", "needs --robot-line udp"))],
)  # fmt: skip
def test_what_cannot_be_is_refused(arguments: tuple[str, ...], words: tuple[str, ...]) -> None:
    # If it is not refused, it ends.
    ending = () if "--duration" in arguments else ("--duration", "1")
    refused(needleplan("lab", *arguments, *ending), *words)


@pytest.mark.study
def test_a_robot_that_is_not_there_is_told_at_the_end() -> None:
    done = needleplan("lab", "--follow", "udp://127.0.0.1:9", "--duration", "1")
    assert done.returncode == 0
    assert "warning: udp://127.0.0.1:9 has sent no status" in done.stderr


@pytest.mark.study
def test_it_ends_by_itself_after_a_time() -> None:
    done = program("lab", "friction", "--duration", "0.2")
    assert done.returncode == 0
    assert [line.split()[0] for line in done.stdout.splitlines()[1:]] == ["--robot", "--force-sensor", "--tracker"]


@pytest.mark.slow
def test_a_robot_with_a_key_takes_only_who_has_it(tmp_path: Path) -> None:
    key = tmp_path / "robot.key"
    key.write_text("0f" * 32)
    lab = Running("--key-file", str(key))
    try:
        address = lab.said["robot"]
        with pytest.raises(DeviceFault, match="requires another key"):
            RobotStage.open(address, timing=RobotTiming(**PATIENT))
        with RobotStage.open(f"{address}?key_file={key}", timing=RobotTiming(**PATIENT)) as stage:
            stage.insert(0.5, 5.0)
            assert stage.read(20.0) is not None
    finally:
        assert lab.end(signal.SIGTERM)[0] == 0
