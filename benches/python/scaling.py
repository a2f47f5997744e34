"""Measure how time and memory grow with the number of states.

The problem is the four-obstacle workspace with the costs of the thesis, on finer and finer grids, with both kinds of
transitions. Each grid runs in its own process, so that its peak memory is measured separately.

    python benches/python/scaling.py --json scaling.json --figure scaling.png          # down to 0.25 mm, 18.6 M states
    python benches/python/scaling.py --spacings 4 2                                    # short test run
"""

import argparse
import json
import resource
import subprocess
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import machine
import numpy as np

SPACINGS = (4.0, 2.0, 1.0, 0.5, 0.25)
TRANSITIONS = ("nearest", "interpolated")
_COLORS = {"nearest": "#0b5fa5", "interpolated": "#c8501e"}


@dataclass(frozen=True)
class Point:
    """Results of one grid: median times (s) of geometry, solve and success probabilities; peak memory (MB)."""

    spacing_mm: float
    transition: str
    states: int
    geometry: float
    solve: float
    success: float
    sweeps: float
    status: str
    peak_mb: float
    imports_mb: float

    @property
    def total(self) -> float:
        """Time from the scenario to the table (s)."""
        return self.geometry + self.solve + self.success


def main() -> int:
    """Measure all grids and print a table; write the JSON file and the figure if requested."""
    options = _options()
    if options.child:
        print(json.dumps(asdict(_measure_here(float(options.child[0]), options.child[1], options.threads))))
        return 0
    about = machine.description()
    points, failures = [], []
    for transition in TRANSITIONS:
        for spacing in options.spacings:
            point = _measure(spacing, transition, options)
            if isinstance(point, str):
                failures.append(f"{spacing:g} mm, {transition}: {point}")
                print(failures[-1], file=sys.stderr)
            else:
                points.append(point)
                print(f"{spacing:g} mm, {transition}: {point.total:.3g} s", file=sys.stderr)
    print("\n".join(_table(points)))
    if options.json:
        record = {"machine": about, "points": [asdict(point) for point in points], "failures": failures}
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    if options.figure and points:
        draw(points, options.figure)
    return int(bool(failures))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacings", nargs="+", type=float, default=SPACINGS, metavar="MM")
    parser.add_argument("--threads", type=int, metavar="N", help="default: all")
    parser.add_argument("--time-limit", type=float, default=600.0, metavar="S", help="for each grid (default 600)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--figure", type=Path, metavar="FILE")
    parser.add_argument("--child", nargs=2, help=argparse.SUPPRESS)
    return parser.parse_args()


def _measure(spacing: float, transition: str, options: argparse.Namespace) -> Point | str:
    """Measure a grid in its own process. Return its results, or the reason if that fails."""
    command = [sys.executable, __file__, "--child", str(spacing), transition]
    command += ["--threads", str(options.threads)] if options.threads else []
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=options.time_limit, check=False)
    except subprocess.TimeoutExpired:
        return f"not done after {options.time_limit:.0f} s"
    if done.returncode:
        said = done.stderr.strip().splitlines()
        return said[-1] if said else f"ended with exit code {done.returncode}"
    return Point(**json.loads(done.stdout))


def _measure_here(spacing: float, transition: str, threads: int | None) -> Point:
    from problem import scenario_at

    from needleplan.planning import lattice_of
    from needleplan.scenario import Transition

    scenario = scenario_at(spacing)
    scenario = replace(scenario, grid=replace(scenario.grid, transition=Transition(transition)))
    solver, imports_mb = scenario.solver, _peak_mb()
    times: list[tuple[float, float, float]] = []
    for _ in range(int(np.clip(1e7 / scenario.states, 1, 15))):
        clock = [perf_counter()]
        lattice = lattice_of(scenario)
        clock.append(perf_counter())
        solved = lattice.solve(
            method="sweep", partitions=solver.partitions, priority="H2", tolerance=solver.tolerance, threads=threads
        )
        clock.append(perf_counter())
        lattice.success(policy=solved["policy"], threads=threads)
        clock.append(perf_counter())
        times.append((clock[1] - clock[0], clock[2] - clock[1], clock[3] - clock[2]))
    geometry, solve, success = (median(column) for column in zip(*times, strict=True))
    counts = (solved["sweeps"], solved["status"], _peak_mb(), imports_mb)
    return Point(spacing, transition, scenario.states, geometry, solve, success, *counts)


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6


def _table(points: list[Point]) -> list[str]:
    lines = [
        "| spacing | transition | states | geometry s | solve s | success s | backups / n | peak MB | bytes a state |",
        "|--:|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for each in points:
        own = (each.peak_mb - each.imports_mb) * 1e6 / each.states
        times = f"{each.geometry:.3g} | {each.solve:.3g} | {each.success:.3g}"
        lines.append(
            f"| {each.spacing_mm:g} mm | {each.transition} | {each.states:,} | {times} | {each.sweeps:.3g} | "
            f"{each.peak_mb:.0f} | {own:.0f} |"
        )
    return lines


def draw(points: list[Point], file: Path) -> None:
    """Draw time and memory against the number of states, with logarithmic axes."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 4.0), layout="constrained")
    for transition in TRANSITIONS:
        chosen = sorted((each for each in points if each.transition == transition), key=lambda each: each.states)
        if not chosen:
            continue
        states, style = [each.states for each in chosen], {"color": _COLORS[transition], "marker": "o", "markersize": 4}
        left.plot(states, [each.total for each in chosen], label=f"{transition}, scenario to table", **style)
        left.plot(states, [each.solve for each in chosen], "--", label=f"{transition}, solve", **style)
        right.plot(states, [each.peak_mb - each.imports_mb for each in chosen], label=transition, **style)
    _finish(left, "seconds", points, [each.solve for each in points])
    _finish(right, "peak memory beyond the imports, MB", points, [each.peak_mb - each.imports_mb for each in points])
    figure.savefig(file, dpi=160)


def _finish(axes: Any, label: str, points: list[Point], values: list[float]) -> None:
    """Add axes, grid, legend, and a line of slope one below the point with the fewest states."""
    least = int(np.argmin([each.states for each in points]))
    ends = np.array([points[least].states, max(each.states for each in points)], dtype=float)
    axes.plot(ends, 0.5 * values[least] * ends / ends[0], color="0.6", linewidth=1, label="proportional to the states")
    axes.set(xscale="log", yscale="log", xlabel="states", ylabel=label)
    axes.xaxis.set_minor_formatter("")
    axes.yaxis.set_minor_formatter("")
    axes.grid(which="major", color="0.9")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8)


if __name__ == "__main__":
    sys.exit(main())
