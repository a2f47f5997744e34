"""`needleplan insert` in real time, over the bytes of devices, and devices that it refuses before anything moves."""

import json
import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest

from needleplan.cli import main
from needleplan.devices.ati import BoxSettings, NetFtBox, NetFtServer
from needleplan.devices.endpoint import TcpEndpoint
from needleplan.devices.ndi import AuroraDevice, SimulatedTool
from needleplan.devices.robot import RobotLimits, RobotMachine, RobotServer, RobotStage, SteadyDrive, open_way
from needleplan.devices.sensor_processes import LabPlaces, TrackerLine
from needleplan.simulation import Effects, Setup, SimulatedEntry
from needleplan.simulation.lab_processes import RealTimeLab
from tests.control.scenes import small_table
from tests.devices.robot.cable import Cable
from tests.devices.robot.robot_in_c import robot_in_c
from tests.estimation.registrations import known

# The machine of the tests may be busy: what is looked at here is not how fast it is.
PATIENT = """[safety]
force_age_s = 5.0
pose_age_s = 5.0
stage_age_s = 5.0
loop_age_s = 5.0
motion_s = 5.0
following_mm = 5.0
recording_age_s = 10.0
insertion_velocity_mm_s = 25.0
out_of_plane_mm = 20.0
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("insert")
    small_table().write(path / "table.h5")
    (path / "limits.toml").write_text(PATIENT)
    known(coil_offset_mm=2.0).write(path / "registration.toml")
    return path


def insert(folder: Path, robot: str, force: str, tracker: str, *more: str) -> int:
    return main(
        ["insert", str(folder / "table.h5"), "--robot", robot, "--force-sensor", force, "--tracker", tracker,
         "--registration", str(folder / "registration.toml"), "--limits", str(folder / "limits.toml"),
         "--accept-limits", "a busy machine", *more]
    )  # fmt: skip


def lab_setup() -> Setup:
    x, y, heading, _ = small_table().best_entry().pose
    effects = Effects(coil_offset_mm=2.0, tracker_noise_mm=0.05, force_noise_n=0.02)
    return Setup(1 / 40, entry=SimulatedEntry(x, y, heading), effects=effects)


@pytest.mark.realtime
def test_the_same_loop_in_real_time_with_a_robot_on_a_serial_line(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    setup, places = lab_setup(), LabPlaces(tracker_line=TrackerLine.TCP, robot_line=True)
    with RealTimeLab(setup, 1, places, RobotLimits(longest_silence_s=10.0)) as lab:
        at = lab.addresses
        run = str(folder / "run.mcap")
        speeds = ("--speed", "20", "--rotation-speed-deg", "687")
        code = insert(folder, f"{at.robot}?watchdog_s=5&valid_s=1", at.force, at.tracker, *speeds, "-o", run, "--json")
    said = capsys.readouterr()
    assert code == 0, said.err
    answer = json.loads(said.out)
    assert answer["ending"] == "target"
    assert answer["true_error_mm"] is None
    assert main(["recording", "replay", run, "--table", str(folder / "table.h5"), "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again["same"]
    assert again["decisions"] == answer["steps"]
    assert main(["recording", "export", run, "--to", "hdf5", "-o", str(folder / "run.h5")]) == 0


@pytest.mark.realtime
def test_the_robot_in_c_on_a_serial_line_moves_the_needle_of_a_lab(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    (folder / "c.toml").write_text(f"{PATIENT.replace('25.0', '20.0')}shallowest_mm = -20.0\nroll_rad = 100.0\n")
    program = robot_in_c(tmp_path, "-DLONGEST_US=20000000u", "-DVALID_US=20000000u", "-DRELEASE_MS=60000u")
    with ExitStack() as stack:
        cable = stack.enter_context(Cable())
        stack.callback(stack.enter_context(subprocess.Popen([program, cable.robot])).kill)
        way = stack.enter_context(open_way(cable.address))
        places = LabPlaces(tracker_line=TrackerLine.TCP)
        at = stack.enter_context(RealTimeLab(lab_setup(), 1, places, follow=(way.host, way.port))).addresses
        speeds = ("--speed", "15", "--rotation-speed-deg", "687", "--json", "--limits", str(folder / "c.toml"))
        code = insert(folder, f"{at.robot}?watchdog_s=5&valid_s=1", at.force, at.tracker, *speeds)
    said = capsys.readouterr()
    assert (code, json.loads(said.out or "{}").get("ending")) == (0, "target"), said.err


@dataclass(frozen=True)
class Still:
    """Devices in which nothing moves by itself."""

    robot: RobotServer
    drive: SteadyDrive
    force: str
    tracker: str


@pytest.fixture(scope="module")
def still() -> Iterator[Still]:
    x, y, _, _ = small_table().best_entry().pose
    half = 0.5**0.5  # the z axis of the coil along x: the needle points ahead
    coil = SimulatedTool("1", lambda _: ((half, 0.0, half, 0.0), (x - 2.0, y, 0.0)))
    drive = SteadyDrive()
    with ExitStack() as stack:
        limits = RobotLimits(release_s=600.0)  # a session of which nothing is heard is held, however slow the machine
        robot = stack.enter_context(RobotServer(RobotMachine(drive, limits)))
        force = stack.enter_context(NetFtServer(NetFtBox(lambda _: (0, 0, 0.1, 0, 0, 0))))
        tracker = stack.enter_context(TcpEndpoint(AuroraDevice([coil])))
        yield Still(robot, drive, force.address, tracker.address)
        assert drive.advance(0.0).depth_mm == 0  # nothing has moved it


def refused(capsys: pytest.CaptureFixture[str], code: int, *words: str) -> None:
    said = capsys.readouterr()
    assert code == 2, said.err
    assert said.out == ""
    for word in words:
        assert word in said.err


def test_two_controllers(still: Still, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with RobotStage.open(f"{still.robot.address}?watchdog_s=5"):
        code = insert(folder, still.robot.address, still.force, still.tracker)
    refused(capsys, code, "another controller")


def test_a_port_that_is_taken(still: Still, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("", 0))
        address = f"{still.robot.address}?local_port={taken.getsockname()[1]}"
        code = insert(folder, address, still.force, still.tracker)
    refused(capsys, code, "in use")


def test_units_that_nobody_knows(still: Still, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    box = NetFtBox(lambda _: (0, 0, 0, 0, 0, 0), settings=BoxSettings(force_unit="furlong"))
    with NetFtServer(box) as wrong:
        code = insert(folder, still.robot.address, wrong.address, still.tracker)
    refused(capsys, code, "furlong")


def test_a_device_of_another_type(still: Still, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A robot where the force sensor should be: it does not answer as one."""
    code = insert(folder, still.robot.address, still.robot.address, still.tracker)
    refused(capsys, code, "127.0.0.1")


def test_a_tracker_that_lacks_the_tool(still: Still, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = insert(folder, still.robot.address, still.force, f"{still.tracker}?tool=77")
    refused(capsys, code, "77")


def test_a_needle_that_stands_elsewhere(still: Still, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = insert(folder, f"{still.robot.address}?watchdog_s=5", still.force, still.tracker, "--start", "0,5,0")
    said = capsys.readouterr()
    assert code == 2, said.err
    assert "from the expected start" in said.err
    assert "refused" in said.out


def test_a_needle_that_stands_elsewhere_than_the_best_entry(
    still: Still, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without `--start`, the best entry of the table is expected."""
    x, y, _, _ = small_table().best_entry().pose
    half = 0.5**0.5
    coil = SimulatedTool("1", lambda _: ((half, 0.0, half, 0.0), (x - 2.0, y - 8.0, 0.0)))
    with TcpEndpoint(AuroraDevice([coil])) as tracker:
        code = insert(folder, f"{still.robot.address}?watchdog_s=5", still.force, tracker.address)
    said = capsys.readouterr()
    assert code == 2, said.err
    assert "8.0 mm and" in said.err
    assert "from the expected start" in said.err


def test_a_needle_that_is_far_from_its_entry_depth_is_not_driven_there(
    still: Still, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = insert(folder, f"{still.robot.address}?watchdog_s=5", still.force, still.tracker, "--entry-depth", "40")
    said = capsys.readouterr()
    assert code == 2, said.err
    assert "stage depth = 0.00 mm" in said.err
    assert "within 5 mm of the entry depth, 40 mm" in said.err


def test_the_robot_gets_the_limits_of_the_run(still: Still, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The robot of this lab goes to 200 mm; a run whose limits are wider is refused by the robot itself."""
    wide = folder / "wide.toml"
    wide.write_text(PATIENT + "deepest_mm = 250.0\n")
    code = main(
        ["insert", str(folder / "table.h5"), "--robot", still.robot.address, "--force-sensor", still.force, "--tracker",
         still.tracker, "--registration", str(folder / "registration.toml"), "--limits", str(wide),
         "--accept-limits", "a test"]
    )  # fmt: skip
    refused(
        capsys,
        code,
        "hello",
        "the depth is outside the limits of the robot",
        "narrow the limits of the run to those of the robot: -100 to 250 mm",
    )
