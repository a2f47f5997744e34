"""Measure the time from a fault to the arrival of the stop command at the robot, for every fault, on real sockets.

python benches/python/fault_to_stop.py --json benches/results/fault_to_stop.json > benches/results/fault_to_stop.md
python benches/python/fault_to_stop.py --runs 1       # short test run

The devices run in a process of their own and send their protocols over UDP, TCP and HTTP on the loopback. The loop
reads the devices in threads and commands the robot through the guard, as `needleplan insert` does. The measured time
ends when the stop datagram arrives at the robot, or when the robot stops by itself if that is earlier.
"""

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

# Goal for the worst reaction (ms).
GOAL_MS = 50.0
# Period of the loop (s), and time after a fault in which a stop is expected (s).
TICK_S = 0.005
PATIENCE_S = 1.5
LIMITS = SafetyLimits()
AGES = {
    Cause.FORCE_STALE: ("ForceSample", LIMITS.force_age_s), Cause.FORCE_SUSPECT: ("ForceSample", LIMITS.force_age_s),
    Cause.POSE_STALE: ("PoseSample", LIMITS.pose_age_s), Cause.POSE_SUSPECT: ("PoseSample", LIMITS.pose_age_s),
    Cause.POSE_UNSEEN: ("PoseSample", LIMITS.pose_age_s), Cause.STAGE_STALE: ("StageSample", LIMITS.stage_age_s),
    Cause.LOOP_LATE: ("tick", LIMITS.loop_age_s),
}  # fmt: skip
"""By cause: the input whose age limit must pass before the guard detects the cause, and this limit (s)."""

VELOCITY_MM_S = 5.0
NEEDS_MS = {
    "18 tracker: damage without end": 1e3 * LIMITS.pose_age_s,  # or ten damaged replies, if they arrive earlier
    "30 robot: axis stuck": 1e3 * 0.2 / VELOCITY_MM_S,  # the robot's own following-error limit of 0.2 mm
    "33 loop: hangs": 30.0,  # the robot's own watchdog
    "33 loop: process stopped for 200 ms": 30.0,
}
"""Unavoidable waiting time (ms) of faults that are not detected by the age of an input."""

PAUSED_MS = 10.0
"""Delay of the otherwise idle robot process above which the whole machine is taken to have paused."""


EXPLAINED = (
    "Stop: time until the stop arrives at the robot, or until the robot stops by itself if that is earlier. Waited",
    "for: the part of it until the age limit of an input has passed, from its last usable sample; 0 if the fault is",
    "detected without an age limit, at the latest with the next sample. Reaction: the rest. Calm: without the runs in",
    f"which the process of the robot itself was late by more than {PAUSED_MS:g} ms, because the machine paused.",
)


@dataclass
class Run:
    """Times of one run in ms from the fault; NaN for an event that did not happen."""

    fault: str
    state: str
    cause: str
    stop_ms: float
    """Time until the stop of the guard arrived at the robot."""

    stood_ms: float
    """Time until the robot was at rest, because of the guard's stop or of its own watchdog."""

    waited_ms: float
    """Unavoidable part of that time, until the age limit of an input had passed; 0 if no limit applies."""

    paused_ms: float
    """Longest pause of the machine during the run."""

    @property
    def end_ms(self) -> float:
        """Time until the guard's stop arrived or the robot was at rest, whichever is earlier."""
        return min(self.stop_ms, self.stood_ms) if math.isfinite(self.stop_ms) else self.stood_ms

    @property
    def reaction_ms(self) -> float:
        """Time to the stop without the unavoidable waiting time."""
        return self.end_ms - min(self.waited_ms, self.end_ms)


class Loop:
    """A minimal control loop with the recorder, guard, reading threads and watchdog of a real run."""

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
        """Append an event of the guard to `events` and write it to the recording."""
        self.events.append(event)
        self.channel.put(event.time_ns, event.entry())

    def turns(self, seconds: float) -> None:
        """Run the loop for `seconds`, or until a stop was sent."""
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
        """Do the periodic work of the loop (every 5 ms), with the faults of the loop that were injected."""
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
        """The first stop that has a cause; None before it."""
        return next((each for each in self.events if each.name is SafetyEventName.STOP and each.causes), None)

    def begin(self) -> bool:
        """Home, enable and start an insertion. Return False if that fails or a stop occurs within the first moments."""
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
        """Inject a fault of the loop's process and return its time (ns)."""
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
    """Inject one fault and return the run; None if the insertion did not start or a device raised DeviceFault."""
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
    """Run all faults and print a report; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20, help="runs of each fault")
    parser.add_argument("--only", default="", help="only faults whose names begin with this text")
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
    """Return the report in Markdown."""
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
