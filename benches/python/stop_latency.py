"""Measure how long `needleplan stop` takes until a robot stops, while other programs use all processors.

python benches/python/stop_latency.py --json benches/results/stop_latency.json > benches/results/stop_latency.md
python benches/python/stop_latency.py --tries 2 --busy 2              # short test run

A robot (the shipped machine behind a real UDP socket, in a process of its own) moves. Busy processes compete with it
and with the command. Each try starts the program as a person does and takes the times from this start: until the
robot's drives were stopped (on the monotonic clock of this machine, which both processes read), and until the program
has measured the needle at rest and ended. `--sources` measures another checkout in the same tries, one after the other.

`--calls N` measures something else: how long a program that controls the robot takes from the call of a stop to its
first STOP datagram, beside one busy Python thread, a thread that reads the robot, and the watchdog of the guard. The
socket belongs to Python there, as the time is taken in its link.

`--samples S` measures the way from a sample of the robot to the STOP, and the gaps between heartbeats, for S seconds,
beside two busy Python threads and `--busy` processes: with the socket in Python, and with the supervisor's threads.
"""

import argparse
import contextlib
import json
import multiprocessing
import os
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path

import machine

from needleplan.control.safety import GuardedStage, SafetyLimits, Watchdog
from needleplan.devices import UdpLink, short_turns
from needleplan.devices.robot import RobotMachine, RobotServer, RobotStage, SteadyDrive
from needleplan.devices.robot.messages import RobotKind
from needleplan.errors import DeviceFault


class NotingDrive(SteadyDrive):
    """Axes that note when they are stopped."""

    def __init__(self, stops: list[float]) -> None:
        super().__init__(deepest_mm=1e9)
        self._stops = stops

    def stop(self) -> None:
        """Stop both axes and note the time."""
        super().stop()
        self._stops.append(time.monotonic())


def robot(pipe: Connection) -> None:
    """Serve a robot; on each message move again, and return the time of the first stop since the last message."""
    stops: list[float] = []
    drive = NotingDrive(stops)
    with RobotServer(RobotMachine(drive)) as server:
        pipe.send(server.address)
        while pipe.recv():
            pipe.send(stops[0] if stops else None)
            stops.clear()
            server.machine._stop.end()  # as a motion command of a controller ends the repetition of the last stop
            drive.insert(1e8, 5.0)


def spin() -> None:
    """Use a processor."""
    while True:
        pass


def attempt(address: str, sources: Path, pipe: Connection) -> dict[str, object]:
    """Run the program once and return its exit code and the times (s) from its start."""
    pipe.send(True)
    pipe.recv()
    began_s = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "needleplan", "stop", "--robot", address], capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(sources)},
    )  # fmt: skip
    ended_s = time.monotonic()
    pipe.send(True)
    stopped_s = pipe.recv()
    return {
        "exit_code": done.returncode,
        "stopped_s": None if stopped_s is None else stopped_s - began_s,
        "ended_s": ended_s - began_s,
        "said": done.stderr.strip(),
    }


class NotingLink(UdpLink):
    """Notes when the first STOP after `sent_s = None` is given to the operating system.

    The time is taken before the call, because this thread has to wait for the interpreter after it.
    """

    sent_s: float | None = None

    def send(self, data: bytes) -> None:
        """Send a datagram."""
        if self.sent_s is None and data[5] == RobotKind.STOP:
            self.sent_s = time.monotonic()
        super().send(data)


def delays_s(link: NotingLink, call: Callable[[], None], count: int) -> list[float]:
    """Return the times (s) from calls of a stop to the first STOP datagram, ascending."""
    found = []
    for _ in range(count):
        time.sleep(0.005)
        link.sent_s = None
        began_s = time.monotonic()
        with contextlib.suppress(DeviceFault):
            call()
        assert link.sent_s is not None
        found.append(link.sent_s - began_s)
    return sorted(found)


def measure_calls(count: int) -> None:
    """Print the table of the calls."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    serving = context.Process(target=robot, args=(there,), daemon=True)
    serving.start()
    host, port = here.recv().removeprefix("udp://").split(":")
    link = NotingLink(host, int(port))
    ending = threading.Event()
    limits = SafetyLimits(stage_age_s=10.0, loop_age_s=10.0)
    print("| call | calls | turns of the interpreter, ms | median, ms | 99 % | 99.9 % | worst |")
    print("|---|--:|--:|--:|--:|--:|--:|")
    with RobotStage(link) as stage, GuardedStage(stage, limits, accepted_limits="a bench") as guard, Watchdog(guard):

        def read() -> None:
            while not ending.is_set():
                with contextlib.suppress(DeviceFault):
                    guard.read(0.1)

        threads = [threading.Thread(target=read, daemon=True), threading.Thread(target=spin, daemon=True)]
        for each in threads:
            each.start()
        calls = {"`RobotStage.stop()`": stage.stop, "`GuardedStage.stop()`": guard.stop}
        for turns in (contextlib.nullcontext, short_turns):
            with turns():
                for name, call in calls.items():
                    ms = [1e3 * each for each in delays_s(link, call, count)]
                    shown = [ms[min(int(share * count), count - 1)] for share in (0.5, 0.99, 0.999, 1.0)]
                    cells = " | ".join(f"{each:.2f}" for each in shown)
                    print(f"| {name} | {count} | {1e3 * sys.getswitchinterval():g} | {cells} |", flush=True)
        ending.set()
        threads[0].join()
    here.send(False)


def measure_samples(seconds: float, busy: int) -> None:
    """Print the table of the samples, with a real-time priority of the program, where permitted, and without."""
    context = multiprocessing.get_context("spawn")
    print("| what | way | priority | number | median, ms | 99.9 % | worst | tries without STOP |")
    print("|---|---|---|--:|--:|--:|--:|--:|")
    loads = [context.Process(target=spin, daemon=True) for _ in range(busy)]
    for each in loads:
        each.start()
    script = str(Path(__file__).with_name("sample_to_stop.py"))
    for prefix in ([], ["chrt", "-f", "20"]):
        for way in ("Python", "supervisor"):
            subprocess.run([*prefix, sys.executable, script, way, str(seconds)], check=False)
    for each in loads:
        each.kill()


def row(name: str, tries: list[dict[str, object]]) -> str:
    """Return the row of a table about the tries of one checkout."""
    stopped = sorted(float(str(each["stopped_s"])) for each in tries if each["stopped_s"] is not None)
    ended = [float(str(each["ended_s"])) for each in tries]
    confirmed = sum(each["exit_code"] == 0 for each in tries)
    middle, worst = (f"{1e3 * each:.0f}" for each in (statistics.median(stopped), stopped[-1])) if stopped else "--"
    return (
        f"| {name} | {len(tries)} | {len(stopped)} | {confirmed} | {middle} | {worst} | "
        f"{1e3 * statistics.median(ended):.0f} | {1e3 * max(ended):.0f} |"
    )


def main() -> None:
    """Run the tries and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tries", type=int, default=20)
    parser.add_argument("--busy", type=int, default=8)
    parser.add_argument("--sources", type=Path, action="append", help="the folder `python` of another checkout")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--calls", type=int, default=0, metavar="N", help="measure N calls in a program instead")
    parser.add_argument("--samples", type=float, default=0.0, metavar="S", help="measure samples to their STOP instead")
    options = parser.parse_args()
    if options.samples:
        measure_samples(options.samples, options.busy)
        return
    if options.calls:
        measure_calls(options.calls)
        return
    found: dict[str, list[dict[str, object]]] = {}
    about = machine.description()
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    serving = context.Process(target=robot, args=(there,), daemon=True)
    serving.start()
    address = here.recv()
    checkouts = [machine.ROOT / "python", *(each.resolve() for each in options.sources or [])]
    for busy in (0, options.busy):
        loads = [context.Process(target=spin, daemon=True) for _ in range(busy)]
        for each in loads:
            each.start()
        time.sleep(2.0 if busy else 0.0)
        for _ in range(options.tries):
            for number, sources in enumerate(checkouts):
                name = f"{'as it was' if number else 'now'}, {busy} busy processes"
                found.setdefault(name, []).append(attempt(address, sources, here))
        for each in loads:
            each.kill()
            each.join()
    here.send(False)
    print("| program | tries | stopped | confirmed | until stopped, median, ms | worst | until ended, median | worst |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|")
    for name, tries in found.items():
        print(row(name, tries))
    if options.json:
        options.json.write_text(json.dumps({"about": about, "tries": found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
