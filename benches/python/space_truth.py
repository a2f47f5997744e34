"""Compare predicted and realised success in space at random entries of four anatomies, as shipped.

python benches/python/space_truth.py --json benches/results/space_truth.json > benches/results/space_truth.md
python benches/python/space_truth.py --entries 3 --runs 200      # short test run

The anatomies are those of `needleplan new --anatomy KIND --seed 5` with the settings that they ship with. An entry is a
place anywhere in the voxel of a random entry point, with a direction tilted by up to 12 degrees from the line to the
target; neither is on the grid. It counts if it can succeed: predicted above 0.5 %, or one of 200 other executions does.
There are two predictions: by the table (`SpaceTable.lookup`), and the estimate that users are told
(`SpaceTable.estimate`). Two programs realise them: the rollout, which is compiled, and executions in NumPy with arcs,
voxels and random numbers of their own, which take only the action from the table. Every entry has seeds of its own:
with common ones, the errors of all entries would be one. The estimate has random numbers of its own.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import machine
import numpy as np

from needleplan.anatomy import PHANTOMS, Anatomy, SpaceScenario, write_phantom
from needleplan.planning import SpaceTable, plan_space

# Largest angle (rad) between the direction of an entry and the line to the target.
TILT_RAD = math.radians(12.0)
# Predicted success below which an entry is tried with pilot executions before it counts, and their number.
DOUBT, PILOT_RUNS = 0.005, 200
# Goals of the project: mean and largest absolute difference, and bias, in percentage points.
GOALS = (1.5, 5.0, 0.5)


@dataclass(frozen=True)
class TruthEntry:
    """An entry: pose, and success by the table, as estimated with 95 % interval, in the rollout and in NumPy."""

    anatomy: str
    pose: tuple[float, ...]
    table: float
    estimate: float
    interval: tuple[float, float]
    rollout: float
    numpy: float


def drawn(table: SpaceTable, random: np.random.Generator) -> tuple[float, ...]:
    """Return a random pose of entry."""
    scenario, spacing = table.scenario, table.scenario.grid.frame.spacing_mm
    while True:
        point = random.choice(scenario.grid.entry_points()) * spacing + spacing * (random.random(3) - 0.5)
        if scenario.codes(point) != 0:
            continue
        line = np.array(scenario.target_mm) - point
        line /= np.linalg.norm(line)
        aside = random.standard_normal(3)
        aside -= (aside @ line) * line
        tilt = TILT_RAD * math.sqrt(random.random())
        tangent = math.cos(tilt) * line + math.sin(tilt) * aside / np.linalg.norm(aside)
        if math.acos(tangent[0]) < scenario.cone_rad:
            return (*point.tolist(), *tangent.tolist())


def entries_of(kind: str, options: argparse.Namespace, seconds: list[float]) -> list[TruthEntry]:
    """Return entries of an anatomy that count, and add the durations of their estimates."""
    with tempfile.TemporaryDirectory() as folder:
        file = write_phantom(kind, folder, options.seed)
        if options.spacing is not None:
            text = file.read_text(encoding="utf-8")
            text = text.replace("spacing_mm = 2.0", f"spacing_mm = {options.spacing}")
            file.write_text(text, encoding="utf-8")
        table = plan_space(SpaceScenario.of(Anatomy.read(file)))
    random, found = np.random.default_rng(11), list[TruthEntry]()
    while len(found) < options.entries:
        pose = drawn(table, random)
        by_table = table.lookup(pose).success
        if by_table < DOUBT and not table.rollout(pose, runs=PILOT_RUNS, seed=3)["success"].any():
            continue
        began = time.perf_counter()
        estimate = table.estimate(pose)
        seconds.append(time.perf_counter() - began)
        rollout = float(table.rollout(pose, runs=options.runs, seed=1000 + len(found))["success"].mean())
        own = math.nan
        if options.numpy_runs:
            own = float(table.executions(pose, runs=options.numpy_runs, seed=2000 + len(found)).reached.mean())
        found.append(TruthEntry(kind, pose, by_table, estimate.value, estimate.interval or (0.0, 1.0), rollout, own))
    return found


def row(name: str, entries: list[TruthEntry], kind: str, runs: int, numpy_runs: int) -> str:
    """Return a line of the report on one kind of prediction, `table` or `estimate`."""
    predicted, rollout, own = (
        100 * np.array([getattr(each, key) for each in entries]) for key in (kind, "rollout", "numpy")
    )
    apart, beside = predicted - rollout, predicted - own
    chance = math.sqrt(2 / math.pi) * np.sqrt(rollout * (100 - rollout) / runs).mean()
    cells = [name, len(entries), f"{rollout.mean():.1f} %", f"{abs(apart).mean():.2f}", f"{chance:.2f}",
             f"{apart.mean():+.2f}", f"{abs(apart).max():.1f}", f"{apart.max():+.1f}"]  # fmt: skip
    if numpy_runs:
        cells += [f"{abs(beside).mean():.2f}", f"{beside.mean():+.2f}", f"{abs(beside).max():.1f}"]
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def held(entries: list[TruthEntry], runs: int) -> int:
    """Return how many intervals of estimates, widened by the scatter of the rollout, hold the share of the rollout."""
    found = 0
    for each in entries:
        half = math.hypot((each.interval[1] - each.interval[0]) / 2, 1.96 * math.sqrt(0.25 / runs))
        found += abs(each.estimate - each.rollout) <= half
    return found


def main() -> None:
    """Measure all anatomies and print two tables; with --json, write the entries."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--entries", type=int, default=20, help="entries of each anatomy (20)")
    parser.add_argument("--runs", type=int, default=10_000, help="executions of the rollout (10,000)")
    parser.add_argument("--numpy-runs", type=int, default=1000, help="executions in NumPy (1,000)")
    parser.add_argument("--seed", type=int, default=5, help="seed of the phantoms (5)")
    parser.add_argument("--spacing", type=float, metavar="MM", help="another spacing than the shipped one")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about, seconds = machine.description(), list[float]()
    every: list[TruthEntry] = []
    for kind in PHANTOMS:
        every += entries_of(kind, options, seconds)
    print("# Predicted beside realised success of entries in space\n")
    print(f"{about['processor']}, commit {about['commit']}, {about['date']}.")
    print(f"Phantoms with the seed {options.seed}; spacing {options.spacing or 'as shipped'}; {options.entries} random")
    print(f"entries of each, {options.runs:,} executions of the rollout, {options.numpy_runs:,} in NumPy.")
    print("Differences: predicted less realised, in percentage points. Chance: the mean of an exact prediction.")
    numpy_columns = ["NumPy: mean", "bias", "largest"] if options.numpy_runs else []
    header = ["anatomy", "entries", "realised", "mean", "chance", "bias", "largest", "most too high", *numpy_columns]
    for name, kind in (("As users are told: estimated", "estimate"), ("By the table", "table")):
        print(f"\n{name}:\n\n| " + " | ".join(header) + " |\n|---|" + "--:|" * (len(header) - 1))
        for anatomy in PHANTOMS:
            of_anatomy = [each for each in every if each.anatomy == anatomy]
            print(row(anatomy, of_anatomy, kind, options.runs, options.numpy_runs))
        print(row("all", every, kind, options.runs, options.numpy_runs))
        apart = np.array([100 * (getattr(each, kind) - each.rollout) for each in every])
        reached = (abs(apart).mean(), abs(apart).max(), abs(apart.mean()))
        names = ("mean", "largest", "|bias|")
        verdicts = [
            f"{name} {value:.2f} (at most {goal:g}: {'reached' if value <= goal else 'not reached'})"
            for name, value, goal in zip(names, reached, GOALS, strict=True)
        ]
        print("\nGoals, in points: " + "; ".join(verdicts) + ".")
    widths, times_ms = [50 * (each.interval[1] - each.interval[0]) for each in every], 1000 * np.array(seconds)
    print(
        f"\nAn estimate took {np.median(times_ms):.0f} ms in the median, {times_ms.max():.0f} at most, "
        f"on {about['threads']} threads. Half of its interval is {np.median(widths):.2f} points in the median, "
        f"{max(widths):.2f} at most. {held(every, options.runs)} of {len(every)} intervals hold."
    )
    if options.json:
        record = {"machine": about, "seed": options.seed, "spacing_mm": options.spacing, "runs": options.runs,
                  "numpy_runs": options.numpy_runs, "entries": [asdict(each) for each in every]}  # fmt: skip
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
