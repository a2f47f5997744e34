"""Simulated robot: drives without physics, and a server at a UDP socket or a pseudo-terminal."""

from __future__ import annotations

import math
import select
import threading
import time
from dataclasses import dataclass
from typing import Self

from needleplan.artifacts import CallRepr
from needleplan.devices._base import Closing
from needleplan.devices.robot._doors import PtyDoor, UdpDoor
from needleplan.devices.robot._drives import RobotDrive, RobotDriveState
from needleplan.devices.robot._machine import RobotMachine
from needleplan.devices.robot.messages import Fault
from needleplan.errors import DeviceFault

__all__ = ["RobotDriveFaults", "RobotServer", "SteadyDrive"]

_MOST_OVERTIME = 256  # largest number of datagrams that are received after a tick is due; then the tick is executed


@dataclass
class RobotDriveFaults(CallRepr):
    """Faults that the simulated drives show from now on."""

    reported: Fault = Fault(0)
    """Faults that the drives report: DRIVE, LIMIT or ESTOP. The axes do not move while ESTOP is set."""

    stuck: bool = False
    """Whether the measured positions stay constant during a motion."""

    slow: float = 1.0
    """Share of the commanded motion that the axes execute."""

    reversed: bool = False
    """Whether the encoders count in the wrong direction."""

    jump_mm: float = 0.0
    """Jump of the measured depth at the next `advance`, which sets this field back to 0."""

    missed_stops: int = 0
    """Number of the next stops that the drives miss."""

    braking_mm_s2: float = math.inf
    """Deceleration (mm/s^2) of the insertion axis after a stop; infinity: it stops at once."""

    claims_rest: bool = False
    """Whether the drives always report that no axis moves."""

    runaway: tuple[float, float] = (0.0, 0.0)
    """Speeds (mm/s, rad/s) at which a faulty drive moves its axes, with their commanded positions, by itself."""


class SteadyDrive(RobotDrive):
    """Two simulated axes that reach the commanded speed at once, and stop at once unless `faults` says otherwise."""

    def __init__(self, deepest_mm: float = 180.0, fastest_mm_s: float = 50.0, fastest_rad_s: float = 12.0) -> None:
        self.faults: RobotDriveFaults = RobotDriveFaults()
        self._deepest_mm, self._fastest = deepest_mm, (fastest_mm_s, fastest_rad_s)
        self._goals, self._speeds = [0.0, 0.0], [0.0, 0.0]
        self._wanted, self._measured = [0.0, 0.0], [0.0, 0.0]
        self._velocities = [0.0, 0.0]
        self._time_s: float | None = None
        self._brakes = False
        """Whether the insertion axis decelerates after a stop."""

    def advance(self, time_s: float) -> RobotDriveState:
        """Advance to the time `time_s`, and return the state of the drives."""
        passed_s = 0.0 if self._time_s is None else max(time_s - self._time_s, 0.0)
        self._time_s = time_s
        faults = self.faults
        if Fault.ESTOP in faults.reported:
            self.stop()
        share = 0.0 if faults.stuck else -faults.slow if faults.reversed else faults.slow
        if self._brakes:
            self._speeds[0] = max(self._speeds[0] - faults.braking_mm_s2 * passed_s, 0.0)
            if not self._speeds[0]:
                self._goals[0] = self._wanted[0]
        for axis in range(2):
            left = self._goals[axis] - self._wanted[axis]
            step = math.copysign(min(abs(left), self._speeds[axis] * passed_s), left)
            self._wanted[axis] += step
            self._measured[axis] += share * step
            self._velocities[axis] = share * step / passed_s if passed_s else 0.0
            astray = faults.runaway[axis] * passed_s
            self._wanted[axis] += astray
            self._measured[axis] += astray
            self._goals[axis] += astray
        self._measured[0] += faults.jump_mm
        faults.jump_mm = 0.0
        depth_mm, roll_rad = self._measured
        return RobotDriveState(
            depth_mm, self._velocities[0], roll_rad, self._velocities[1], self._wanted[0],
            self._wanted[1], self._wanted != self._goals and not faults.claims_rest, faults.reported,
        )  # fmt: skip

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin a motion to a depth. Raises DeviceFault if the depth or the speed exceeds its limit."""
        if not (abs(depth_mm) <= self._deepest_mm and velocity_mm_s <= self._fastest[0]):
            raise DeviceFault(f"simulated drive: {depth_mm:g} mm at {velocity_mm_s:g} mm/s is beyond its limits")
        self._goals[0], self._speeds[0], self._brakes = depth_mm, velocity_mm_s, False

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin a rotation to a roll angle. Raises DeviceFault if the speed exceeds its limit."""
        if not velocity_rad_s <= self._fastest[1]:
            raise DeviceFault(f"simulated drive: {velocity_rad_s:g} rad/s is beyond its limits")
        self._goals[1], self._speeds[1] = roll_rad, velocity_rad_s

    def stop(self) -> None:
        """Stop both axes: at their measured positions, or where `braking_mm_s2` brings the insertion axis to rest."""
        if self.faults.missed_stops:
            self.faults.missed_stops -= 1
            return
        left_mm = self._goals[0] - self._wanted[0]
        self._wanted = [self._measured[0], self._measured[1]]
        self._goals = list(self._wanted)
        self._brakes = bool(left_mm) and self.faults.braking_mm_s2 < math.inf
        if self._brakes:
            way_mm = self._speeds[0] ** 2 / (2 * self.faults.braking_mm_s2)
            self._goals[0] += math.copysign(way_mm, left_mm)


class RobotServer(Closing):
    """Serves a robot at a UDP socket of this machine, in real time; with `line`, at a pseudo-terminal instead.

    At a pseudo-terminal, the robot sends compact statuses. `run` serves in the calling thread until `stop` or `close`.
    As a context manager, the server uses its own thread.
    """

    def __init__(
        self, machine: RobotMachine, host: str = "127.0.0.1", port: int = 0, interval_s: float = 0.001, *,
        line: bool = False,
    ) -> None:  # fmt: skip
        self.machine = machine
        self._door = PtyDoor() if line else UdpDoor(host, port)
        machine.compact = line
        self.interval_s = interval_s
        self.worst_overrun_s: float = 0.0
        self.ticks: int = 0
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def address(self) -> str:
        """The address by which a client opens the robot."""
        return self._door.address

    @property
    def host(self) -> str:
        """Host of the UDP socket; empty for a pseudo-terminal."""
        return self._door.host

    @property
    def port(self) -> int:
        """Port of the UDP socket; 0 for a pseudo-terminal."""
        return self._door.port

    def run(self) -> None:
        """Call `machine.tick` at every interval and answer datagrams, until `stop` or `close`.

        A tick that begins more than one interval late is counted as an overrun, and the missed ticks are omitted.
        """
        due_s = time.monotonic()
        while not self._stopping.is_set():
            due_s += self.interval_s
            self._listen_until(due_s)
            late_s = time.monotonic() - due_s
            if late_s > self.interval_s:
                self.machine.overruns += 1
                self.worst_overrun_s = max(self.worst_overrun_s, late_s)
                due_s += late_s  # missed ticks are not executed later
            self.ticks += 1
            sent = self.machine.tick(time.monotonic_ns())
            if sent is not None:
                self._door.send(*sent)

    def _listen_until(self, due_s: float) -> None:
        # Datagrams that have arrived are received before the tick checks the watchdog, also after a pause of this
        # process. Their number is limited, so that a flood of datagrams cannot delay the check.
        overtime = _MOST_OVERTIME
        while overtime:
            left_s = max(due_s - time.monotonic(), 0.0)
            overtime -= left_s == 0
            # `select` instead of a timeout of the socket, which would be rounded up to whole milliseconds.
            if not select.select([self._door], [], [], left_s)[0]:
                return
            for datagram, sender in self._door.receive():
                answer = self.machine.receive(datagram, sender, time.monotonic_ns())
                if answer:
                    self._door.send(answer, sender)

    def stop(self) -> None:
        """Make `run` return after its present tick."""
        self._stopping.set()

    def close(self) -> None:
        """Stop serving, wait for the server's thread, and close the socket or pseudo-terminal."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
        self._door.close()

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self.run, daemon=True)
        self._thread.start()
        return self
