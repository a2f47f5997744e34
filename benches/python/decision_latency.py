"""Measure the time from a sample to the resulting command, and whether samples are lost in minutes of traffic.

python benches/python/decision_latency.py --json benches/results/latency.json > benches/results/latency.md
python benches/python/decision_latency.py --insertions 1 --traffic 5       # short test run

The lab twin runs in real time, in processes of its own, and sends the protocols of robot, force sensor and tracker over
the loopback. The control loop is that of `needleplan insert`, with guard, reading threads and recording. The traffic is
robot status at 1,000 Hz, forces at 200 Hz and poses at 40 Hz, in real time, read by the clients of the devices.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import machine
import numpy as np
from device_traffic import traffic, traffic_lines

from needleplan.control import (
    CommandKind,
    Insertion,
    Listener,
    Options,
    RunCommand,
    RunEvent,
    RunEventName,
    RunRecorder,
    RunSetup,
)
from needleplan.control.safety import SafetyLimits
from needleplan.devices import PoseSample, Sample, SystemClock, open_station
from needleplan.devices.robot import RobotLimits
from needleplan.devices.sensor_processes import LabPlaces, TrackerLine
from needleplan.estimation.tip import TipEstimate
from needleplan.planning import PolicyTable, plan
from needleplan.scenario import Scenario
from needleplan.simulation import Simulation, simulated_station
from needleplan.simulation.lab_processes import RealTimeLab

# Goals for the 99th percentile of the latency (ms), without and with replanning.
GOAL_MS, GOAL_REPLANNING_MS = 5.0, 40.0
PATIENT = SafetyLimits(
    insertion_velocity_mm_s=25.0, force_age_s=0.5, pose_age_s=0.5, stage_age_s=0.5, loop_age_s=0.5, motion_s=2.0,
    following_mm=2.0, recording_age_s=5.0, out_of_plane_mm=20.0,
)  # fmt: skip
"""Limits that a busy machine does not exceed: a stop by the guard would end the measurement."""

BUSY = "a stop on a busy machine would end the measurement"


class Timed(Listener):
    """Records the time from the arrival of a sample to the tip estimate and to the resulting command."""

    def __init__(self) -> None:
        self.last: Sample | None = None
        self.tips_ms: list[float] = []
        self.commands: list[tuple[float, bool, bool]] = []
        """By command: time since the last sample (ms), whether that sample is a pose, whether a plan was being made."""

        self.planning = False
        self.planned: list[str] = []

    def sample(self, sample: Sample) -> None:
        """Keep the sample that the loop is about to use."""
        self.last = sample

    def tip(self, time_ns: int, path_mm: float, tip: TipEstimate) -> None:  # noqa: ARG002
        """Record the time from the arrival of the tracker frame to the tip estimate."""
        self.tips_ms.append((time.monotonic_ns() - time_ns) * 1e-6)

    def command(self, command: RunCommand) -> None:
        """Record the time from the last sample to a command that was just sent; stops are not counted."""
        if command.kind is CommandKind.STOP or self.last is None:
            return
        since_ms = (time.monotonic_ns() - self.last.stamp.received_ns) * 1e-6
        self.commands.append((since_ms, isinstance(self.last, PoseSample), self.planning))

    def event(self, event: RunEvent) -> None:
        """Track whether a plan is being made, from the request until the loop takes or refuses the new table."""
        if event.name is RunEventName.REPLAN_ASKED:
            self.planning = True
        elif event.name in (RunEventName.TABLE_SWAPPED, RunEventName.REPLAN_REFUSED):
            self.planned.append(event.text)
            self.planning = False


def insertion(table: PolicyTable, simulation: Simulation, seed: int, folder: Path, *, replanning: bool) -> Timed | str:
    """Insert in real time. Return the measured times, or the reason if the tip did not reach the target."""
    options = Options(velocity_mm_s=20.0, velocity_rad_s=10.0, replan=replanning)
    if replanning:  # at every decision at which no plan is being made
        options = replace(options, replan_deviations=1e-6, replan_share=1e-6)
    with simulated_station(simulation, table, table.best_entry().pose, seed) as simulated:
        setup, registration = simulated.lab.plant.setup, simulated.registration.accepted("lab twin")
        options = replace(options, torsion=simulated.torsion)
    timed, places = Timed(), LabPlaces(tracker_line=TrackerLine.TCP)
    with ExitStack() as stack:
        lab = stack.enter_context(RealTimeLab(setup, seed, places, RobotLimits(longest_silence_s=5.0)))
        at = lab.addresses
        devices = stack.enter_context(open_station(f"{at.robot}?watchdog_s=3&valid_s=1", at.force, at.tracker))
        run = RunSetup(options, PATIENT, registration, accepted=BUSY)
        recorder = stack.enter_context(RunRecorder(folder / f"{time.monotonic_ns()}.mcap", table, run, SystemClock()))
        loop = Insertion(
            table, devices, options, registration=registration, limits=PATIENT, listeners=[recorder, timed],
            accepted_limits=BUSY,
        )  # fmt: skip
        report = stack.enter_context(loop).run()
    return timed if report.outcome == "target" else f"{report.outcome}: {report.cause}"


def latencies(insertions: int, scenario: str) -> dict[str, Any]:
    """Return percentiles of the times of many insertions, without replanning and with replanning at every decision."""
    table, simulation = plan(Scenario.read(scenario)), Simulation.read("steering")
    found: dict[str, Any] = {"scenario": scenario, "failed": []}
    with tempfile.TemporaryDirectory() as folder:
        for name, replanning in (("without", False), ("with", True)):
            tips: list[float] = []
            commands: list[tuple[float, bool, bool]] = []
            tables = 0
            for seed in range(insertions):
                timed = insertion(table, simulation, seed, Path(folder), replanning=replanning)
                if isinstance(timed, str):
                    found["failed"].append(f"{name}, seed {seed}: {timed}")
                    continue
                tips += timed.tips_ms
                commands += timed.commands
                tables += len(timed.planned)
            found[name] = {
                "tables": tables,
                "tip": percentiles(tips),
                "command after a frame of the tracker": percentiles([ms for ms, pose, _ in commands if pose]),
                "command after any sample": percentiles([ms for ms, _, _ in commands]),
                "command while a plan is made": percentiles([ms for ms, _, planning in commands if planning]),
            }
    return found


def percentiles(values_ms: list[float]) -> dict[str, float]:
    """Return number, median, 99th percentile and maximum of times (ms); only the number if there are none."""
    if not values_ms:
        return {"number": 0}
    middle, high = np.percentile(values_ms, [50, 99]).tolist()
    return {"number": len(values_ms), "p50_ms": middle, "p99_ms": high, "worst_ms": max(values_ms)}


def main() -> int:
    """Run both measurements and print the page; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--insertions", type=int, default=5, help="insertions without and as many with replanning (5)")
    parser.add_argument("--scenario", default="four_obstacles")
    parser.add_argument("--traffic", type=float, default=600.0, metavar="S", help="seconds of traffic (600)")
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    results: dict[str, Any] = {"machine": machine.description()}
    if options.insertions:
        results["latency"] = latencies(options.insertions, options.scenario)
    if options.traffic:
        results["traffic"] = traffic(options.traffic)
    results["load_after"] = os.getloadavg()[0]
    if options.json:
        Path(options.json).write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    print("\n".join(lines(results)))
    return 0


def lines(results: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of the Markdown page."""
    of = results["machine"]
    yield "# From a sample to the command, and minutes of traffic"
    yield ""
    yield f"{of['processor']}, {of['threads']} threads, commit {of['commit']}, {of['date']}; load before and after:"
    yield f"{of['load_before']}, {results['load_after']:.2f}; priority {of['priority']}."
    if "latency" in results:
        yield from _latency(results["latency"])
    if "traffic" in results:
        yield from traffic_lines(results["traffic"])


def _latency(found: dict[str, Any]) -> Iterator[str]:
    yield from ("", "## Latency", "")
    yield f"Scenario {found['scenario']}. Time from the arrival of a sample to the tip estimate, or until the resulting"
    yield "command is sent. With replanning: a new table is requested at every decision at which none is being made."
    yield f"Goals: 99 % below {GOAL_MS:g} ms without replanning, below {GOAL_REPLANNING_MS:g} ms with replanning."
    yield ""
    yield "| replanning | what | number | median ms | 99 % ms | worst ms |"
    yield "|---|---|--:|--:|--:|--:|"
    for name in ("without", "with"):
        for what, each in found[name].items():
            if isinstance(each, dict) and each["number"]:
                yield (
                    f"| {name} | {what} | {each['number']} | {each['p50_ms']:.2f} | {each['p99_ms']:.2f} | "
                    f"{each['worst_ms']:.2f} |"
                )
    yield ""
    yield f"{found['with']['tables']} tables were made and taken meanwhile."
    for failed in found["failed"]:
        yield f"Not counted: {failed}."


if __name__ == "__main__":
    sys.exit(main())
