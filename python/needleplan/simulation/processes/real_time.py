"""A lab in real time: three processes that speak the bytes of a robot, a force sensor and a tracker.

The plant is in the process of the robot, and tells the other two what they measure. None of them waits for another: one
that is killed or stopped leaves the others as they are.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import signal
import time
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

from needleplan.devices import Closing
from needleplan.devices.processes import (
    Failed,
    LabAddresses,
    LabPlaces,
    Ready,
    Served,
    feed_pair,
    serve_force,
    serve_tracker,
)
from needleplan.devices.robot import RobotLimits
from needleplan.errors import InputError, Mistake
from needleplan.simulation.processes.robot import serve_robot
from needleplan.simulation.setup import Setup

__all__ = ["RealTimeLab"]

_START_S = 60.0
_END_S = 3.0


class RealTimeLab(Closing):
    """A lab as processes; a context manager. `addresses` is where its devices are.

    Raises InputError where a device cannot be at its place.
    """

    def __init__(
        self, setup: Setup, seed: int = 0, places: LabPlaces | None = None, limits: RobotLimits | None = None
    ) -> None:
        places = LabPlaces() if places is None else places
        self.served: dict[str, Served] = {}
        """What the processes told at their end."""

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
            self._start("robot", serve_robot, setup, seed, places, limits, to_force, to_tracker)
            robot = self._address("robot", places)
        except BaseException:
            for process, _ in self._parts.values():
                process.kill()  # some have not even begun to listen
            self.close()
            raise
        finally:
            for end in ends:
                end.close()
        self.addresses = LabAddresses(robot, force, tracker)

    @property
    def pids(self) -> dict[str, int]:
        """The processes, by what they are."""
        return {name: process.pid or 0 for name, (process, _) in self._parts.items()}

    def newly_ended(self) -> dict[str, str]:
        """Return the processes that have ended since the last call, and how."""
        found = {}
        for name, (process, _) in self._parts.items():
            code = process.exitcode
            if code is not None and name not in self._dead:
                self._dead.add(name)
                found[name] = f"exit code {code}" if code >= 0 else signal.Signals(-code).name
        return found

    @property
    def alive(self) -> bool:
        """Whether there is a process left."""
        return any(process.is_alive() for process, _ in self._parts.values())

    def close(self) -> None:
        """End all processes; what does not end by itself within 3 s is killed."""
        if self._closed:
            return
        self._closed = True
        for process, boss in self._parts.values():
            if process.is_alive():
                _tell_to_end(boss)
        end_s = time.monotonic() + _END_S
        for name, (process, boss) in self._parts.items():
            words = _last_words(boss, max(end_s - time.monotonic(), 0.0))
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


def _tell_to_end(boss: Connection) -> None:
    with contextlib.suppress(OSError):
        boss.send(None)


def _last_words(boss: Connection, timeout_s: float) -> Served | None:
    with contextlib.suppress(EOFError, OSError):
        while boss.poll(timeout_s):
            said = boss.recv()
            if isinstance(said, Served):
                return said
    return None
