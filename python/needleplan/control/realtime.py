"""How promptly this machine stops a robot: from a sample of the robot to the STOP, and between two heartbeats.

The robot is a process of its own, with a real-time priority if it may have one, because it is the instrument: it notes
when it sends the first status that requires a STOP, and when a STOP and heartbeats arrive. The program runs the guard
beside two busy Python threads, a thread that reads the robot, and a loop.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import multiprocessing
import os
import platform
import threading
import time
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from needleplan.artifacts import CallRepr
from needleplan.control.safety import GuardedStage, OperatingState, Order, SafetyLimits, Watchdog
from needleplan.devices import Closing, ForceSample, PoseSample, Stamp, UdpLink, short_turns
from needleplan.devices.robot import (
    LINE_BAUD,
    RobotMachine,
    RobotServer,
    RobotStage,
    RobotTiming,
    RobotWay,
    SteadyDrive,
    open_way,
)
from needleplan.devices.robot.messages import RobotKind
from needleplan.errors import DeviceFault

__all__ = ["Promptness", "measure_promptness", "measured_file", "priority"]

# Priority of the robot, the instrument
_INSTRUMENT = 30
# Limits of ages (s) beside which only the sample stops the needle
_LIMITS = SafetyLimits(force_age_s=10.0, pose_age_s=10.0, stage_age_s=10.0, loop_age_s=10.0)
# Time (s) for which a try moves, before the sample that must stop it
_MOTION_S = 0.25
# Half of the time (s) after which a robot stops by itself without a heartbeat, 30 ms
_LONGEST_GAP_S = 0.015
# Longest time (s) from a sample to its STOP: a tenth of the 0.5 mm that `following_mm` permits, at 5 mm/s
_LONGEST_STOP_S = 0.01
# Time (s) of a compact status and a STOP on a serial line, which a pseudo-terminal does not take: two frames of 77
# bytes of 10 bits
_LINE_S = 2 * 77 * 10 / LINE_BAUD
_NEVER_S = 5.0  # time (s) after which a STOP counts as missing


@dataclass(frozen=True)
class Promptness(CallRepr):
    """Measured times (ms) of stops and of heartbeats: median, 99.9 % quantile, largest, and number."""

    host: str
    priority: str
    """`real-time` if the program ran with a FIFO priority, else `usual`."""

    seconds: float
    stop_ms: tuple[float, float, float]
    stops: int
    gap_ms: tuple[float, float, float]
    gaps: int
    missing: int
    """Number of tries that ended before their sample, because the machine paused, or without a STOP within 5 s."""

    line: bool = False
    """Whether the robot was behind a serial line (a pseudo-terminal) instead of UDP."""

    @property
    def limits(self) -> tuple[tuple[str, float, float, bool], ...]:
        """Each limit: its name, the largest measured time (ms), the limit (ms), and whether it holds."""
        checked = (
            ("heartbeat gap", self.gap_ms[2], 1e3 * _LONGEST_GAP_S),
            ("sample to STOP", self.stop_ms[2], 1e3 * (_LONGEST_STOP_S - _LINE_S * self.line)),
        )
        complete = self.stops > 0 and not self.missing
        return tuple((name, value, limit, complete and value <= limit) for name, value, limit in checked)

    @property
    def holds(self) -> bool:
        """Whether all limits hold."""
        return all(holds for *_, holds in self.limits)

    def write(self) -> None:
        """Write the measurement where `insert` looks for it. Raises OSError."""
        file = measured_file(self.priority, line=self.line)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(asdict(self), indent=1) + "\n", encoding="utf-8")

    @classmethod
    def read(cls, *, line: bool = False) -> Promptness | None:
        """Return the last measurement on this machine with the priority of this program; None without a usable one.

        `line` selects the measurement over a serial line.
        """
        try:
            stored = json.loads(measured_file(priority(), line=line).read_text(encoding="utf-8"))
            promptness = cls(**stored)
            promptness.limits  # noqa: B018 - numbers that are none raise
        except (OSError, ValueError, TypeError, IndexError):
            return None
        return promptness if promptness.host == platform.node() else None


def priority() -> str:
    """Return `real-time` if this program has a FIFO priority, else `usual`."""
    is_real_time = hasattr(os, "sched_getscheduler") and os.sched_getscheduler(0) in (os.SCHED_FIFO, os.SCHED_RR)
    return "real-time" if is_real_time else "usual"


def measured_file(priority: str, *, line: bool = False) -> Path:
    """Return the file of the last measurement with a priority, in the cache of the user (`XDG_CACHE_HOME`).

    `line` selects the measurement over a serial line.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "needleplan" / f"realtime-{priority}{'-serial' * line}.json"


class _NotingMachine(RobotMachine):
    """Notes times (s): the first status of a fault, the first STOP after it, and each heartbeat."""

    def __init__(self) -> None:
        super().__init__(SteadyDrive())
        self.fault_s = self.stop_s = 0.0
        self.beats_s: list[float] = []

    def receive(self, datagram: bytes, sender: tuple[str, int], now_ns: int) -> bytes:
        """Execute a datagram, and note its time."""
        if datagram[5] == RobotKind.ALIVE:
            self.beats_s.append(time.monotonic())
        if datagram[5] == RobotKind.STOP and self.fault_s and not self.stop_s:
            self.stop_s = time.monotonic()
        return super().receive(datagram, sender, now_ns)

    def tick(self, now_ns: int) -> tuple[bytes, tuple[str, int]] | None:
        """Advance the drives, and note the first fault."""
        sent = super().tick(now_ns)
        if self.faults and not self.fault_s:
            self.fault_s = time.monotonic()
        return sent


def _serve(pipe: Connection, line: bool) -> None:
    """Serve the robot: "begin" forgets the last try, "jump" lets an encoder jump and returns what was noted."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_INSTRUMENT))
    machine = _NotingMachine()
    with RobotServer(machine, line=line) as server:
        pipe.send(server.address)
        while True:
            if pipe.recv() == "begin":
                machine.fault_s = machine.stop_s = 0.0
                machine.beats_s.clear()
                continue
            beats_s = list(machine.beats_s)
            machine.drive.faults.jump_mm = 0.5  # type: ignore[attr-defined]
            end_s = time.monotonic() + _NEVER_S
            while not machine.stop_s and time.monotonic() < end_s:
                time.sleep(0.005)
            gaps = [after - before for before, after in itertools.pairwise(beats_s)]
            pipe.send((machine.stop_s - machine.fault_s if machine.stop_s else None, gaps))


def _spin(ending: threading.Event) -> None:
    """Hold the interpreter for as long as it is given."""
    while not ending.is_set():
        sum(range(1000))


class _Program(Closing):
    """A guarded robot with a loop of 5 ms, and a thread that reads the robot."""

    def __init__(self, link: UdpLink, way: RobotWay) -> None:
        timing = RobotTiming(silence_s=1.0, valid_s=1.0, lost_s=10.0, answer_s=10.0)
        self.stage = RobotStage(link, timing=timing, way=way)
        self.guard = GuardedStage(self.stage, _LIMITS, accepted_limits="a measurement")
        self.ending = threading.Event()
        self.number = 0
        self.threads = [threading.Thread(target=work, daemon=True) for work in (self._read, self._loop)]
        for thread in self.threads:
            thread.start()

    def close(self) -> None:
        """End the threads, and release the robot."""
        self.ending.set()
        for thread in self.threads:
            thread.join()
        self.guard.close()

    def _read(self) -> None:
        while not self.ending.is_set():
            try:
                self.guard.read(0.1)
            except DeviceFault:
                time.sleep(0.005)

    def _loop(self) -> None:
        while not self.ending.is_set():
            self.number += 1
            stamp = Stamp(time.monotonic_ns(), self.number)
            place = (0.0, 0.0, 0.01 * (self.number % 2))
            with contextlib.suppress(DeviceFault):  # a guard that another thread blocks has stopped the robot
                self.guard.observe(ForceSample(stamp, (0, 0, 1), (0, 0, 0)))
                self.guard.observe(PoseSample(stamp, place, (1, 0, 0, 0), 0.1), tip_mm=(0, 0), out_of_plane_mm=0)
                self.guard.tick()
            time.sleep(0.005)

    @property
    def is_moving(self) -> bool:
        """Whether the guard lets the needle move."""
        return self.guard.state.operating is OperatingState.ENABLED

    def begin(self) -> None:
        """Enable the guard, as a person does after a fault, and move; give up after 5 s."""
        end_s = time.monotonic() + _NEVER_S
        while time.monotonic() < end_s:
            with contextlib.suppress(DeviceFault):
                self.stage.start()
                time.sleep(0.15)
                for order in (Order.HOME, Order.RESET, Order.ENABLE):
                    self.guard.order(order, "a person")
                while self.guard.state.waits and time.monotonic() < end_s:
                    time.sleep(0.005)
                status = self.stage.last_status
                self.guard.insert(100.0 if status is None or status.depth_mm < 50.0 else 0.0, 5.0)
                return
            time.sleep(0.05)


def measure_promptness(seconds: float, link: type[UdpLink] = UdpLink, *, line: bool = False) -> Promptness:
    """Measure the times of stops and heartbeats on this machine for a time (s), at least one try.

    With `line`, the robot is behind a pseudo-terminal, a serial line without hardware. `link` is the link of the
    program; with a subclass of UdpLink, Python keeps the socket.
    """
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    serving = context.Process(target=_serve, args=(there, line), daemon=True)
    serving.start()
    times: list[float] = []
    gaps: list[float] = []
    missing, ending = 0, threading.Event()
    busy = [threading.Thread(target=_spin, args=(ending,), daemon=True) for _ in range(2)]
    try:
        way = open_way(here.recv())
        with _Program(link(way.host, way.port), way) as program, short_turns(), Watchdog(program.guard):
            for process in busy:
                process.start()
            end_s = time.monotonic() + seconds
            while True:
                program.begin()
                here.send("begin")
                time.sleep(_MOTION_S)
                if program.is_moving:
                    here.send("jump")
                    took_s, between = here.recv()
                    gaps += between
                    times += [] if took_s is None else [took_s]
                    missing += took_s is None
                else:
                    missing += 1
                if time.monotonic() >= end_s:
                    break
            ending.set()
    finally:
        ending.set()
        serving.terminate()
        serving.join()
    return Promptness(
        platform.node(), priority(), seconds, _shown_ms(times), len(times), _shown_ms(gaps), len(gaps), missing, line
    )


def _shown_ms(seconds: list[float]) -> tuple[float, float, float]:
    ordered = sorted(seconds) or [_NEVER_S]
    middle, most, last = (1e3 * ordered[min(int(part * len(ordered)), len(ordered) - 1)] for part in (0.5, 0.999, 1.0))
    return middle, most, last
