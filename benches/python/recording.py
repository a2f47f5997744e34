"""Measure the cost of recording for the loop, the loss if the process is killed, and the growth of memory.

python benches/python/recording.py --json benches/results/recording.json > benches/results/recording.md
python benches/python/recording.py --seconds 20 --kills 3       # short test run
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import machine
import numpy as np

from needleplan.devices import ForceSample, PoseSample, StageSample, Stamp
from needleplan.recording import FORCE, POSE, STAGE, Recorder, Recording, Session, recover

PAGE_KB = os.sysconf("SC_PAGE_SIZE") / 1024
# Goal for the longest recording lost by a kill (ms).
LIMIT_MS = 50.0
# Ticks of 1 ms between two poses, and between two forces.
POSES_EVERY, FORCES_EVERY = 25, 5

KILLED = """
import os, sys, time
from needleplan.devices import StageSample, Stamp
from needleplan.recording import Recorder, STAGE
with Recorder(sys.argv[1]) as recorder:
    stage = recorder.channel("/stage", STAGE)
    number = 0
    while True:
        number += 1
        now_ns = time.monotonic_ns()
        stage.put(now_ns, StageSample(Stamp(now_ns, number), 1.0, 2.0, 3.0, True))
        os.write(1, b"%d %d\\n" % (number, now_ns))
        time.sleep(0.001)
"""


def main() -> int:
    """Run both measurements and print a report; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=600.0, help="of traffic")
    parser.add_argument("--speed", type=float, default=5.0, help="speed of the traffic relative to real time")
    parser.add_argument("--kills", type=int, default=40)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about = machine.description()
    with tempfile.TemporaryDirectory() as folder:
        found = traffic(Path(folder), options.seconds, options.speed)
        lost = [killed(Path(folder) / f"{number}.mcap", number) for number in range(options.kills)]
    print(
        "# Recording\n\n"
        f"Status at 1,000 Hz, force at 200 Hz, tracker at 40 Hz: {options.seconds:g} s of traffic at\n"
        f"{options.speed:g} times real time, from one thread.\n\n| | |\n|---|--:|"
    )
    for name, text in found["lines"].items():
        print(f"| {name} | {text} |")
    times = np.array([each["milliseconds"] for each in lost])
    verdict = "met" if times.max() <= LIMIT_MS else "missed"
    print(
        f"\nkill -9 at 1,000 Hz, {times.size} times: lost {np.median(times):.0f} ms in the median, "
        f"{times.max():.0f} ms at most (goal: {LIMIT_MS:g} ms: {verdict}); messages missing: "
        f"{sum(each['missing'] for each in lost)}."
    )
    if options.json:
        record = {"machine": about, "traffic": found, "kills": lost}
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


def traffic(folder: Path, seconds: float, speed: float) -> dict[str, dict[str, str] | list[float] | float]:
    """Record simulated traffic; return the lines of the report, the memory (MB) and the longest put (us)."""
    path = folder / "traffic.mcap"
    recorder = Recorder(path, Session("bench"))
    stage, force, tracker = (
        recorder.channel(topic, kind) for topic, kind in (("/stage", STAGE), ("/force", FORCE), ("/tracker", POSE))
    )
    ticks = round(1000 * seconds)
    costs, memory, behind = np.full(ticks, -1.0), [], 0.0
    began_ns, began_cpu = time.monotonic_ns(), time.process_time()
    due_ns, pauses = began_ns, list[float]()
    for tick in range(ticks):
        now_ns = began_ns + 1_000_000 * tick
        stamp = Stamp(now_ns, tick)
        sample = StageSample(stamp, 1e-3 * tick, 1.0, 0.1, True)
        before = time.perf_counter_ns()
        stage.put(now_ns, sample)
        costs[tick] = time.perf_counter_ns() - before
        if tick % FORCES_EVERY == 0:
            force.put(now_ns, ForceSample(stamp, (0.1, 0.2, 1e-3 * tick), (1.0, 2.0, 3.0)))
        if tick % POSES_EVERY == 0:
            tracker.put(now_ns, PoseSample(stamp, (1e-3 * tick, 0.1, 0.2), (1.0, 0.0, 0.0, 0.0), 0.1))
            behind = max(behind, recorder.status.behind_s)
        if tick % max(ticks // 10, 1) == 0:
            memory.append(resident_mb())
        wait = (due_ns + 1_000_000 * tick / speed - time.monotonic_ns()) * 1e-9
        if wait > 0.002:
            time.sleep(wait)
        elif wait < -0.1:  # the machine paused; a real robot would not send the missed samples later
            due_ns -= round(wait * 1e9)
            pauses.append(-wait)
    took_s, cpu_s = (time.monotonic_ns() - began_ns) * 1e-9, time.process_time() - began_cpu
    memory.append(resident_mb())
    partial_mb = recorder.partial.stat().st_size / 1e6
    closing = time.perf_counter()
    status = recorder.close(600)
    closing = time.perf_counter() - closing
    reading = time.perf_counter()
    recording = Recording.read(path)
    count = sum(1 for _ in recording.messages())
    reading = time.perf_counter() - reading
    costs /= 1e3
    lines = {
        "state at the end, messages lost": f"{status.state}, {sum(status.overflowed.values())}",
        "messages written, read back": f"{status.written:,}, {count:,}",
        "a put: median, 99th percentile, 99.9th, worst": ", ".join(
            f"{value:.1f}" for value in (*np.percentile(costs, (50, 99, 99.9)), costs.max())
        )
        + " µs",
        "the writer behind, at most": f"{1e3 * behind:.0f} ms",
        "traffic took": f"{took_s:.0f} s; CPU {cpu_s:.0f} s, traffic included",
        "pauses of this process over 0.1 s, that the machine made": f"{len(pauses)}, the longest "
        f"{max(pauses, default=0.0):.1f} s",
        "memory, after the first tenth and at the end": f"{memory[1]:.1f}, {memory[-1]:.1f} MB",
        "partial file, finished file": f"{partial_mb:.1f}, {path.stat().st_size / 1e6:.1f} MB",
        "closing": f"{closing:.1f} s",
        "reading back": f"{reading:.1f} s",
    }
    return {"lines": lines, "memory_mb": memory, "worst_put_us": float(costs.max())}


def killed(path: Path, seed: int) -> dict[str, float]:
    """Kill a process that records at 1,000 Hz at a random moment; return the lost time (ms) and messages."""
    with subprocess.Popen([sys.executable, "-c", KILLED, str(path)], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(int(np.random.default_rng(seed).integers(200, 600)))]
        os.kill(process.pid, signal.SIGKILL)
        lines += process.stdout.readlines()
    number, put_ns = max(tuple(map(int, line.split())) for line in lines if line.endswith(b"\n"))
    done = recover(path.with_name(path.name + ".partial"), path)
    recording = Recording.read(path)
    last = list(recording.messages(["/stage"]))[-1]
    return {
        "milliseconds": (put_ns - last.time_ns) * 1e-6,
        "messages": number - last.values["sequence"],
        "missing": sum(done.missing.values()),
    }


def resident_mb() -> float:
    """Return the memory of this process (MB)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE_KB / 1024


if __name__ == "__main__":
    sys.exit(main())
