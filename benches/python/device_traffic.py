"""Minutes of traffic of the three devices in real time: losses, ages, memory, handles, threads, and machine pauses."""

import multiprocessing
import resource
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from fault_lab import serve

from needleplan.control.safety import Cause, GuardedStage, SafetyEvent, SafetyEventName
from needleplan.devices import Closing, PoseSample, Station, SystemClock
from needleplan.devices.ati import NetFt
from needleplan.devices.ndi import NdiTracker
from needleplan.devices.robot import RobotStage
from needleplan.errors import DeviceFault, MotionRefused

PAUSE_S = 0.01  # oversleep of an idle thread above which the machine has paused
NEAR_S = 0.1  # time within which a pause explains a stale sample
STALE = (Cause.FORCE_STALE, Cause.POSE_STALE, Cause.STAGE_STALE, Cause.LOOP_LATE)


class PauseWatch(Closing):
    """A thread that only sleeps, and records by how much it was woken too late, as (time, s)."""

    def __init__(self) -> None:
        self.pauses: list[tuple[float, float]] = []
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        last = time.monotonic()
        while not self._closing.is_set():
            time.sleep(0.001)
            now = time.monotonic()
            if now - last - 0.001 > PAUSE_S:
                self.pauses.append((now, now - last - 0.001))
            last = now

    def close(self) -> None:
        """End the thread."""
        self._closing.set()
        self._thread.join()


def traffic(seconds: float) -> dict[str, Any]:
    """Read all samples through a guard for `seconds`, and return what was received, lost and found stale.

    The result contains numbers and rates of the samples, losses, gaps, the stale inputs that the guard reports, the
    pauses of the machine, and memory (MB), handles and threads of this process over time.
    """
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    child = context.Process(target=serve, args=(there,))
    child.start()
    here.send(("open", ""))
    force, tracker, robot = here.recv()
    counts, lost, gaps = Counter[str](), Counter[str](), Counter[str]()
    last: dict[str, int] = {}
    process: list[tuple[float, float, int, int]] = []
    stale: list[tuple[float, str]] = []
    begin = time.monotonic()
    interrupted: list[str] = []

    def heard(event: SafetyEvent) -> None:
        if event.name is SafetyEventName.RAISED:
            stale.extend((event.time_ns * 1e-9, str(each)) for each in event.causes if each in STALE)

    with PauseWatch() as watch:
        while time.monotonic() < begin + seconds:
            last.clear()
            try:
                with ExitStack() as stack:
                    sensor = stack.enter_context(NetFt.open(force))
                    eyes = stack.enter_context(NdiTracker.open(tracker))
                    guard = stack.enter_context(GuardedStage(RobotStage.open(robot), listener=heard))
                    feed = stack.enter_context(Station(guard, sensor, eyes, SystemClock()).feed(guard.read_device))
                    opened = time.monotonic()
                    while (now := time.monotonic()) < begin + seconds:
                        if now < opened + 1.0:
                            stale.clear() if not process else None  # inputs are stale until their first sample
                        elif not process or now - begin > process[-1][0] + max(seconds / 20, 1.0):
                            process.append((now - begin, *_process()))
                        guard.tick()
                        if (sample := feed.next(0.005)) is None:
                            continue
                        if isinstance(sample, PoseSample):
                            guard.observe_tip(sample.position_mm[:2], 0.0)
                        name, number = type(sample).__name__, sample.stamp.sequence
                        lost[name] += sample.stamp.lost
                        if name in last and name != "PoseSample":
                            gaps[name] += number - last[name] > 1 + sample.stamp.lost
                        counts[name] += 1
                        last[name] = number
            except (DeviceFault, MotionRefused) as fault:
                interrupted.append(f"after {time.monotonic() - begin:.0f} s: {fault}")
        process.append((time.monotonic() - begin, *_process()))
    here.send(("close", ""))
    here.recv()
    here.close()
    child.join()
    explained = [any(abs(at - paused) < NEAR_S + length for paused, length in watch.pauses) for at, _ in stale]
    return {"seconds": seconds, "samples": dict(counts), "rates_hz": {name: n / seconds for name, n in counts.items()},
            "lost": dict(lost), "unexplained_gaps": dict(gaps), "process": process, "interrupted": interrupted,
            "stale": dict(Counter(cause for _, cause in stale)), "stale_without_a_pause": explained.count(False),
            "pauses_ms": [1e3 * length for _, length in watch.pauses]}  # fmt: skip


def _process() -> tuple[float, int, int]:
    """Return resident memory (MB), open handles and threads of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    handles, threads = (sum(1 for _ in Path(f"/proc/self/{name}").iterdir()) for name in ("fd", "task"))
    return pages * resource.getpagesize() / 2**20, handles, threads


def traffic_lines(found: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of the report in Markdown."""
    yield from ("", "## Traffic", "", f"{found['seconds']:.0f} s in real time, servers in a process of their own.", "")
    yield "| samples | number | per second | lost | gaps that no sample tells of |"
    yield "|---|--:|--:|--:|--:|"
    for name, count in found["samples"].items():
        yield (
            f"| {name} | {count:,} | {found['rates_hz'][name]:.1f} | {found['lost'].get(name, 0)} | "
            f"{found['unexplained_gaps'].get(name, 0)} |"
        )
    pauses, stale = found["pauses_ms"], found["stale"]
    names = ", ".join(f"{number} {name}" for name, number in stale.items()) or "none"
    yield ""
    yield (
        f"The machine paused {len(pauses)} times for more than {1e3 * PAUSE_S:g} ms, at most for "
        f"{max(pauses, default=0.0):.0f} ms. The guard found inputs stale "
        f"{sum(stale.values())} times ({names}), "
        f"{found['stale_without_a_pause']} of them without a pause. Interrupted: {len(found['interrupted'])} times"
        + "".join(f"; {each}" for each in found["interrupted"]) + "."
    )  # fmt: skip
    yield ""
    yield "| after s | memory MB | handles | threads |"
    yield "|--:|--:|--:|--:|"
    for at, memory_mb, handles, threads in found["process"]:
        yield f"| {at:.0f} | {memory_mb:.1f} | {handles} | {threads} |"
