"""Measure the waiting times of a user: one look-up, many look-ups, reading a table, and the command `plan`.

python benches/python/lookup.py --json lookup.json
python benches/python/lookup.py --spacing 4            # short test run
"""

import argparse
import json
import subprocess
import sys
import tempfile
import timeit
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import machine
import numpy as np
from problem import scenario_at

import needleplan as npl
from needleplan.planning import lattice_of

# Number of poses in one call of `lookup_many`.
POSES = 4_000_000


def main() -> int:
    """Run all measurements and print a table; with --json, write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacing", type=float, default=1.0, metavar="MM")
    parser.add_argument("--scenario", default="four_obstacles", metavar="NAME")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about = machine.description()
    scenario = scenario_at(options.spacing, options.scenario)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scenario.write(folder / "scenario.toml")
        table = npl.plan(scenario)
        figures = {**lookups(table), **files(table, folder), **stages(scenario), **shell(folder)}
    width = max(map(len, figures))
    print(f"{scenario.title}: {scenario.states:,} states, {scenario.grid.transition}\n")
    for name, value in figures.items():
        print(f"{name:{width}}  {value:12.4g}")
    if options.json:
        record = {"machine": about, "scenario": options.scenario, "states": scenario.states, "figures": figures}
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return 0


def lookups(table: npl.PolicyTable) -> dict[str, float]:
    """Return the time of one look-up from Python (us), and the rate of many (million poses per second)."""
    workspace = table.scenario.workspace
    random = np.random.default_rng(0)
    poses = random.uniform((0, 0, -np.pi, 0), (workspace.width_mm, workspace.height_mm, np.pi, 1), (POSES, 4))
    poses[:, 3] = np.where(poses[:, 3] < 0.5, -1.0, 1.0)
    one = (*poses[0, :3].tolist(), int(poses[0, 3]))
    calls = 2000
    single = median(timeit.repeat(lambda: table.lookup(*one), number=calls, repeat=9)) / calls
    return {
        "lookup, one call, us": 1e6 * single,
        "lookup_many, million poses a second": POSES / 1e6 / timed(lambda: table.lookup_many(poses), 7),
    }


def files(table: npl.PolicyTable, folder: Path) -> dict[str, float]:
    """Write and read the table; return both times (ms). The file is in the cache of the operating system."""
    file = folder / "table.h5"
    written = timed(lambda: table.write(file, force=True), 5)
    return {
        "table, MB": file.stat().st_size / 1e6,
        "table write, ms": 1e3 * written,
        "table read, ms": 1e3 * timed(lambda: npl.PolicyTable.read(file), 9),
    }


def stages(scenario: npl.Scenario) -> dict[str, float]:
    """Return the times (ms) of the stages of a plan, in a running Python process."""
    solver = scenario.solver
    lattice = lattice_of(scenario)

    def solve() -> Any:
        return lattice.solve(
            method="sweep", partitions=solver.partitions, priority="H2", tolerance=solver.tolerance, threads=None
        )

    policy = solve()["policy"]
    return {
        "plan: geometry, ms": 1e3 * timed(lambda: lattice_of(scenario), 9),
        "plan: solve and policy, ms": 1e3 * timed(solve, 9),
        "plan: success, ms": 1e3 * timed(lambda: lattice.success(policy=policy), 9),
        "plan: all of it, ms": 1e3 * timed(lambda: npl.plan(scenario), 9),
    }


def shell(folder: Path) -> dict[str, float]:
    """Return the times (ms) of the command `plan` from the shell, and of the start of Python and its imports."""

    def process(*arguments: str) -> Callable[[], object]:
        return lambda: subprocess.run([sys.executable, *arguments], cwd=folder, capture_output=True, check=True)

    command = ("-m", "needleplan", "plan", "scenario.toml", "--json")
    whole = ("-m", "needleplan", "plan", "scenario.toml", "--json", "-o", "out.h5", "--force")
    return {
        "shell: python alone, ms": 1e3 * timed(process("-c", ""), 7),
        "shell: python and its imports, ms": 1e3 * timed(process("-c", "import needleplan.planning"), 7),
        "shell: plan, ms": 1e3 * timed(process(*command), 7),
        "shell: plan -o, ms": 1e3 * timed(process(*whole), 7),
    }


def timed(work: Callable[[], object], repeats: int) -> float:
    """Return the median time (s) of `work`, after one run that is not timed."""
    work()
    seconds = []
    for _ in range(repeats):
        began = perf_counter()
        work()
        seconds.append(perf_counter() - began)
    return median(seconds)


if __name__ == "__main__":
    sys.exit(main())
