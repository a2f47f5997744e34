"""A whole set of devices in this process, with a robot that obeys a stop or does not."""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from needleplan.cli import main
from needleplan.devices.ati import NetFtBox, NetFtServer
from needleplan.devices.endpoint import TcpEndpoint
from needleplan.devices.ndi import AuroraDevice, SimulatedTool
from needleplan.devices.robot import RobotLimits, RobotMachine, RobotServer, SteadyDrive
from tests.control.scenes import small_table
from tests.estimation.registrations import known

START = (0, 20, 0)
"""Entry pose x (mm), y (mm), heading (deg)."""

# The machine of the tests may be busy: what is looked at here is not how fast it is.
PATIENT = """[safety]
force_age_s = 5.0
pose_age_s = 5.0
stage_age_s = 5.0
loop_age_s = 5.0
following_mm = 1.0
motion_s = 5.0
recording_age_s = 10.0
out_of_plane_mm = 20.0
"""


class LyingDrive(SteadyDrive):
    """Axes that run on when they are stopped, and report that nothing moves, until the power is cut."""

    def __init__(self) -> None:
        super().__init__()
        self.lies = False

    def stop(self) -> None:
        """Stop both axes, or go on deeper."""
        if not self.lies or self.faults.reported:
            super().stop()
            return
        self.faults.claims_rest = True
        if self._wanted[0] > 0.5:
            self._goals[0], self._speeds[0] = 170.0, 5.0


@dataclass(frozen=True)
class Rig:
    """Addresses of the devices, the drive of the robot, and the folder with table, limits and registration."""

    folder: Path
    drive: LyingDrive
    robot: RobotServer
    force: str
    tracker: str

    @property
    def address(self) -> str:
        """Address of the robot, with times that a busy machine meets."""
        return f"{self.robot.address}?watchdog_s=20&valid_s=1"

    @property
    def depth_mm(self) -> float:
        """Depth of the needle in truth."""
        return self.drive.advance(time.monotonic()).depth_mm

    def limits(self) -> tuple[str, ...]:
        """Options with the limits that a busy machine meets."""
        return "--limits", str(self.folder / "limits.toml"), "--accept-limits", "a busy machine"

    def words(self, *more: str) -> list[str]:
        """Return the words of the command that inserts."""
        return [
            "insert", str(self.folder / "table.h5"), "--robot", self.address, "--force-sensor", self.force,
            "--tracker", self.tracker, "--registration", str(self.folder / "registration.toml"), *self.limits(),
            "--start", ",".join(map(str, START)), "--no-replan", *more,
        ]  # fmt: skip

    def insert(self, *more: str) -> int:
        """Insert by the command line, and return its exit code.

        A busy machine is silent for longer than devices may be: what was refused before anything moved is tried again.
        """
        codes = (main(self.words(*more)) for _ in range(5))
        return next((code for code in codes if code != 2), 2)


@contextlib.contextmanager
def moving_robot(folder: Path) -> Iterator[Rig]:
    """Serve the devices; the coil follows the needle straight ahead."""
    if not (folder / "table.h5").exists():
        small_table().write(folder / "table.h5")
        (folder / "limits.toml").write_text(PATIENT)
        known(coil_offset_mm=2.0).write(folder / "registration.toml")
    half = 0.5**0.5  # the z axis of the coil along x: the needle points ahead
    drive = LyingDrive()
    coil = SimulatedTool("1", lambda _: ((half, 0.0, half, 0.0), (START[0] - 2.0 + drive._measured[0], START[1], 0.0)))
    with contextlib.ExitStack() as stack:
        machine = RobotMachine(drive, RobotLimits(longest_silence_s=30.0))
        robot = stack.enter_context(RobotServer(machine))
        force = stack.enter_context(NetFtServer(NetFtBox(lambda time_s: (0, 0, 0.1 + 0.01 * (time_s % 0.1), 0, 0, 0))))
        tracker = stack.enter_context(TcpEndpoint(AuroraDevice([coil])))
        yield Rig(folder, drive, robot, force.address, tracker.address)
