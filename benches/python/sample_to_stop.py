"""How long a program takes from a sample of the robot to its STOP, and how far apart its heartbeats are.

Used by `stop_latency.py --samples`. The robot is a process of its own, with a real-time priority if it may have one,
because it is the instrument: it notes when it sends the first status that requires a STOP, and when a STOP and
heartbeats arrive. The program runs the guard beside two busy Python threads, a thread that reads the robot, and a loop.
"""

from __future__ import annotations

import contextlib
import itertools
import multiprocessing
import os
import sys
import threading
import time
from multiprocessing.connection import Connection

from needleplan.control.safety import GuardedStage, Order, SafetyLimits, Watchdog
from needleplan.devices import ForceSample, PoseSample, Stamp, UdpLink, short_turns
from needleplan.devices.robot import RobotMachine, RobotServer, RobotStage, RobotTiming, SteadyDrive
from needleplan.devices.robot.messages import RobotKind
from needleplan.errors import DeviceFault

INSTRUMENT = 30  # priority of the robot
# Limits of ages (s) beside which only the sample stops the needle
AGES = dict.fromkeys(("force_age_s", "pose_age_s", "stage_age_s", "loop_age_s"), 10.0)


class PythonLink(UdpLink):
    """A link whose socket Python keeps: the way of the datagrams before the supervisor had threads."""


class NotingMachine(RobotMachine):
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


def serve(pipe: Connection) -> None:
    """Serve the robot: "begin" forgets the last try, "jump" lets an encoder jump and returns what was noted."""
    with contextlib.suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(INSTRUMENT))
    machine = NotingMachine()
    with RobotServer(machine) as server:
        pipe.send((server.host, server.port))
        while True:
            if pipe.recv() == "begin":
                machine.fault_s = machine.stop_s = 0.0
                machine.beats_s.clear()
                continue
            beats_s = list(machine.beats_s)
            machine.drive.faults.jump_mm = 0.5  # type: ignore[attr-defined]
            end_s = time.monotonic() + 5.0
            while not machine.stop_s and time.monotonic() < end_s:
                time.sleep(0.005)
            gaps = [after - before for before, after in itertools.pairwise(beats_s)]
            pipe.send((machine.stop_s - machine.fault_s if machine.stop_s else None, gaps))


def spin() -> None:
    """Hold the interpreter for as long as it is given."""
    while True:
        sum(range(1000))


class Program:
    """A guarded robot with a loop of 5 ms, and a thread that reads the robot."""

    def __init__(self, link: UdpLink) -> None:
        self.stage = RobotStage(link, timing=RobotTiming(silence_s=1.0, valid_s=1.0, lost_s=10.0, answer_s=10.0))
        self.guard = GuardedStage(self.stage, SafetyLimits(**AGES), accepted_limits="a bench")
        self.ending = threading.Event()
        self.number = 0
        for work in (self._read, self._loop):
            threading.Thread(target=work, daemon=True).start()

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
            self.guard.observe(ForceSample(stamp, (0, 0, 1), (0, 0, 0)))
            place = (0.0, 0.0, 0.01 * (self.number % 2))
            self.guard.observe(PoseSample(stamp, place, (1, 0, 0, 0), 0.1), tip_mm=(0, 0), out_of_plane_mm=0)
            self.guard.tick()
            time.sleep(0.005)

    def begin(self) -> None:
        """Enable the guard, as a person does after a fault, and insert."""
        while True:
            with contextlib.suppress(DeviceFault):
                self.stage.start()
                time.sleep(0.15)
                for order in (Order.HOME, Order.RESET, Order.ENABLE):
                    self.guard.order(order, "a person")
                while self.guard.state.waits:
                    time.sleep(0.005)
                self.guard.insert(self.stage.last_status.depth_mm + 40.0, 5.0)  # type: ignore[union-attr]
                return
            time.sleep(0.05)


def measured(way: type[UdpLink], tries: int) -> tuple[list[float], list[float], int]:
    """Return times from sample to STOP (s), gaps between heartbeats (s), and the number of tries without a STOP."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    serving = context.Process(target=serve, args=(there,), daemon=True)
    serving.start()
    program = Program(way(*here.recv()))
    times: list[float] = []
    gaps: list[float] = []
    missing = 0
    with short_turns(), Watchdog(program.guard):
        for _ in range(2):
            threading.Thread(target=spin, daemon=True).start()
        for _ in range(tries):
            program.begin()
            here.send("begin")
            time.sleep(0.25)
            here.send("jump")
            took_s, between = here.recv()
            gaps += between
            if took_s is None:
                missing += 1
            else:
                times.append(took_s)
        program.ending.set()
    serving.terminate()
    return times, gaps, missing


def percentiles(seconds: list[float]) -> list[float]:
    """Return median, 99 %, 99.9 % and the largest of times, in ms."""
    ordered = sorted(seconds) or [float("nan")]
    return [1e3 * ordered[min(int(share * len(ordered)), len(ordered) - 1)] for share in (0.5, 0.99, 0.999, 1.0)]


def main(way: str, tries: int) -> None:
    """Measure one way in this process, and print its two lines of the table."""
    times, gaps, missing = measured(PythonLink if way == "Python" else UdpLink, tries)
    priority = "FIFO" if os.sched_getscheduler(0) == os.SCHED_FIFO else "usual"
    for what, seconds in (("sample to STOP", times), ("heartbeat gap", gaps)):
        cells = " | ".join(f"{each:.2f}" for each in percentiles(seconds))
        print(f"| {what} | {way} | {priority} | {len(seconds)} | {cells} | {missing} |", flush=True)
    os._exit(0)  # the busy threads do not end


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
