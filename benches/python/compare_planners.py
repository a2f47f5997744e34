"""Compare policy tables with a kinodynamic RRT (OMPL) of the same needle in thirty random scenes and three by hand.

python -m pip install ompl
python benches/python/compare_planners.py --json benches/results/planners.json --figure benches/results/planners.png \
    > benches/results/planners.md
python benches/python/compare_planners.py --only 2 5 --runs 200      # a trial
python benches/python/compare_planners.py --print FILE.json          # print a report again

Scenes (rrt_scenes.py): 150 x 150 mm, radius 50 mm, margin 2 mm, goal tolerance 3 mm. Both planners get the same start
and the same polygons, which contain the margin; both choose the first bevel. rrt_arcs.py tests every path again, with
exact arcs. Executions with noise are those of rrt_execute.py. rrt_reach.py tries to prove that a scene has no solution:
on all its grids for the scenes that nobody solves, on the coarsest one for the others, where it must fail.
"""

import argparse
import json
import subprocess
import sys
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from time import process_time
from typing import Any

import machine
import numpy as np
import rrt_ompl
import rrt_reach
import rrt_report
from rrt_arcs import Array, Event, Space
from rrt_execute import Arc, Decide, Measured, Noise, following, measured, open_loop, policy, policy_arcs
from rrt_scenes import GOAL_TOLERANCE_MM, RADIUS_MM, SIDE_MM, Scene, scenes

import needleplan as npl
from needleplan.scenario import Grid, Needle, Scenario, Solver, Target, TipMotion, Transition, Workspace

TIP_NOISE = (0.466, 0.24, 0.027)
# Headings of the table with noise and of the first table without noise. The noise turns the tip by whole headings.
HEADINGS = 60
# Headings of the second table without noise, whose steps are half as long.
FINER_HEADINGS = 120
# Seeds of the RRT: three runs for each scene. The first that solves the scene gives the path.
RRT_SEEDS = (1, 2, 3)
# Seeds of the noise in the executions with noise.
NOISE_SEEDS = {"policy": 11, "open_loop": 12, "following": 13}


def main() -> int:
    """Run all scenes, then print the report; with --json and --figure, write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", type=int, nargs="+", metavar="INDEX", help="scenes to run; 0 to 2 are made by hand")
    parser.add_argument("--runs", type=int, default=2000, help="executions with noise")
    parser.add_argument("--spacing", type=float, default=0.5, help="spacing of the tables' grid in mm")
    parser.add_argument("--limit", type=int, default=200_000, help="propagations of one RRT run")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--figure", type=Path, metavar="FILE")
    parser.add_argument("--print", type=Path, metavar="FILE", help="print the report of an earlier run")
    options = parser.parse_args()
    if options.print:
        print(rrt_report.text(json.loads(options.print.read_text(encoding="utf-8"))))
        return 0
    if find_spec("ompl") is None:
        print(rrt_ompl.MISSING, file=sys.stderr)
        return 2
    every = scenes()
    chosen = [every[index] for index in options.only] if options.only else every
    about = machine.description()
    began = process_time()
    results: list[dict[str, Any]] = []
    record = {
        "machine": about,
        "runs": options.runs,
        "spacing_mm": options.spacing,
        "limit": options.limit,
        "rrt_seeds": RRT_SEEDS,
        "noise_seeds": NOISE_SEEDS,
        "tip_noise": TIP_NOISE,
        "headings": HEADINGS,
        "finer_headings": FINER_HEADINGS,
        "scenes": results,
    }
    for scene in chosen:
        results.append(_compared(scene, options))
        print(f"{scene.name}: {process_time() - began:.0f} s", file=sys.stderr)
        if options.json:
            options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    if options.figure:
        rrt_report.draw(record, options.figure)
    print(rrt_report.text(json.loads(json.dumps(record))))
    return 0


def problem(
    scene: Scene, spacing_mm: float, tip_noise: tuple[float, ...] = (1.0,), headings: int = HEADINGS
) -> Scenario:
    """Return the scene as a scenario: shipped settings, except for the grid, the headings, and one thread."""
    return Scenario(
        Workspace(SIDE_MM, SIDE_MM),
        Target(scene.target, GOAL_TOLERANCE_MM),
        Needle(RADIUS_MM),
        obstacles=tuple(npl.Obstacle(polygon) for polygon in scene.inflated),
        motion=TipMotion(headings=headings, tip_noise=tip_noise),
        grid=Grid(spacing_mm=(spacing_mm, spacing_mm), transition=Transition.INTERPOLATED),
        solver=Solver(threads=1),
        title=scene.name,
    )


def _compared(scene: Scene, options: argparse.Namespace) -> dict[str, Any]:
    space = Space(scene)
    finer = _calm(space, options.spacing, FINER_HEADINGS)
    result = {"scene": scene.to_json(), "table": _table(space, options), "finer": finer, "rrt": _rrt(space, options)}
    solved = rrt_report.is_solved(result)
    return result | {"proof": rrt_reach.proof(scene, grids=1 if solved else rrt_reach.GRIDS)}


def _table(space: Space, options: argparse.Namespace) -> dict[str, Any]:
    """Plan with noise; execute both this table and the one without noise."""
    scene = space.scene
    noisy, noisy_s = _planned(problem(scene, options.spacing, TIP_NOISE))
    noise = Noise(noisy.scenario.step_mm, 2 * np.pi / HEADINGS, TIP_NOISE)
    start = noisy.start(scene.start)
    runs = policy(space, _decide(noisy), start.bevel, noise, options.runs, NOISE_SEEDS["policy"])
    return {
        **_calm(space, options.spacing, HEADINGS),
        "seconds_with_noise": noisy_s,
        "predicted_with_noise": float(noisy.lookup(*start).success),
        "realised_with_noise": runs.success,
        "turns_with_noise": float(runs.turns.mean()),
    }


def _calm(space: Space, spacing_mm: float, headings: int) -> dict[str, Any]:
    """Plan without noise, and execute the table."""
    table, seconds = _planned(problem(space.scene, spacing_mm, headings=headings))
    begin = table.start(space.scene.start)
    arcs = policy_arcs(space, _decide(table), begin.bevel, table.scenario.step_mm)
    return {
        "status": str(table.stats.status),
        "seconds": seconds,
        "success_at_start": float(table.lookup(*begin).success),
        "own_outcome": str(table.path(begin).outcome),
        **_path(measured(space, arcs), arcs),
    }


def _planned(scenario: Scenario) -> tuple[npl.PolicyTable, float]:
    began = process_time()
    table = npl.plan(scenario)
    return table, process_time() - began


def _decide(table: npl.PolicyTable) -> Decide:
    def decide(poses: Array, bevel: Array) -> Array:
        heading = np.mod(poses[:, 2], 2 * np.pi)
        action = table.lookup_many(np.column_stack([poses[:, :2], heading, bevel])).action
        return np.where(action == 1, -bevel, bevel)

    return decide


def _rrt(space: Space, options: argparse.Namespace) -> dict[str, Any]:
    """Run RRT from several seeds; execute the first path that was found."""
    tries = [_ompl(space.scene, seed, options.limit) for seed in RRT_SEEDS]
    paths = [measured(space, each["path"]) for each in tries if each["solved"]]
    solved = [path for path in paths if path.event == Event.TARGET]
    result: dict[str, Any] = {
        "tries": [{key: value for key, value in each.items() if key != "path"} for each in tries],
        "solved": len(solved),
        "refuted": len(paths) - len(solved),
        "lengths_mm": [path.length_mm for path in solved],
        "turns_of_tries": [path.turns for path in solved],
    }
    for each in tries:
        if each["solved"] and (found := measured(space, each["path"])).event == Event.TARGET:
            return result | _path(found, each["path"]) | _disturbed(space, each["path"], options.runs)
    return result


def _disturbed(space: Space, arcs: list[Arc], runs: int) -> dict[str, float]:
    """Execute a path with noise, open loop and following it."""
    step_mm = 2 * np.pi * RADIUS_MM / HEADINGS
    noise = Noise(step_mm, 2 * np.pi / HEADINGS, TIP_NOISE)
    follow = following(arcs, space.scene.start, step_mm)
    return {
        "open_loop": open_loop(space, arcs, noise, runs, NOISE_SEEDS["open_loop"]).success,
        "following": policy(space, follow, arcs[0][0], noise, runs, NOISE_SEEDS["following"]).success,
    }


def _ompl(scene: Scene, seed: int, limit: int) -> dict[str, Any]:
    task = json.dumps({"scene": scene.to_json(), "seed": seed, "limit": limit})
    child = subprocess.run([sys.executable, rrt_ompl.__file__], input=task, capture_output=True, text=True, check=False)
    if child.returncode:
        raise SystemExit(child.stderr.strip() or f"OMPL ended with code {child.returncode}")
    answer: dict[str, Any] = json.loads(child.stdout.splitlines()[-1])
    return answer


def _path(found: Measured, arcs: list[Arc]) -> dict[str, Any]:
    return {**asdict(found), "event": found.event.name.lower(), "arcs": arcs}


if __name__ == "__main__":
    raise SystemExit(main())
