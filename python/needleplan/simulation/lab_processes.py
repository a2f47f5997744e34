"""The lab in real time: three processes with the protocols of a robot, a force sensor and a tracker.

The plant runs in the process of the robot, which sends the measured values to the other two processes. No process waits
for another, so a process that is killed or suspended does not block the others.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import socket
import time
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from needleplan.devices import Closing, ForceSample, PoseSample, no_long_collections
from needleplan.devices.robot import (
    DriveLimits,
    RobotDrive,
    RobotDriveState,
    RobotLimits,
    RobotMachine,
    RobotRelay,
    RobotServer,
    RobotStatus,
)
from needleplan.devices.sensor_processes import (
    Failed,
    FeedSender,
    LabAddresses,
    LabPlaces,
    Ready,
    Served,
    call_at_end,
    feed_pair,
    place_or_report,
    report_end,
    serve_force,
    serve_tracker,
)
from needleplan.errors import InputError, Mistake
from needleplan.simulation._lab import Lab
from needleplan.simulation._setup import TRACKER_HZ, Setup

__all__ = ["PlantDrive", "RealTimeLab", "limits_of", "serve_robot"]

# time limits (s) for the start of a process, and for its end, after which it is killed
_START_S, _END_S = 60.0, 3.0
# longest time step (s) of the plant; if the process was suspended for longer, the rest of the time is skipped
_LONGEST_STEP_S = 0.05


class PlantDrive(RobotDrive):
    """Drive of the robot process: it simulates the lab and calls `measured` with each force and pose sample."""

    def __init__(self, lab: Lab, measured: Callable[[ForceSample | PoseSample], None]) -> None:
        self._lab, self._measured = lab, measured
        self._time_s: float | None = None
        self._skipped_s = 0.0

    def advance(self, time_s: float) -> RobotDriveState:
        """Simulate the plant up to a time (s), at most for 0.05 s, and return the state of the axes."""
        lab, plant = self._lab, self._lab.plant
        passed_s = 0.0 if self._time_s is None else time_s - self._time_s
        self._time_s = time_s
        self._skipped_s += max(passed_s - _LONGEST_STEP_S, 0.0)
        lab.advance(min(passed_s, _LONGEST_STEP_S))
        lab.stage.waiting()
        for force in lab.force_sensor.waiting():
            self._measured(force)
        for pose in lab.tracker.waiting():
            # The frames of a tracker are numbered by time, also while the process was suspended.
            frame = pose.stamp.sequence + int(self._skipped_s * TRACKER_HZ)
            self._measured(replace(pose, stamp=replace(pose.stamp, sequence=frame)))
        insertion, roll = plant.insertion, plant.roll
        return RobotDriveState(
            insertion.measured, insertion.measured_velocity, roll.measured, roll.measured_velocity,
            insertion.reference, roll.reference, plant.moving,
        )  # fmt: skip

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin to move to a depth. Raises DeviceFault if depth or velocity is beyond the range of the robot."""
        self._lab.plant.insert(depth_mm, velocity_mm_s)

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin to rotate to a roll. Raises DeviceFault if roll or velocity is beyond the range of the robot."""
        self._lab.plant.rotate(roll_rad, velocity_rad_s)

    def stop(self) -> None:
        """Stop both axes with the deceleration of their profiles."""
        self._lab.plant.stop()


def limits_of(lab: Lab) -> DriveLimits:
    """Return the drive limits: default following errors plus the motion in a tick, and 4 times the top speeds."""
    robot, usual = lab.plant.setup.robot, DriveLimits()
    return DriveLimits(
        usual.following_mm + robot.top_velocity_mm_s / robot.servo_hz,
        usual.following_rad + robot.top_velocity_rad_s / robot.servo_hz,
        4 * robot.top_velocity_mm_s,
        4 * robot.top_velocity_rad_s,
    )


def serve_robot(
    boss: Connection, setup: Setup, seed: int, places: LabPlaces, limits: RobotLimits,
    key: bytes | None, follow: tuple[str, int] | None, to_force: socket.socket, to_tracker: socket.socket,
) -> None:  # fmt: skip
    """Run the process of the robot, which simulates the plant in real time, until the parent ends it.

    With `follow`, a relay to the robot at this host and port takes the place of the simulated robot, and the needle
    moves with its positions.

    Sends to the parent: `Ready` with the address of the robot after the first sample, or `Failed` if the port cannot be
    opened; at the end `Served`.
    """
    forces, poses = FeedSender(to_force), FeedSender(to_tracker)
    begun = False

    def measured(sample: ForceSample | PoseSample) -> None:
        nonlocal begun
        (forces if isinstance(sample, ForceSample) else poses).send(sample)
        if not begun:  # only now: before the first measured value, the sensors would be open but without samples
            begun = True
            assert server is not None
            boss.send(Ready(server.address))

    lab = Lab(setup, seed)
    drive = PlantDrive(lab, measured)
    machine = RobotMachine(drive, limits, limits_of(lab), key)

    def place() -> RobotServer | RobotRelay:
        if follow is None:
            return RobotServer(machine, places.host, places.robot_port, line=places.robot_line)
        return RobotRelay(follow, seen, drive.advance, places.host, places.robot_port)

    def seen(status: RobotStatus) -> None:
        lab.plant.insertion.follow(status.depth_mm, status.velocity_mm_s)
        lab.plant.roll.follow(status.roll_rad, status.velocity_rad_s)

    server = place_or_report(boss, place)
    if server is None:
        return
    call_at_end(boss, server.stop)
    with no_long_collections():
        server.run()
    server.close()
    overruns, statuses = machine.overruns, 0
    if isinstance(server, RobotRelay):
        overruns, statuses = server.overruns, server.statuses
    report_end(boss, Served(server.ticks, overruns, server.worst_overrun_s, statuses))


class RealTimeLab(Closing):
    """A lab in three processes, which `close` ends. `addresses` contains the addresses of its devices.

    With a `key`, the robot obeys only datagrams that are authenticated with it. With `follow`, a host and a port, the
    needle moves with the robot there, and the address of the robot is that of a relay to it.

    Raises InputError if a device cannot be opened at its address.
    """

    def __init__(
        self, setup: Setup, seed: int = 0, places: LabPlaces | None = None, limits: RobotLimits | None = None,
        key: bytes | None = None, follow: tuple[str, int] | None = None,
    ) -> None:  # fmt: skip
        places = LabPlaces() if places is None else places
        self.served: dict[str, Served] = {}
        """Final message of each process, by the name of the process; filled by `close`."""

        self._parts: dict[str, tuple[BaseProcess, Connection]] = {}
        self._dead: set[str] = set()
        self._closed = False
        to_force, of_force = feed_pair()
        to_tracker, of_tracker = feed_pair()
        ends = (to_force, of_force, to_tracker, of_tracker)
        try:
            limits = RobotLimits() if limits is None else limits
            self._start("force sensor", serve_force, places, of_force)
            self._start("tracker", serve_tracker, places, of_tracker)
            force, tracker = (self._address(name, places) for name in ("force sensor", "tracker"))
            self._start("robot", serve_robot, setup, seed, places, limits, key, follow, to_force, to_tracker)
            robot = self._address("robot", places)
        except BaseException:
            for process, _ in self._parts.values():
                process.kill()  # some processes do not receive messages yet
            self.close()
            raise
        finally:
            for end in ends:
                end.close()
        self.addresses: LabAddresses = LabAddresses(robot, force, tracker)

    @property
    def pids(self) -> dict[str, int]:
        """Process id of each process, by its name."""
        return {name: process.pid or 0 for name, (process, _) in self._parts.items()}

    def newly_ended(self) -> dict[str, str]:
        """Return the exit code or signal of each process that has ended since the last call, by the process name."""
        found = {}
        for name, (process, _) in self._parts.items():
            code = process.exitcode
            if code is not None and name not in self._dead:
                self._dead.add(name)
                found[name] = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
        return found

    @property
    def alive(self) -> bool:
        """Whether at least one process is running."""
        return any(process.is_alive() for process, _ in self._parts.values())

    def close(self) -> None:
        """End all processes; a process that does not end within 3 s is killed."""
        if self._closed:
            return
        self._closed = True
        for process, boss in self._parts.values():
            if process.is_alive():
                _ask_to_end(boss)
        end_s = time.monotonic() + _END_S
        for name, (process, boss) in self._parts.items():
            words = _last_message(boss, max(end_s - time.monotonic(), 0.0))
            if words is not None:
                self.served[name] = words
            process.join(max(end_s - time.monotonic(), 0.1))
            if process.is_alive():
                process.kill()
                process.join()
            boss.close()

    def _start(self, name: str, work: Any, *arguments: object) -> None:
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=work, args=(theirs, *arguments), name=f"needleplan lab: {name}", daemon=True)
        self._parts[name] = (process, ours)
        process.start()
        theirs.close()

    def _address(self, name: str, places: LabPlaces) -> str:
        _, boss = self._parts[name]
        try:
            said = boss.recv() if boss.poll(_START_S) else None
        except EOFError:
            said = None
        if isinstance(said, Ready):
            return said.address
        ports = {"force sensor": f"{places.force_port}, {places.http_port}", "tracker": f"{places.tracker_port}"}
        why = said.why if isinstance(said, Failed) else "its process has ended"
        raise InputError(Mistake(f"{name} at {places.host}:{ports.get(name, places.robot_port)}", "", why))


def _ask_to_end(boss: Connection) -> None:
    with contextlib.suppress(OSError):
        boss.send(None)


def _last_message(boss: Connection, timeout_s: float) -> Served | None:
    with contextlib.suppress(EOFError, OSError):
        while boss.poll(timeout_s):
            said = boss.recv()
            if isinstance(said, Served):
                return said
    return None
