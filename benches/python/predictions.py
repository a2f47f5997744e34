"""Compare predicted and realised success at random poses of the shipped scenarios, with their shipped settings.

python benches/python/predictions.py --json benches/results/predictions.json > benches/results/predictions.md
python benches/python/predictions.py --poses 20 --runs 1000     # short test run

Two sets of poses a scenario: on the left edge with a heading within 90 degrees of the x axis, and anywhere with any
heading. Nothing lies on the grid. A pose counts if its success is in doubt or likely: predicted above 0.5 %, or one
of 200 other executions succeeds. All others are hopeless, where prediction and execution agree trivially.
"""

import argparse
import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import machine
import numpy as np
from shapely import Point

import needleplan as npl
from needleplan.scenario import Scenario

NAMES = (
    "four_obstacles", "narrow_passage", "prostate", "brain", "layered", "phantom", "four_obstacles_thesis",
)  # fmt: skip
HEADER = (
    "scenario", "poses", "realised", "mean abs.", "chance", "bias", "within 3", "worst", "in its interval", "states",
    "plan, s",
)  # fmt: skip
# Poses drawn at most for each pose that counts.
_DRAWN = 2000
# Predicted success below which a pose is tried with pilot runs before it counts.
_DOUBT = 0.005
_PILOT_RUNS = 200


@dataclass(frozen=True)
class Row:
    """One scenario and one set of poses; differences predicted minus realised in percentage points."""

    scenario: str
    where: str
    poses: int
    realised: float
    mean: float
    chance: float
    bias: float
    within_3: float
    worst: float
    worst_pose: tuple[float, float, float, int]
    inside: float
    states: int
    plan_s: float


def main() -> int:
    """Measure all scenarios and print a table; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="+", default=NAMES, metavar="NAME")
    parser.add_argument("--poses", type=int, default=200)
    parser.add_argument("--runs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about = machine.description()
    print(f"{options.poses} random poses a row, {options.runs:,} executions each.")
    print(f"{about['processor']}, {str(about['date'])[:10]}, commit {about['commit']}, Python {about['python']}.\n")
    print("Differences are predicted minus realised success in percentage points; chance is what the mean would be")
    print("with exact predictions.\n")
    print("| " + " | ".join(HEADER) + " |\n|---|---|" + "--:|" * (len(HEADER) - 2))
    rows = []
    for name in options.scenarios:
        table = npl.plan(name)
        for where in ("left edge", "anywhere"):
            row = _measured(table, Path(name).stem, where, options.poses, options.runs, options.seed)
            rows.append(row)
            print(
                f"| {row.scenario} | {row.where} | {row.realised:.1f} % | {row.mean:.2f} | {row.chance:.2f} "
                f"| {row.bias:+.2f} | {row.within_3:.1f} % | {row.worst:+.1f} | {row.inside:.1f} % | {row.states:,} "
                f"| {row.plan_s:.1f} |",
                flush=True,
            )
    if options.json:
        options.json.write_text(json.dumps({"machine": about, "rows": [asdict(row) for row in rows]}, indent=1) + "\n")
    return 0


def _measured(table: npl.PolicyTable, name: str, where: str, count: int, runs: int, seed: int) -> Row:
    random = np.random.default_rng(seed)
    poses = _poses(table, where, count, random)
    found = [table.rollout(pose, runs=runs, seed=seed) for pose in poses]
    predicted = np.array([each.predicted_success for each in found])
    realised = np.array([each.success for each in found])
    inside = [each.interval[0] <= each.predicted_success <= each.interval[1] for each in found]
    points = 100 * (predicted - realised)
    worst = int(np.abs(points).argmax())
    x, y, heading, bevel = poses[worst]
    chance = 100 * math.sqrt(2 / math.pi) * np.sqrt(realised * (1 - realised) / runs).mean()
    return Row(
        name, where, len(poses), 100 * float(realised.mean()), float(np.abs(points).mean()), float(chance),
        float(points.mean()), 100 * float((np.abs(points) <= 3).mean()), float(points[worst]),
        (x, y, math.degrees(heading), bevel), 100 * float(np.mean(inside)), table.stats.states, table.stats.seconds,
    )  # fmt: skip


def _poses(table: npl.PolicyTable, where: str, count: int, random: np.random.Generator) -> list[npl.Pose]:
    space, found = table.scenario.workspace, []
    for _ in range(_DRAWN):
        left = where == "left edge"
        x = np.zeros(count) if left else random.uniform(0, space.width_mm, count)
        y = random.uniform(0, space.height_mm, count)
        heading = random.uniform(-math.pi / 2, math.pi / 2, count) * (1 if left else 2)
        rows = np.column_stack([x, y, heading, random.choice([-1.0, 1.0], count)])
        likely = table.lookup_many(rows).success
        for row, success in zip(rows.tolist(), likely.tolist(), strict=True):
            pose = npl.Pose(*row[:3], int(row[3]))
            if 0 < len(found) == count:
                return found
            if not _is_free(table.scenario, pose):
                continue
            if success > _DOUBT or table.rollout(pose, runs=_PILOT_RUNS, seed=1).success > 0:
                found.append(pose)
    return found


def _is_free(scenario: Scenario, pose: npl.Pose) -> bool:
    x, y = pose.x_mm, pose.y_mm
    target = math.dist((x, y), scenario.target.center_mm) <= scenario.target.radius_mm
    return not target and not any(each.region().intersects(Point(x, y)) for each in scenario.obstacles)


if __name__ == "__main__":
    raise SystemExit(main())
