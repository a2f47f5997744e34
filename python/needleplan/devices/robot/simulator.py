"""A capture side that is not there: axes that can be told to misbehave, without physics, and a robot on a socket."""

from __future__ import annotations

import contextlib
import math
import select
import socket
import threading
import time
from dataclasses import dataclass
from types import TracebackType
from typing import Self

from needleplan.devices.robot.drive import Drive, DriveState
from needleplan.devices.robot.machine import Peer, RobotMachine
from needleplan.devices.robot.messages import Fault
from needleplan.errors import DeviceFault

__all__ = ["DriveFaults", "RobotServer", "SteadyDrive"]

_MOST_OVERTIME = 256
"""So many datagrams are heard when a tick is due already."""


@dataclass
class DriveFaults:
    """What goes wrong from now on."""

    reported: Fault = Fault(0)
    """What the drives report: DRIVE, LIMIT, ESTOP. The emergency stop takes the power away as long as it is pressed."""

    stuck: bool = False
    slow: float = 1.0
    """The axes go only this share of their way."""

    reversed: bool = False
    """The encoders count the wrong way."""

    jump_mm: float = 0.0
    """The encoder of the insertion jumps by this much, once."""


class SteadyDrive(Drive):
    """Two axes that go at the speed they are told, from one moment to the next."""

    def __init__(self, deepest_mm: float = 180.0, fastest_mm_s: float = 50.0, fastest_rad_s: float = 12.0) -> None:
        self.faults = DriveFaults()
        self._deepest_mm, self._fastest = deepest_mm, (fastest_mm_s, fastest_rad_s)
        self._goals, self._speeds = [0.0, 0.0], [0.0, 0.0]
        self._wanted, self._measured = [0.0, 0.0], [0.0, 0.0]
        self._velocities = [0.0, 0.0]
        self._time_s: float | None = None

    def advance(self, time_s: float) -> DriveState:
        """Go on to a time, and say where the axes are."""
        passed_s = 0.0 if self._time_s is None else max(time_s - self._time_s, 0.0)
        self._time_s = time_s
        faults = self.faults
        if Fault.ESTOP in faults.reported:
            self.stop()
        share = 0.0 if faults.stuck else -faults.slow if faults.reversed else faults.slow
        for axis in range(2):
            left = self._goals[axis] - self._wanted[axis]
            step = math.copysign(min(abs(left), self._speeds[axis] * passed_s), left)
            self._wanted[axis] += step
            self._measured[axis] += share * step
            self._velocities[axis] = share * step / passed_s if passed_s else 0.0
        self._measured[0] += faults.jump_mm
        faults.jump_mm = 0.0
        depth_mm, roll_rad = self._measured
        return DriveState(
            depth_mm, self._velocities[0], roll_rad, self._velocities[1], self._wanted[0],
            self._wanted[1], self._wanted != self._goals, faults.reported,
        )  # fmt: skip

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin to move to a depth. Raises DeviceFault beyond the travel or the fastest speed."""
        if not (abs(depth_mm) <= self._deepest_mm and velocity_mm_s <= self._fastest[0]):
            raise DeviceFault(f"simulated drive: {depth_mm:g} mm at {velocity_mm_s:g} mm/s is beyond its limits")
        self._goals[0], self._speeds[0] = depth_mm, velocity_mm_s

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin to turn to a roll. Raises DeviceFault above the fastest speed."""
        if not velocity_rad_s <= self._fastest[1]:
            raise DeviceFault(f"simulated drive: {velocity_rad_s:g} rad/s is beyond its limits")
        self._goals[1], self._speeds[1] = roll_rad, velocity_rad_s

    def stop(self) -> None:
        """Stand still where the axes are."""
        self._wanted = [self._measured[0], self._measured[1]]
        self._goals = list(self._wanted)


class RobotServer:
    """A robot on a UDP socket of this machine, in real time; a context manager.

    `run` serves in the thread that calls it, until `close`; a context manager serves in a thread of its own.
    """

    def __init__(
        self, machine: RobotMachine, host: str = "127.0.0.1", port: int = 0, interval_s: float = 0.001
    ) -> None:
        self.machine = machine
        self.interval_s = interval_s
        self.worst_overrun_s = 0.0
        self.ticks = 0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self.host, self.port = self._socket.getsockname()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def address(self) -> str:
        """The address by which a client opens the robot."""
        return f"udp://{self.host}:{self.port}"

    def run(self) -> None:
        """Tick and answer until `close`; a tick that begins more than its interval late is an overrun."""
        due_s = time.monotonic()
        while not self._stopping.is_set():
            due_s += self.interval_s
            self._listen_until(due_s)
            late_s = time.monotonic() - due_s
            if late_s > self.interval_s:
                self.machine.overruns += 1
                self.worst_overrun_s = max(self.worst_overrun_s, late_s)
                due_s += late_s  # the time that is lost is not made up for
            self.ticks += 1
            sent = self.machine.tick(time.monotonic_ns())
            if sent is not None:
                self._send(*sent)

    def _listen_until(self, due_s: float) -> None:
        # What has come is heard before the watchdog looks, also where this process was stopped for a while; but who
        # sends without end does not keep the watchdog from looking.
        overtime = _MOST_OVERTIME
        while overtime:
            left_s = max(due_s - time.monotonic(), 0.0)
            overtime -= left_s == 0
            # A time-out of the socket would be rounded up to whole milliseconds.
            if not select.select([self._socket], [], [], left_s)[0]:
                return
            try:
                datagram, sender = self._socket.recvfrom(2048)
            except OSError:
                continue
            answer = self.machine.receive(datagram, sender, time.monotonic_ns())
            if answer:
                self._send(answer, sender)

    def _send(self, datagram: bytes, peer: Peer) -> None:
        with contextlib.suppress(OSError):
            self._socket.sendto(datagram, peer)

    def stop(self) -> None:
        """Let `run` return after its tick."""
        self._stopping.set()

    def close(self) -> None:
        """Switch it off."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
        self._socket.close()

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self.run, daemon=True)
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
