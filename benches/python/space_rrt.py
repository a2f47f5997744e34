"""Compare 3D policy tables with a kinodynamic RRT (OMPL) of the same needle in invented anatomies.

python -m pip install ompl
python benches/python/space_rrt.py --json benches/results/space_rrt.json > benches/results/space_rrt.md
python benches/python/space_rrt.py --seeds 1 --starts 2 --runs 100      # short test run

The anatomies are those of `needleplan new --anatomy KIND --seed 1, 2 ...` with the settings that they ship with; each
seed moves vessels and target. The starts are those of space_starts.py, without a selection. Both planners see the same
voxels and curvatures. The table plans once for an anatomy, for all starts; the RRT plans for each start again.

The state of the RRT is the pose. A control is a roll angle and a share of the curvature, constant for 1 to 20 mm in
pieces of 1 mm; below a share of 1/9 the piece is straight, otherwise it has the full curvature. The RRT knows no cone.
Its propagation is called from OMPL and written in Python, so its times are those of this program, and the number of
propagations says how long a compiled one takes.
"""

import argparse
import json
import math
import os
import sys
import tempfile
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from time import process_time
from typing import Any

import machine
import numpy as np
from space_rrt_model import PIECE_MM, RrtPath, following, open_loop, points_of
from space_starts import drawn

from needleplan.anatomy import FREE, PHANTOMS, TARGET, Anatomy, SpaceScenario, write_phantom
from needleplan.planning import plan_space, wilson

MISSING = "OMPL is missing: install it with `python -m pip install ompl` (it is used by this benchmark only)"
LONGEST_PIECES = 20
GOAL_BIAS = 0.05
# Weight of a difference of tangents in the distance of two states (mm for a vector of length 1).
TANGENT_WEIGHT_MM = 20.0
# Share of the curvature below which a piece is straight: one action of nine, as in the table.
STRAIGHT_BELOW = 1 / 9
NOISE_SEED = 7


@dataclass(frozen=True)
class RrtResult:
    """One problem: both planners; lengths and clearances in mm, times in processor seconds, success in shares."""

    anatomy: str
    seed: int
    start: tuple[float, ...]
    table_solved: bool
    table_length_mm: float
    table_clearance_mm: float
    table_predicted: float
    table_success: float
    rrt_solved: bool
    rrt_length_mm: float
    rrt_clearance_mm: float
    rrt_open_loop: float
    rrt_following: float
    rrt_s: float
    rrt_propagations: int


class Needle:
    """Propagation for OMPL. A piece that fails ends at x = -1, which the validity check refuses."""

    def __init__(self, scenario: SpaceScenario) -> None:
        grid = scenario.grid
        self.shape, self.spacing = grid.frame.shape, grid.frame.spacing_mm
        self.codes, self.tissues = grid.codes.tobytes(), grid.tissues.tobytes()
        self.curvatures = [1 / radius for radius in grid.radii_mm]
        self.propagations = 0

    def cell(self, x: float, y: float, z: float) -> int:
        """Return the number of the voxel of a position, -1 outside of the grid."""
        i, j, k = (math.floor(each / self.spacing + 0.5) for each in (x, y, z))
        within = 0 <= i < self.shape[0] and 0 <= j < self.shape[1] and 0 <= k < self.shape[2]
        return (i * self.shape[1] + j) * self.shape[2] + k if within else -1

    def propagate(self, state: Any, control: Any, duration: float, result: Any) -> None:
        """Move by an arc of the length `duration`."""
        self.propagations += 1
        x, y, z = state[0], state[1], state[2]
        dx, dy, dz = (state[n] / TANGENT_WEIGHT_MM for n in (3, 4, 5))
        cell = self.cell(x, y, z)
        if cell < 0 or dx < -0.9:
            result[0] = -1.0
            return
        turn = self.curvatures[self.tissues[cell]] * duration if control[1] >= STRAIGHT_BELOW else 0.0
        share, cosine, sine = 1 / (1 + dx), math.cos(control[0]), math.sin(control[0])
        normal = (
            -cosine * dy - sine * dz,
            cosine * (1 - dy * dy * share) - sine * dy * dz * share,
            -cosine * dy * dz * share + sine * (1 - dz * dz * share),
        )
        ahead = duration * (math.sin(turn) / turn) if turn else duration
        aside = duration * ((1 - math.cos(turn)) / turn) if turn else 0.0
        along, across = math.cos(turn), math.sin(turn)
        end = [p + ahead * d + aside * n for p, d, n in zip((x, y, z), (dx, dy, dz), normal, strict=True)]
        met = self.cell(*end)
        if met < 0 or self.codes[met] not in (FREE, TARGET):
            result[0] = -1.0
            return
        for n in range(3):
            result[n] = end[n]
            result[3 + n] = TANGENT_WEIGHT_MM * (along * (dx, dy, dz)[n] + across * normal[n])


def rrt_path(scenario: SpaceScenario, start: tuple[float, ...], limit: int) -> tuple[RrtPath | None, float, int]:
    """Return the path of one run of RRT, or None, processor seconds, and the number of propagations."""
    from ompl import base, control, util

    util.setLogLevel(util.LogLevel.LOG_ERROR)
    began, needle = process_time(), Needle(scenario)
    states = base.RealVectorStateSpace(6)
    bounds = base.RealVectorBounds(6)
    for axis, extent in enumerate((np.array(scenario.grid.frame.shape) - 1) * needle.spacing):
        bounds.setLow(axis, -needle.spacing / 2)
        bounds.setHigh(axis, float(extent) + needle.spacing / 2)
        bounds.setLow(3 + axis, -TANGENT_WEIGHT_MM if axis else 0.0)
        bounds.setHigh(3 + axis, TANGENT_WEIGHT_MM)
    states.setBounds(bounds)
    controls = control.RealVectorControlSpace(states, 2)
    limits = base.RealVectorBounds(2)
    for number, (low, high) in enumerate([(-math.pi, math.pi), (0.0, 1.0)]):
        limits.setLow(number, low)
        limits.setHigh(number, high)
    controls.setBounds(limits)
    information = control.SpaceInformation(states, controls)
    information.setStatePropagator(needle.propagate)
    information.setStateValidityChecker(lambda state: state[0] > -0.99)
    information.setPropagationStepSize(PIECE_MM)
    information.setMinMaxControlDuration(1, LONGEST_PIECES)
    setup = control.SimpleSetup(information)
    first = states.allocState()
    for n in range(6):
        first[n] = start[n] if n < 3 else TANGENT_WEIGHT_MM * start[n]
    setup.setStartState(first)
    setup.setGoal(_goal(base, information, scenario, needle))
    planner = control.RRT(information)
    planner.setIntermediateStates(True)
    planner.setGoalBias(GOAL_BIAS)
    setup.setPlanner(planner)
    setup.solve(base.PlannerTerminationCondition(lambda: needle.propagations >= limit))
    found = None
    if setup.haveExactSolutionPath():
        path, pieces = setup.getSolutionPath(), []
        for number in range(path.getControlCount()):
            of = path.getControl(number)
            share = 1.0 if of[1] >= STRAIGHT_BELOW else 0.0
            pieces += [(float(of[0]), share)] * round(path.getControlDuration(number) / PIECE_MM)
        found = RrtPath(start, pieces)
    return found, process_time() - began, needle.propagations


def _goal(base: Any, information: Any, scenario: SpaceScenario, needle: Needle) -> Any:
    target, random = scenario.target_mm, np.random.default_rng(1)

    class Goal(base.GoalSampleableRegion):  # type: ignore[misc]
        """The voxels of the target, with any tangent."""

        def distanceGoal(self, state: Any) -> float:  # noqa: N802
            cell = needle.cell(state[0], state[1], state[2])
            away = math.dist((state[0], state[1], state[2]), target)
            return 0.0 if cell >= 0 and needle.codes[cell] == TARGET else 1.0 + away

        def sampleGoal(self, state: Any) -> None:  # noqa: N802
            tangent = random.standard_normal(3)
            tangent *= TANGENT_WEIGHT_MM / np.linalg.norm(tangent)
            for n in range(3):
                state[n], state[3 + n] = target[n], float(abs(tangent[n]) if n == 0 else tangent[n])

        def maxSampleCount(self) -> int:  # noqa: N802
            return 1_000_000_000

        def couldSample(self) -> bool:  # noqa: N802
            return True

    goal = Goal(information)
    goal.setThreshold(0.5)
    return goal


def compared(kind: str, seed: int, options: argparse.Namespace) -> tuple[list[RrtResult], float, int]:
    """Return the problems of an anatomy, the seconds of one thread for its table, and the number of states."""
    with tempfile.TemporaryDirectory() as folder:
        scenario = SpaceScenario.of(Anatomy.read(write_phantom(kind, folder, seed)))
    began = process_time()
    table = plan_space(scenario, threads=1)
    seconds, random, found = process_time() - began, np.random.default_rng(seed), []
    for _ in range(options.starts):
        start = drawn(table, random)
        way, decision = table.path(start), table.lookup(start)
        success = table.rollout(start, runs=options.runs, seed=NOISE_SEED).success
        path, rrt_s, propagations = rrt_path(scenario, start, options.limit)
        length = clearance = open_success = following_success = math.nan
        if path is not None:
            points, reached = points_of(scenario, path)
            if not reached:
                raise RuntimeError(
                    f"{kind}, seed {seed}: the second test of the RRT's path finds it outside the target"
                )
            length = (len(points) - 1) * PIECE_MM
            cells = np.floor(points[:, :3] / scenario.grid.frame.spacing_mm + 0.5).astype(int)
            clearance = float(scenario.grid.clearance_mm[tuple(cells.T)].min())
            open_success = open_loop(scenario, path, options.runs, NOISE_SEED)
            following_success = following(scenario, path, options.runs, NOISE_SEED)
        found.append(
            RrtResult(
                kind, seed, start, way.outcome == "target", way.length_mm, way.clearance_mm,
                decision.success, float(success), path is not None, length, clearance, open_success,
                following_success, rrt_s, propagations,
            )
        )  # fmt: skip
    return found, seconds, table.stats.states


def report(results: list[RrtResult], table_s: list[float], states: list[int]) -> str:
    """Return the tables of the page."""
    both = [each for each in results if each.table_solved and each.rrt_solved]

    def mean(key: str, of: list[RrtResult]) -> float:
        return float(np.mean([getattr(each, key) for each in of])) if of else math.nan

    def share(key: str) -> str:
        solved = sum(getattr(each, key) for each in results)
        low, high = wilson(solved, len(results))
        return f"{solved} of {len(results)} ({low:.0%} to {high:.0%})"

    times = np.array([each.rrt_s for each in results])
    only = [each for each in results if each.table_solved and not each.rrt_solved]
    other = [each for each in results if each.rrt_solved and not each.table_solved]
    lines = [
        "| quantity | table | RRT |",
        "|---|--:|--:|",
        f"| solved, 95 % interval | {share('table_solved')} | {share('rrt_solved')} |",
        f"| solved by this one only | {len(only)} | {len(other)} |",
        f"| length, mean of {len(both)} solved by both | {mean('table_length_mm', both):.1f} mm "
        f"| {mean('rrt_length_mm', both):.1f} mm |",
        f"| clearance, same | {mean('table_clearance_mm', both):.1f} mm | {mean('rrt_clearance_mm', both):.1f} mm |",
        f"| success under noise, same | {mean('table_success', both):.1%} (predicted "
        f"{mean('table_predicted', both):.1%}) | {mean('rrt_open_loop', both):.1%} without feedback, "
        f"{mean('rrt_following', both):.1%} following the path |",
        f"| processor time, one start | {np.mean(table_s):.2f} s, all starts | median {np.median(times):.2f} s, "
        f"mean {times.mean():.2f} s |",
        f"| propagations or states | {np.mean(states) / 1e6:.1f} M states "
        f"| median {np.median([each.rrt_propagations for each in results]):,.0f} propagations |",
        f"| all {len(results)} starts | {sum(table_s):.1f} s ({len(table_s)} tables) | {times.sum():.1f} s |",
    ]
    return "\n".join(lines)


def main() -> int:
    """Compare on all anatomies and print the page; with --json, write the problems."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="anatomies of each kind (5)")
    parser.add_argument("--starts", type=int, default=5, help="starts in each anatomy (5)")
    parser.add_argument("--runs", type=int, default=500, help="executions with noise (500)")
    parser.add_argument("--limit", type=int, default=50_000, help="propagations of one RRT run (50,000)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    if find_spec("ompl") is None:
        print(MISSING, file=sys.stderr)
        return 2
    from ompl import util

    util.RNG.setSeed(1)
    about = machine.description()
    results: list[RrtResult] = []
    table_s: list[float] = []
    states: list[int] = []
    for kind in PHANTOMS:
        for seed in range(1, options.seeds + 1):
            found, seconds, count = compared(kind, seed, options)
            results, table_s, states = results + found, [*table_s, seconds], [*states, count]
            if options.json:
                record = {"machine": about, "limit": options.limit, "runs": options.runs, "table_s": table_s,
                          "states": states, "problems": [asdict(each) for each in results]}  # fmt: skip
                options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
            print(f"{kind} {seed}: table {sum(each.table_solved for each in found)}, "
                  f"RRT {sum(each.rrt_solved for each in found)} of {len(found)}", file=sys.stderr)  # fmt: skip
    print("# 3D policy tables beside a kinodynamic RRT\n")
    print(f"{about['processor']}, commit {about['commit']}, {about['date']}. Shipped settings; {options.runs:,}")
    print(
        f"executions with noise; at most {options.limit:,} propagations of one RRT run; its propagation is in Python."
    )
    print("Solved: a path without noise reaches the target. Times: processor seconds; other programs were running.\n")
    print(report(results, table_s, states))
    return 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # skips the check of OMPL's bindings for leaks, which prints to stderr
