"""Compare predicted success and cost with executions by a model that was written from the documentation.

python benches/python/foreign_executions.py --json benches/results/foreign_executions.json \
    > benches/results/foreign_executions.md
python benches/python/foreign_executions.py --tables FOLDER          # keeps the tables there, and reads them again
python benches/python/foreign_executions.py brain straight --runs 200

`foreign_model` shares no code with needleplan. It reads the table file and executes its policy. The realised share of
successes is compared with `PolicyTable.lookup(...).success`, the mean cost with `.value`, and the first decision
with `.action`.

Poses: on the left edge, y uniform, heading within 45 degrees of +x (`phantom`: 3 degrees, because its workspace is
96 x 4.5 mm); anywhere in the workspace with any heading; the bevel is random. Poses in an obstacle or in the target
are left out. Seeds are fixed. Chance is the mean absolute difference that exact predictions would have. It is computed
by drawing the counts from the predictions.

After that, the program executes from the same poses (`PolicyTable.rollout`). The two programs execute the same policy
in the same continuous model, so their difference contains no error of a grid: only chance is left if both are right.
"""

import argparse
import json
import math
import sys
import tempfile
from pathlib import Path
from time import monotonic

import machine
import numpy as np
from foreign_model import NONE, TARGET, Policy

import needleplan as npl

SCENES = Path(__file__).with_name("foreign_scenes")
NAMES = ("four_obstacles", "narrow_passage", "prostate", "brain", "layered", "phantom", "discs", "rings", "straight")
POSE_SEED, NOISE_SEED, CHANCE_SEED = 20261123, 271828, 314159
HALF_ANGLE_DEG = {"phantom": 3.0}
ROLLOUTS = 10_000  # executions of each pose by the program
CHUNK = 30_000  # executions at a time


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=NAMES, help="scenarios (all)")
    parser.add_argument("--poses", type=int, default=60, help="poses of each kind")
    parser.add_argument("--runs", type=int, default=1000, help="executions of each pose")
    parser.add_argument("--seed", type=int, default=POSE_SEED, help="seed of the poses")
    parser.add_argument("--tables", type=Path, help="folder of the tables")
    parser.add_argument("--json", type=Path, help="write the figures of every pose to this file")
    options = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name in options.names:
            path = (options.tables or Path(folder)) / f"{name}.h5"
            if not path.exists():
                own = SCENES / f"{name}.toml"
                npl.plan(own if own.exists() else name).write(path)
            policy, table = Policy(path), npl.PolicyTable.read(path)
            for kind in ("left edge", "anywhere"):
                begin = monotonic()
                poses = draw(policy, name, kind, options.poses, options.seed)
                row = {"scenario": name, "poses": kind, **compare(policy, table, poses, options.runs)}
                row["seconds"] = round(monotonic() - begin, 1)
                rows.append(row)
                print(f"{name}, {kind}: {row['summary']}, {row['seconds']} s", file=sys.stderr, flush=True)
    result = {"machine": machine.description(), "poses": options.poses, "runs": options.runs, "seed": options.seed}
    result["rows"] = rows
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(report(result))


def draw(policy: Policy, name: str, kind: str, count: int, seed: int) -> np.ndarray:
    """Return random poses [count, 4] outside of obstacles and target."""
    model, rng = policy.model, np.random.default_rng([seed, NAMES.index(name), kind == "anywhere"])
    n = 50 * count
    if kind == "left edge":
        half = math.radians(HALF_ANGLE_DEG.get(name, 45.0))
        x, heading = np.zeros(n), rng.uniform(-half, half, n)
    else:
        x, heading = rng.uniform(0.0, model.width, n), rng.uniform(0.0, 2 * math.pi, n)
    poses = np.column_stack([x, rng.uniform(0.0, model.height, n), heading, rng.choice([-1.0, 1.0], n)])
    p = poses[:, :2]
    free = np.hypot(*(p - model.target[0, :2]).T) > model.target[0, 2]
    for obstacle in model.obstacles:
        free &= ~obstacle.holds(p)
    return poses[free][:count]


def compare(policy: Policy, table: npl.PolicyTable, poses: np.ndarray, runs: int) -> dict[str, object]:
    """Execute `runs` times from each pose; return the figures of each pose and their summary."""
    looked = [table.lookup(x, y, heading, int(bevel)) for x, y, heading, bevel in poses]
    predicted = np.array([each.success for each in looked], float)
    value = np.array([each.value for each in looked], float)
    agree = np.array([each.action.code for each in looked]) == policy.decide(poses[:, :2], poses[:, 2], poses[:, 3])[0]
    rng, started = np.random.default_rng(NOISE_SEED), np.repeat(poses, runs, axis=0)
    parts = [policy.execute(started[at : at + CHUNK], rng) for at in range(0, len(started), CHUNK)]
    outcome, spent = (np.concatenate(each).reshape(len(poses), runs) for each in zip(*parts, strict=True))
    realised, cost = (outcome == TARGET).mean(axis=1), spent.mean(axis=1)
    difference = 100 * (predicted - realised)
    chances = np.clip(predicted, 0.0, 1.0)
    drawn = np.random.default_rng(CHANCE_SEED).binomial(runs, chances, (4000, len(poses))) / runs - chances
    open_ = (predicted > 0.01) & (predicted < 0.99)
    rolled = [table.rollout(tuple(pose), runs=ROLLOUTS, seed=NOISE_SEED + at) for at, pose in enumerate(poses)]
    shares, costs = np.array([(each.success, each.mean_cost) for each in rolled]).T
    pooled = (realised * runs + shares * ROLLOUTS) / (runs + ROLLOUTS)
    variance = pooled * (1 - pooled) * (1 / runs + 1 / ROLLOUTS)
    some = variance > 0
    z = (shares - realised)[some] / np.sqrt(variance[some])
    spread = spent.var(axis=1) * (1 / runs + 1 / ROLLOUTS)
    sure = (realised == 1.0) & (predicted > 0.999)
    summary = {
        "realised": 100 * realised.mean(),
        "mean_abs": abs(difference).mean(),
        "chance": 100 * abs(drawn).mean(),
        "bias": difference.mean(),
        "bias_sd_by_chance": 100 * drawn.mean(axis=1).std(),
        "within_3": 100 * (abs(difference) <= 3).mean(),
        "within_3_by_chance": 100 * (abs(drawn) <= 0.03).mean(),
        "worst": difference[abs(difference).argmax()],
        "open_poses": int(open_.sum()),
        "open_mean_abs": abs(difference[open_]).mean() if open_.any() else None,
        "open_chance": 100 * abs(drawn[:, open_]).mean() if open_.any() else None,
        "program_bias": 100 * (shares - realised).mean(),
        "program_bias_sd": 100 * math.sqrt(variance.sum()) / len(poses),
        "program_poses": int(some.sum()),
        "program_mean_square_z": (z**2).mean() if len(z) else None,
        "program_worst_z": abs(z).max() if len(z) else None,
        "program_cost_bias": (costs - cost).mean(),
        "program_cost_bias_sd": math.sqrt(spread.sum()) / len(poses),
        "cost_bias": (value - cost).mean(),
        "cost_mean": cost.mean(),
        "cost_bias_sd": float(np.sqrt((spent.var(axis=1) / runs).sum()) / len(poses)),
        "sure_poses": int(sure.sum()),
        "sure_cost": cost[sure].mean() if sure.any() else None,
        "sure_cost_bias": (value - cost)[sure].mean() if sure.any() else None,
        "same_decision": 100 * agree.mean(),
        "unended": 100 * (outcome == NONE).mean(),
    }
    figures = np.column_stack([poses, predicted, realised, value, cost, shares, costs]).round(6).tolist()
    rounded = {key: each if each is None else round(float(each), 3) for key, each in summary.items()}
    columns = "x, y, heading, bevel, predicted, realised, value, cost, program's share, program's cost"
    return {"summary": rounded, "columns": columns, "figures": figures}


def report(result: dict) -> str:
    """Return the page of results."""
    about = result["machine"]
    lines = [
        "# Executions by a foreign model",
        "",
        f"{result['poses']} random poses a row, {result['runs']:,} executions each, pose seed {result['seed']}.",
        f"{about['processor']}, {about['date'][:10]}, commit {about['commit'][:10]}, Python {about['python']}.",
        "",
        "The executions are those of `foreign_model.py`, written from the documentation alone, but for the reading of",
        "the table between grid points, which is by an author of the program. Differences are",
        "predicted minus realised success in percentage points. Chance is what exact predictions would show. The",
        "number after +- is one standard deviation by chance. In doubt: poses with a prediction between 1 and 99 %.",
        "Decisions: share of poses at which the first decision is that of `lookup`.",
        "",
        "| scenario | poses | realised | mean abs. | chance | bias | within 3 | chance | worst "
        "| in doubt | mean abs. | chance | decisions |",
        "|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for row in result["rows"]:
        s = row["summary"]
        open_ = f"{s['open_mean_abs']:.2f} | {s['open_chance']:.2f}" if s["open_poses"] else "|"
        lines.append(
            f"| {row['scenario']} | {row['poses']} | {s['realised']:.1f} % | {s['mean_abs']:.2f} | {s['chance']:.2f} "
            f"| {s['bias']:+.2f} +- {s['bias_sd_by_chance']:.2f} | {s['within_3']:.1f} % "
            f"| {s['within_3_by_chance']:.1f} % | {s['worst']:+.1f} | {s['open_poses']:.0f} "
            f"| {open_} | {s['same_decision']:.0f} % |"
        )
    lines += [
        "",
        "Cost: predicted minus realised over all poses; then over the poses without any failure, where the rare",
        "price of a failure does not hide the length of the path:",
        "",
        "| scenario | poses | mean cost | bias | poses without failure | mean cost | bias |",
        "|---|---|--:|--:|--:|--:|--:|",
    ]
    for row in result["rows"]:
        s = row["summary"]
        sure = f"{s['sure_cost']:.2f} | {s['sure_cost_bias']:+.2f} |" if s["sure_poses"] else "| |"
        lines.append(
            f"| {row['scenario']} | {row['poses']} | {s['cost_mean']:.0f} "
            f"| {s['cost_bias']:+.1f} +- {s['cost_bias_sd']:.1f} | {s['sure_poses']:.0f} | {sure}"
        )
    lines += [
        "",
        f"`rollout` ({ROLLOUTS:,} executions) minus the foreign model. z is the difference over its standard",
        "deviation; two programs that agree have a mean square of 1:",
        "",
        "| scenario | poses | success, points | mean square of z | largest z | cost |",
        "|---|---|--:|--:|--:|--:|",
    ]
    for row in result["rows"]:
        s = row["summary"]
        if not s.get("program_poses"):
            continue
        lines.append(
            f"| {row['scenario']} | {row['poses']} | {s['program_bias']:+.2f} +- {s['program_bias_sd']:.2f} "
            f"| {s['program_mean_square_z']:.2f} ({s['program_poses']:.0f} poses) | {s['program_worst_z']:.1f} "
            f"| {s['program_cost_bias']:+.1f} +- {s['program_cost_bias_sd']:.1f} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    main()
