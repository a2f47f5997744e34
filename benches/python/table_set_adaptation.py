"""Measure how soon an insertion follows a table for the identified curvature: with a table set and without.

python benches/python/table_set_adaptation.py > benches/results/table_set_adaptation.md
python benches/python/table_set_adaptation.py --runs 1 --spacing 1      # short test run

The needle bends by 25 % more than planned. The insertion runs in real time against the processes of the lab twin, over
their bytes, at 5 mm/s. Counted from the request for a new plan: the time to the first table, and to the first decision
by it.
"""

import argparse
import statistics
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import machine

import needleplan as npl
from needleplan.devices.robot import RobotLimits
from needleplan.devices.sensor_processes import LabPlaces, TrackerLine
from needleplan.estimation.registration import Registration, RegistrationVerdict, VerdictStatus
from needleplan.recording import Recording
from needleplan.simulation import Effects, Setup, SimulatedEntry
from needleplan.simulation.lab_processes import RealTimeLab
from needleplan.sweep import Engine, Sweep, SweptParameter, make_table_set

# Radii of the table set (mm), which do not contain the true one.
_RADII = [26.0, 30.0, 34.0, 38.0, 46.0, 50.0]
_CURVATURE_ERROR = 0.25
KNOWN = RegistrationVerdict(VerdictStatus.ACCEPTED, accepted="lab twin: coil and frame are those of the simulation")


def insertion(folder: Path, table: npl.PolicyTable, seed: int, table_set: bool) -> tuple[float, float, str]:
    """Insert once; return the times (s) to the first table and to the first decision by it, and where it came from."""
    x, y, heading, _ = table.best_entry().pose
    curvature = 1 / table.scenario.needle.curvature_radius_mm
    effects = Effects(coil_offset_mm=2.0, tracker_noise_mm=0.05, force_noise_n=0.02, curvature_error=_CURVATURE_ERROR)
    setup = Setup(curvature, entry=SimulatedEntry(x, y, heading), effects=effects)
    run = folder / f"run-{seed}-{table_set}.mcap"
    with RealTimeLab(setup, seed, LabPlaces(tracker_line=TrackerLine.TCP), RobotLimits(longest_silence_s=10.0)) as lab:
        at = lab.addresses
        devices = ["--robot", f"{at.robot}?watchdog_s=5&valid_s=1", "--force-sensor", at.force, "--tracker", at.tracker]
        files = ["--registration", str(folder / "registration.toml"), "-o", str(run)]
        store = ["--table-set", str(folder / "store")] if table_set else []
        command = [sys.executable, "-m", "needleplan", "insert", str(folder / "table.h5"), *devices, *files, *store]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    recording = Recording.read(run)
    events = [(each.time_ns, each.values) for each in recording.messages(["/event"])]
    if not any(values["name"] == "table_swapped" for _, values in events):
        raise SystemExit(f"no table was swapped: {done.stderr}")
    asked = next(time for time, values in events if values["name"] == "replan_asked")
    swapped, values = next((time, values) for time, values in events if values["name"] == "table_swapped")
    decided = next(
        each.time_ns for each in recording.messages(["/decision"]) if each.values["number"] >= values["step"]
    )
    return (swapped - asked) * 1e-9, (decided - asked) * 1e-9, values["cause"]


def main() -> None:
    """Measure, and print the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--spacing", type=float, nargs="+", default=[1.0, 0.5])
    options = parser.parse_args()
    about = machine.description()
    print("# Time to the first adapted decision, with a table set and without\n")
    print(f"Commit {about['commit']}, {about['processor']}, load before {about['load_before']}.")
    print(f"Lab twin in real time, 5 mm/s, `four_obstacles`, needle {_CURVATURE_ERROR:.0%} more curved than planned,")
    print(f"{options.runs} seeds. Times from the request, median (largest). A decision follows every 4 mm: 0.8 s.\n")
    print("| states | table from | to the first new table | to the first decision by it |")
    print("|--:|---|--:|--:|")
    for spacing in options.spacing:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            scenario = npl.Scenario.read("four_obstacles")
            scenario = replace(scenario, grid=replace(scenario.grid, spacing_mm=(spacing, spacing)))
            scenario.write(folder / "scenario.toml")
            Registration(coil_offset_mm=2.0, verdict=KNOWN).write(folder / "registration.toml")
            table = npl.plan(scenario)
            table.write(folder / "table.h5")
            radius = SweptParameter("needle.curvature_radius_mm", values=_RADII)
            make_table_set(Sweep(str(folder / "scenario.toml"), [radius]), folder / "store", Engine(workers=0))
            for table_set in (False, True):
                found = [insertion(folder, table, seed, table_set) for seed in range(options.runs)]
                times = zip(*[run[:2] for run in found], strict=True)
                cells = [f"{statistics.median(each):.2f} s ({max(each):.2f})" for each in times]
                sources = ", ".join(sorted({run[2] for run in found}))
                print(f"| {scenario.states:,} | {sources} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
