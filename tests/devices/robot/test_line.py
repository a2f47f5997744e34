"""A robot on a serial line: real pseudo-terminals, a paced cable between them, and what may happen to it."""

import fcntl
import shutil
import subprocess
import threading
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import pytest

from needleplan import line_owner
from needleplan.cli import main
from needleplan.devices import Stage, open_stage
from needleplan.devices.robot import (
    RobotLimits,
    RobotMachine,
    RobotServer,
    RobotStage,
    RobotTiming,
    SteadyDrive,
    open_way,
    stop_robot,
)
from needleplan.devices.robot._frames import framed
from needleplan.devices.robot.conformance import CASES
from needleplan.devices.robot.messages import Head, decode
from needleplan.errors import AddressError, DeviceFault, LinkClosed
from needleplan.line_owner import line_place, line_port
from tests.devices.contract import StageContract, heard_and_read
from tests.devices.robot.bench import Bench
from tests.devices.robot.cable import BYTES_S, Cable
from tests.devices.robot.robot_in_c import robot_in_c

PATIENT = RobotTiming(silence_s=10.0, valid_s=10.0, answer_s=10.0, lost_s=10.0)
LIMITS = RobotLimits(longest_silence_s=20.0, longest_valid_s=20.0, release_s=60.0)
KEY = b"a key of 16 bytes"
QUICK = ("-DLONGEST_US=20000000u", "-DVALID_US=20000000u", "-DRELEASE_MS=60000u")


@pytest.fixture
def server() -> Iterator[RobotServer]:
    with RobotServer(RobotMachine(SteadyDrive(), LIMITS), line=True) as serving:
        yield serving


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    return robot_in_c(tmp_path_factory.mktemp("robot"), *QUICK)


@pytest.fixture
def cable(program: Path) -> Iterator[Cable]:
    """A cable with the robot in C at its other end."""
    with Cable() as joined, subprocess.Popen([program, joined.robot]) as robot:
        try:
            yield joined
        finally:
            robot.kill()


@pytest.mark.slow
class TestARobotOnALine(StageContract):
    @pytest.fixture
    def sensor(self, server: RobotServer) -> Iterator[Stage]:
        with RobotStage.open(server.address, timing=PATIENT) as opened:
            yield opened


def moving(stage: RobotStage, depth_mm: float = 100.0) -> None:
    stage.insert(depth_mm, 5.0)
    sample = heard_and_read(stage, 1.0)
    while sample is None or sample.depth_mm < 0.3:
        sample = heard_and_read(stage, 1.0)


def read_on(stage: RobotStage, kind: type[DeviceFault], cause: str) -> None:
    """Read until the stage gives up with a cause."""
    with pytest.raises(kind, match=cause):
        deque((heard_and_read(stage, 0.02) for _ in range(1000)), maxlen=0)


def test_the_other_program_is_refused_and_may_stop(server: RobotServer) -> None:
    path = server.address.removeprefix("serial://")
    assert line_port(path) is None
    with RobotStage.open(server.address, timing=PATIENT) as stage:
        port = line_port(path)
        with pytest.raises(DeviceFault, match="another program controls the robot on this line"):
            open_way(server.address)
        moving(stage)
        assert main(["stop", "--robot", server.address, "--within", "20"]) == 0
        read_on(stage, DeviceFault, "another sender ordered a stop")
        assert line_port(path) == port
    assert line_port(path) is None
    assert stop_robot(server.address, 20.0).is_confirmed


def test_a_wrong_speed_and_a_silent_line_are_told(server: RobotServer, capsys: pytest.CaptureFixture[str]) -> None:
    short = RobotTiming(answer_s=0.05)
    for address in (f"{server.address}?baud=115200", server.address):
        with pytest.raises(DeviceFault, match=r"no answer within 0.05 s; /dev/\S+ has received nothing.*baud = \d+"):
            RobotStage.open(address, timing=short) if "?" in address else _silent(server, short)
    assert main(["check-robot", f"{server.address}?baud=115200", "--may-move", "2"]) == 1
    assert "has received nothing: has the robot power, its cable, and baud = 115200?" in capsys.readouterr().err
    assert main(["stop", "--robot", f"{server.address}?baud=115200", "--within", "0.1"]) == 3
    assert "baud = 115200?" in capsys.readouterr().err


def _silent(server: RobotServer, timing: RobotTiming) -> None:
    server.machine.receive = lambda *_: b""  # type: ignore[method-assign]
    RobotStage.open(server.address, timing=timing)


def test_garbage_of_a_wrong_speed_is_told(cable: Cable) -> None:
    """The robot still sends statuses to a controller that has died."""
    with RobotStage.open(cable.address, timing=PATIENT) as stage:
        stage._wire.close()
        cable.fault("garble", 1)
        with pytest.raises(DeviceFault, match=r"has received \d+ bytes but no message: has the robot power.*460800"):
            RobotStage.open(cable.address, timing=RobotTiming(answer_s=0.3))


def test_an_unplugged_line_is_told(cable: Cable) -> None:
    with RobotStage.open(cable.address, timing=PATIENT) as stage:
        moving(stage)
        cable.fault("unplug", 1)
        read_on(stage, LinkClosed, rf"robot: {cable.address}: the line was unplugged")


def test_who_looks_for_the_owner_of_a_line_does_not_keep_it(server: RobotServer) -> None:
    place = Path(line_place(server.address.removeprefix("serial://")))
    open_way(server.address).close()
    with place.open() as looking:
        fcntl.flock(looking, fcntl.LOCK_SH)
        threading.Timer(0.05, lambda: fcntl.flock(looking, fcntl.LOCK_UN)).start()
        open_way(server.address).close()


def test_a_folder_of_another_user_leads_nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_owner, "run_folder", lambda: str(tmp_path))
    with Path(line_place("/dev/ttyUSB0")).open("w", encoding="ascii") as file:
        file.write("4711")
        file.flush()
        fcntl.flock(file, fcntl.LOCK_EX)
        assert line_port("/dev/ttyUSB0") == 4711
        monkeypatch.setattr(line_owner.os, "getuid", lambda: tmp_path.stat().st_uid + 1)
        assert line_port("/dev/ttyUSB0") is None


@pytest.mark.parametrize(("fault", "share"), [("lose", 0.0005), ("noise", 0.0005), ("cut", 0.02)])
def test_damaged_frames_are_lost_and_nothing_else(cable: Cable, fault: str, share: float) -> None:
    with RobotStage.open(cable.address, timing=PATIENT) as stage:
        cable.fault(fault, share)
        moving(stage, 1.5)
        sample = heard_and_read(stage, 1.0)
        for number in range(5000):  # how many bytes are read at once decides how many reads can be cut
            sample = heard_and_read(stage, 1.0) or sample
            if number > 150 and stage.counts.lost:
                break
        assert sample is not None
        counts = stage.counts
        assert counts.received > 100
        assert counts.lost > 0
        assert counts.malformed == counts.foreign == 0
        cable.fault(fault, 0)


def test_addresses(tmp_path: Path) -> None:
    for address, words in {
        "serial://host/dev/ttyUSB0": "three slashes", "serial:///dev/ttyUSB0?bad=1": "did you mean",
        "serial:///dev/ttyUSB0?local_port=1": "local_port", f"serial://{tmp_path}/x?baud=0": "from 1 to",
        f"serial://{tmp_path}/x?baud=fast": "baud = fast", "canopen://can0": "serial:///dev/ttyUSB0",
    }.items():  # fmt: skip
        with pytest.raises(AddressError, match=words):
            RobotStage.open(address)
    with pytest.raises(DeviceFault, match="there is no such port"):
        open_stage(f"serial://{tmp_path}/x")
    assert line_port(f"{tmp_path}/x") is None


ON_A_LINE = (
    "statuses", "damaged", "busy", "key", "wrap", "deadlines", "stop", "stop-under-load", "foreign-stop", "witness",
    "watchdog", "late-heartbeat",
)  # fmt: skip


@pytest.mark.parametrize(
    "only",
    [pytest.param(ON_A_LINE, marks=pytest.mark.realtime, id="those of the line"),
     pytest.param((), marks=pytest.mark.study, id="all")],
)  # fmt: skip
def test_the_robot_in_c_keeps_the_rules_on_a_line_of_460800_baud(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], only: tuple[str, ...]
) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    (tmp_path / "robot.key").write_text(KEY.hex())
    with Cable() as joined, subprocess.Popen([robot_in_c(tmp_path), joined.robot, KEY.decode()]) as robot:
        try:
            words = [f"{joined.address}?key_file={tmp_path / 'robot.key'}", "--may-move", "2"]
            code = main(["check-robot", *words, *(f"--only={name}" for name in only)])
        finally:
            robot.kill()
    printed, rules = capsys.readouterr(), len(only or CASES)
    assert (code, printed.out.splitlines()[-1]) == (0, f"{rules} of {rules} rules hold"), printed.out


def test_statuses_with_tags_to_a_controller_and_a_person_fit_the_line() -> None:
    robot = Bench(LIMITS, KEY)
    robot.machine.compact = True
    with robot.stage(key=KEY) as stage:
        way = robot.network.from_robot.seen
        begin = len(way)
        robot.machine._witnesses.add(("line", 2), Head(0, 1, 1), robot.clock.now_ns() + robot.network.ahead_ns)
        robot.wait(0.4)
        sizes = [len(framed(1, datagram)) for datagram in way[begin:]]
        assert 150 <= len(sizes) <= 161
        assert sum(sizes) < 0.85 * 0.4 * BYTES_S
        assert stage.read(0.01) is not None
        controller = [message for message in map(decode, way[begin:]) if message.head.session]
        assert len(controller) > 75
