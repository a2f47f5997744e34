"""Measure the time from a fault to the stop command on the wire, for every fault, on real sockets.

python benches/python/fault_to_stop.py --json benches/results/fault_to_stop.json > benches/results/fault_to_stop.md
python benches/python/fault_to_stop.py --runs 1       # to see that it runs

The devices are in a process of their own and speak their bytes over UDP, TCP and HTTP on the loopback. The loop reads
them in threads and goes through the guard, as `needleplan insert` does. A stop counts when its datagram has come to the
robot; where the robot stops by itself before, that is what is counted.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import multiprocessing
import queue
import statistics
import sys
import tempfile
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import machine
from fault_lab import FAULTS, OF_THE_LOOP, serve

from needleplan.control.safety import Cause, GuardedStage, Order, SafetyEvent, SafetyEventName, SafetyLimits, Watchdog
from needleplan.devices import ForceSample, Health, PoseSample, Stamp, Station, SystemClock, ThreadedFeed
from needleplan.devices.ati import NetFt
from needleplan.devices.ndi import NdiTracker
from needleplan.devices.robot import RobotStage
from needleplan.errors import DeviceFault, MotionRefused
from needleplan.recording import EVENT, Recorder
from needleplan.recording import _journal as journal

GOAL_MS = 50.0
TICK_S = 0.005
PATIENCE_S = 1.5
LIMITS = SafetyLimits()
AGES = {
    Cause.FORCE_STALE: ("ForceSample", LIMITS.force_age_s), Cause.FORCE_SUSPECT: ("ForceSample", LIMITS.force_age_s),
    Cause.POSE_STALE: ("PoseSample", LIMITS.pose_age_s), Cause.POSE_SUSPECT: ("PoseSample", LIMITS.pose_age_s),
    Cause.POSE_UNSEEN: ("PoseSample", LIMITS.pose_age_s), Cause.STAGE_STALE: ("StageSample", LIMITS.stage_age_s),
    Cause.LOOP_LATE: ("tick", LIMITS.loop_age_s),
}  # fmt: skip
"""Which input is waited for, and how long, until a cause is there."""

VELOCITY_MM_S = 5.0
NEEDS_MS = {
    "18 tracker: damage without end": 1e3 * LIMITS.pose_age_s,  # or ten damaged replies, which come before
    "30 robot: axis stuck": 1e3 * 0.2 / VELOCITY_MM_S,  # the robot's own limit of following, 0.2 mm
    "33 loop: hangs": 30.0,  # the robot's own watchdog
    "33 loop: process stopped for 200 ms": 30.0,
}
"""What has to be waited for where that is not the age of an input."""

PAUSED_MS = 10.0
"""Where the process of the robot, which has nothing else to do, was late by so much, the machine stood still."""


EXPLAINED = (
    "Stop: until the stop is at the robot, or the robot has stopped by itself, whichever is first. Waited for: of",
    "that, until the age limit of an input was over, counted from its last usable sample; where it is 0 the fault",
    "shows by itself, at the latest with the next sample. Reaction: the rest. Calm: without the runs in which the",
    f"process of the robot was late itself by more than {PAUSED_MS:g} ms, because the machine stood still.",
)


@dataclass
class Run:
    """One run, in ms from the fault; NaN for what did not happen."""

    fault: str
    state: str
    cause: str
    stop_ms: float
    """Until our stop came to the robot."""

    stood_ms: float
    """Until the robot no longer moved, by our stop or by its own watch."""

    waited_ms: float
    """Of that, until the age limit of the input was over; zero where there is none to wait for."""

    paused_ms: float
    """How long the machine stood still meanwhile, at most."""

    @property
    def end_ms(self) -> float:
        """Until the stop, whoever made it."""
        return min(self.stop_ms, self.stood_ms) if math.isfinite(self.stop_ms) else self.stood_ms

    @property
    def reaction_ms(self) -> float:
        """What is left once there was nothing to wait for any more."""
        return self.end_ms - min(self.waited_ms, self.end_ms)


class Loop:
    """The least loop that there can be, with everything that a run has around it."""

    def __init__(self, addresses: tuple[str, str, str], folder: Path) -> None:
        force, tracker, robot = addresses
        self.closing = contextlib.ExitStack()
        self.recorder = Recorder(folder / f"{time.monotonic_ns()}.mcap")
        self.closing.callback(self.recorder.close)
        self.channel = self.recorder.channel("/events", EVENT)
        self.events: list[SafetyEvent] = []
        self.sensor = self.closing.enter_context(NetFt.open(force))
        self.tracker = self.closing.enter_context(NdiTracker.open(tracker))
        self.guard = GuardedStage(RobotStage.open(robot), LIMITS, listener=self.heard)
        self.closing.callback(self.guard.close)
        self.feed = self.closing.enter_context(
            ThreadedFeed(Station(self.guard, self.sensor, self.tracker, SystemClock()))
        )
        self.closing.enter_context(Watchdog(self.guard))
        self.hang = threading.Event()
        self.future = self.seen_dead = False
        self.usable_ns: dict[str, int] = {}
        self.ticked_ns = 0

    def heard(self, event: SafetyEvent) -> None:
        """Keep an event, and record it."""
        self.events.append(event)
        self.channel.put(event.time_ns, event.entry())

    def turns(self, seconds: float) -> None:
        """Go on for a while, or until a stop was sent."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not self.stop:
            try:
                sample = self.feed.next(TICK_S)
            except DeviceFault as fault:
                if self.feed.failed is not None:
                    self.guard.device_failed(self.feed.failed, fault)
                continue
            if sample is not None and sample.health is Health.GOOD:
                self.usable_ns[type(sample).__name__] = sample.stamp.received_ns
            with contextlib.suppress(MotionRefused):
                if isinstance(sample, PoseSample):
                    self.guard.observe(sample, tip_mm=sample.position_mm[:2], out_of_plane_mm=0.0)
                elif isinstance(sample, ForceSample):
                    self.guard.observe(sample)
                if time.monotonic_ns() - self.ticked_ns >= TICK_S * 1e9:
                    self.turn()

    def turn(self) -> None:
        """Do what a loop does every 5 ms."""
        if self.hang.is_set():
            time.sleep(0.3)
        if self.future:
            stamp = Stamp(time.monotonic_ns() + 60 * 10**9, 1)
            self.guard.observe(ForceSample(stamp, (0, 0, 1), (0, 0, 0)))
        self.guard.observe_recording(self.recorder.status)
        self.ticked_ns = self.usable_ns["tick"] = time.monotonic_ns()
        self.guard.tick()

    @property
    def stop(self) -> SafetyEvent | None:
        """The first stop for a cause."""
        return next((each for each in self.events if each.name is SafetyEventName.STOP and each.causes), None)

    def begin(self) -> bool:
        """Enable as a person does, and insert; whether that lasted."""
        end = time.monotonic() + 3.0
        while self.guard.state.present or not self.ticked_ns:
            if time.monotonic() > end:
                return False
            self.turns(0.02)
        try:
            for order in (Order.HOME, Order.ENABLE):
                self.guard.order(order, "bench")
            self.guard.insert(150.0, VELOCITY_MM_S)
        except DeviceFault:
            return False
        self.turns(0.15 + 0.025 * (time.monotonic_ns() % 1000) / 1000)
        return self.stop is None

    def go_wrong(self, name: str) -> int:
        """Let something happen here, and return when."""
        now_ns = time.monotonic_ns()
        if name == "33 loop: hangs":
            self.hang.set()
        elif name == "34 clock: a sample from the future":
            self.future = True
        elif name == "35 recorder: its thread dies":
            dies: queue.SimpleQueue[int] = queue.SimpleQueue()
            write = journal.os.write

            def die(descriptor: int, data: Any) -> int:
                if threading.current_thread().name != "recorder":
                    return write(descriptor, data)
                dies.put(time.monotonic_ns())
                raise MemoryError

            journal.os.write = die
            self.closing.callback(lambda: setattr(journal.os, "write", write))
            self.channel.put(now_ns, {"name": "the last"})
            return dies.get(timeout=PATIENCE_S)
        else:
            threading.Thread(target=self.guard.stop).start()
        return now_ns


def measured(name: str, pipe: Any, folder: Path) -> Run | None:
    """Return one run; None where the machine disturbed it before anything went wrong."""
    pipe.send(("open", ""))
    loop = Loop(pipe.recv(), folder)
    try:
        with loop.closing:
            if not loop.begin():
                pipe.send(("close", ""))
                pipe.recv()
                return None
            last: list[int] = []

            def inject() -> None:
                pipe.send(("inject", name))
                last.append(pipe.recv())

            injecting = threading.Thread(target=inject)
            if name in OF_THE_LOOP:
                inject()
                fault_ns = loop.go_wrong(name)
            else:
                injecting.start()
                fault_ns = 0
            loop.turns(PATIENCE_S)
            if not fault_ns:
                injecting.join()
                fault_ns = last[0]
            time.sleep(0.05)
            pipe.send(("close", ""))
            times = pipe.recv()
            return judged(name, loop, fault_ns, *times)
    except DeviceFault:
        return None


def judged(name: str, loop: Loop, fault_ns: int, stop_ns: float, stood_ns: float, paused_ms: float) -> Run:
    stop = loop.stop
    first = next(
        (each for each in loop.events if each.name is SafetyEventName.TRANSITION and each.before == "ENABLED"), None
    )
    ages = [AGES[cause] for cause in (stop.causes if stop else ()) if cause in AGES]
    waits = [max((loop.usable_ns[what] - fault_ns) * 1e-6 + 1e3 * age_s, 0.0) for what, age_s in ages]
    return Run(
        name,
        str(first.state) if first else "ENABLED",
        ", ".join(sorted(first.causes)) if first else "",
        (stop_ns - fault_ns) * 1e-6,
        (stood_ns - fault_ns) * 1e-6,
        NEEDS_MS.get(name, min(waits, default=0.0)),
        paused_ms,
    )


def main() -> int:
    """Run everything, print a report, write JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20, help="of each fault")
    parser.add_argument("--only", default="", help="faults whose name begins so")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about = machine.description()
    here, there = multiprocessing.Pipe()
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=serve, args=(there,), daemon=True)
    process.start()
    runs: list[Run] = []
    disturbed = 0
    with tempfile.TemporaryDirectory() as folder:
        for name in FAULTS:
            if not name.startswith(options.only):
                continue
            done = 0
            for _ in range(3 * options.runs):
                run = measured(name, here, Path(folder))
                disturbed += run is None
                if run is not None:
                    runs.append(run)
                    done += 1
                    print(run, file=sys.stderr)
                if done == options.runs:
                    break
    here.close()
    print(report(runs, disturbed, about))
    if options.json:
        record = {"machine": about, "disturbed": disturbed, "runs": [asdict(each) for each in runs]}
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


def report(runs: list[Run], disturbed: int, about: dict[str, object]) -> str:
    """Return the tables in Markdown."""
    lines = [
        "# From a fault to the stop",
        "",
        f"Times in ms on {about['processor']}, {about['threads']} threads, load {about['load_before']} before the run, "
        f"priority {about['priority']}, commit {about['commit']}. {disturbed} runs did not come so far as the fault, "
        "because the machine paused.",
        "",
        "| fault | ends in | for | runs | stop, median | worst | worst, calm | waited for | reaction, worst, calm |",
        "|---|---|---|--:|--:|--:|--:|--:|--:|",
    ]
    for name in dict.fromkeys(each.fault for each in runs):
        its = [each for each in runs if each.fault == name]
        causes = " or ".join(sorted({each.cause for each in its}))
        states = ", ".join(sorted({each.state for each in its}))
        calm = [each for each in its if each.paused_ms < PAUSED_MS] or its
        ends = [each.end_ms for each in its]
        cells = (
            name, states, causes, len(its), statistics.median(ends), max(ends), max(each.end_ms for each in calm),
            max(min(each.waited_ms, each.end_ms) for each in its), max(each.reaction_ms for each in calm),
        )  # fmt: skip
        lines.append(
            "| " + " | ".join(f"{cell:.1f}" if isinstance(cell, float) else str(cell) for cell in cells) + " |"
        )
    calm = [each for each in runs if each.paused_ms < PAUSED_MS]
    worst = max((each.reaction_ms for each in calm), default=math.nan)
    lines += [
        "",
        *EXPLAINED,
        "",
        f"Runs: {len(runs)}, calm: {len(calm)}. Worst reaction in those: {worst:.1f} ms (goal: {GOAL_MS:g} ms).",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
