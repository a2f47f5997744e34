"""Print the speed table: seven figures of the planner, measured in one run beside the peers.

    python benches/python/speed_table.py --json benches/results/speed.json > benches/results/speed.md
    python benches/python/speed_table.py --no-peers      # a minute; the rows beside other solvers have no figure
    python benches/python/speed_table.py --spacing 4     # a small problem, as a short test run

The problem is `four_obstacles_thesis` (1,176,120 states), with other costs and transitions where a row says so. A ratio
is of times from this run. The first figure is taken once more at the end, to show whether the machine kept its speed.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import machine
import numpy as np
from contest import Result, measure
from contestants import CONTESTANTS
from problem import problem_of, reference_of, scenario_at
from verdicts import fastest_library, ratio

import needleplan as npl
from needleplan.planning import lattice_of
from needleplan.scenario import Objective, Scenario, Transition

OURS = ("lattice-1", "whole-way", "tabular-1")
OTHERS = ("numba-gs", "quantecon-mpi", "quantecon-vi", "mdptoolbox", "mdpsolver-vi-all")
# Change of the first figure, from the start to the end of the run, above which the run is worth nothing.
DRIFT = 0.25


@dataclass(frozen=True)
class Row:
    """A figure, what is asked, and the time of needleplan (s) behind it with its sweeps over `states` states."""

    name: str
    figure: float | None
    asked: float | None
    unit: str
    is_least: bool
    seconds: float
    states: int
    sweeps: float | None = None

    @property
    def holds(self) -> bool | None:
        """Whether the figure is as asked; None if it was not measured or nothing is asked."""
        if self.figure is None or self.asked is None:
            return None
        return self.figure >= self.asked if self.is_least else self.figure <= self.asked

    def line(self) -> str:
        """Return the row as Markdown."""
        sign = "at least" if self.is_least else "at most"
        figure = "not measured" if self.figure is None else f"{self.figure:.3g} {self.unit}".strip()
        asked = "" if self.asked is None else f"{sign} {self.asked:g} {self.unit}".strip()
        rate = "" if self.sweeps is None else f"{self.states * self.sweeps / self.seconds / 1e6:.4g}"
        sweeps = "" if self.sweeps is None else f"{self.sweeps:.3g}"
        verdict = {True: "yes", False: "**no**", None: ""}[self.holds]
        return f"| {self.name} | {figure} | {asked} | {verdict} | {1e3 * self.seconds:.4g} | {sweeps} | {rate} |"


def main() -> int:
    """Measure all rows and print the table; with --json, write the results.

    Returns the exit code: 1 if a row of the full problem is not as asked, else 0.
    """
    options = _options()
    about = machine.description()
    scenario = scenario_at(options.spacing)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        results = _contest(scenario, folder, (*OURS, *(() if options.no_peers else OTHERS)))
        rows = [*_beside_peers(results, scenario), *_own(scenario), *_shell(folder, scenario)]
        again = measure(CONTESTANTS["lattice-1"], folder, 300.0)
    record = {"machine": about, "spacing_mm": options.spacing, "rows": [asdict(row) for row in rows]}
    record["contestants"] = [asdict(result) for result in results.values()]
    if options.json:
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print(_text(about, rows, results, again))
    return int(options.spacing == 1.0 and any(row.holds is False for row in rows))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacing", type=float, default=1.0, metavar="MM", help="grid spacing; the full problem has 1")
    parser.add_argument("--no-peers", action="store_true", help="leave out other people's solvers")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all measured values")
    return parser.parse_args()


def _contest(scenario: Scenario, folder: Path, names: Sequence[str]) -> dict[str, Result]:
    """Measure contestants of `compare_peers.py`, each in a process of its own."""
    problem = problem_of(scenario)
    problem.write(folder)
    scenario.write(folder / "scenario.toml")
    np.save(folder / "reference.npy", reference_of(problem, scenario).values)
    del problem
    results = {}
    for name in names:
        print(f"{CONTESTANTS[name].label} ...", file=sys.stderr)
        results[name] = measure(CONTESTANTS[name], folder, 300.0)
    return results


def _beside_peers(results: Mapping[str, Result], scenario: Scenario) -> list[Row]:
    library = fastest_library(results)

    def row(title: str, name: str, asked: float, yardstick: Result | None) -> Row:
        own = results[name]
        figure = ratio(results, name, yardstick)
        return Row(title, figure, asked, "x", True, own.median, scenario.states, own.facts.get("sweeps"))

    return [
        row("lattice, 1 thread, beside the fastest library", "lattice-1", 500, library),
        row("scenario file to table, beside that library's solve", "whole-way", 150, library),
        row("tabular, 1 thread, beside numba Gauss-Seidel", "tabular-1", 1, results.get("numba-gs")),
    ]


def _own(scenario: Scenario) -> list[Row]:
    """Return the rows that compare needleplan with itself, and that of replanning."""
    print("objectives, success, replanning ...", file=sys.stderr)
    default = replace(scenario, objective=Objective())
    thesis, costly = lattice_of(scenario), lattice_of(default)
    times, solved = _in_turn(_solver(thesis, scenario), _solver(costly, default))
    rows = [
        Row(
            "default objective, beside the thesis' costs, 1 thread",
            times[1] / times[0], 2, "x", False, times[1], scenario.states, solved[1]["sweeps"],
        )
    ]  # fmt: skip
    finer = replace(default, grid=replace(default.grid, transition=Transition.INTERPOLATED))
    for kind, problem, lattice, asked in (
        ("default objective, interpolated", finer, lattice_of(finer), 0.5),
        ("the thesis' costs, nearest", scenario, thesis, None),
    ):
        times, solved = _in_turn(_solver(lattice, problem), _evaluation(lattice, problem))
        title = f"success evaluation, beside the solve, {kind}, 1 thread"
        rows.append(Row(title, times[1] / times[0], asked, "x", False, times[1], scenario.states))
    for _ in range(3):
        table = npl.plan(scenario)
    seconds = _median(lambda: npl.plan(scenario), 25)
    title = "replanning in a prepared process: scenario in memory to table"
    return [*rows, Row(title, 1e3 * seconds, 10, "ms", False, seconds, scenario.states, table.stats.sweeps)]


def _solver(lattice: Any, scenario: Scenario) -> Callable[[], Any]:
    tolerance = scenario.solver.tolerance
    return lambda: lattice.solve(method="sweep", partitions=(1, 1), priority="H2", tolerance=tolerance, threads=1)


def _evaluation(lattice: Any, scenario: Scenario) -> Callable[[], Any]:
    found = _solver(lattice, scenario)()
    for name in ("values", "policy"):
        found[name].flags.writeable = False  # as in `plan`: the compiled module copies writable arrays
    known = {"values": found["values"], "residual": found["residual"]}
    return lambda: lattice.success(found["policy"], **known, threads=1)


def _shell(folder: Path, scenario: Scenario) -> list[Row]:
    print("plan from the shell ...", file=sys.stderr)
    command = (sys.executable, "-m", "needleplan", "plan", "scenario.toml", "--json")
    # As for every user, compiled modules are kept from one start to the next.
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}

    def run(*more: str) -> dict[str, Any]:
        done = subprocess.run((*command, *more), cwd=folder, capture_output=True, check=True, text=True, env=variables)
        answer: dict[str, Any] = json.loads(done.stdout)
        return answer

    times, (answer, _) = _in_turn(run, lambda: run("-o", "table.h5", "--force"))
    return [
        Row(title, 1e3 * seconds, asked, "ms", False, seconds, scenario.states, answer["sweeps"])
        for title, asked, seconds in (
            ("shell to table and its best entry", 250, times[0]),
            ("the same, and the table in a file", None, times[1]),
        )
    ]


def _in_turn(*works: Callable[[], Any], repeats: int = 15) -> tuple[list[float], list[Any]]:
    """Run each of `works` in turn; return their median times (s) and last results. The first round is not timed."""
    times: list[list[float]] = [[] for _ in works]
    for number in range(repeats + 1):
        results = []
        for work, mine in zip(works, times, strict=True):
            began = perf_counter()
            results.append(work())
            if number:
                mine.append(perf_counter() - began)
    return [median(mine) for mine in times], results


def _median(work: Callable[[], object], repeats: int) -> float:
    times, _ = _in_turn(work, repeats=repeats)
    return times[0]


def _text(about: Mapping[str, Any], rows: Sequence[Row], results: Mapping[str, Result], again: Result) -> str:
    first, peer = results["lattice-1"], fastest_library(results)
    versions = ", ".join(f"{name} {number}" for name, number in about["packages"].items())
    change = again.median / first.median - 1
    steady = "steady enough" if abs(change) <= DRIFT else "the machine was busy or changed its speed: run again"
    lines = [
        f"{rows[0].states:,} states. {about['processor']}, {about['threads']} threads, load {about['load_before']} "
        f"before the run; {about['date'][:10]}, commit {about['commit']}, Python {about['python']}, {versions}.",
        "",
        "| row | figure | asked | holds | ms | sweeps | 1e6 states x sweeps / s |",
        "|---|--:|--:|---|--:|--:|--:|",
        *(row.line() for row in rows),
        "",
        "A ratio is the best run of the other solver over the median of ours, or a median over a median of ours.",
        f"The fastest library: {peer.label}, {peer.least:.4g} s." if peer else "The libraries were not measured.",
        f"The first time once more at the end: {100 * change:+.0f} % ({steady}).",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
