"""Compare the solvers of needleplan with those of other projects, on the same MDP, in one run.

The problem is the four-obstacle workspace with the costs of the thesis (1,176,120 states). Every solver runs in a
process of its own, one after another. Its values are compared with reference values that have a proven error bound.

    python benches/python/compare_peers.py --json peers.json     # everything, a few minutes on a quiet machine
    python benches/python/compare_peers.py --markdown peers.json # print the report of an earlier run
    python benches/python/compare_peers.py --spacing 4           # a small problem, as a short test run
    python benches/python/compare_peers.py --only lattice-1 quantecon-mpi
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import machine
import numpy as np
import report
from contest import Contestant, Result, measure
from contestants import CONTESTANTS, LATTICE
from problem import problem_of, reference_of, scenario_at


def main() -> int:
    """Run all contestants, or read an earlier record, and print the report.

    Returns the exit code: 1 if a claim does not hold on the full problem, else 0.
    """
    options = _options()
    earlier = options.markdown
    record = json.loads(earlier.read_text(encoding="utf-8")) if earlier else _record(options)
    if options.json:
        options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    print(report.text(record))
    return int(report.is_full(record) and report.fails(record))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacing", type=float, default=1.0, metavar="MM", help="grid spacing; the full problem has 1")
    parser.add_argument("--only", nargs="+", choices=list(CONTESTANTS), metavar="NAME", help=", ".join(CONTESTANTS))
    parser.add_argument("--time-limit", type=float, default=300.0, metavar="S", help="for each solver (default 300)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all measured values")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="print the report of a file that --json wrote")
    return parser.parse_args()


def _record(options: argparse.Namespace) -> dict[str, Any]:
    about = machine.description()
    chosen = [CONTESTANTS[name] for name in options.only or CONTESTANTS]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scenario = scenario_at(options.spacing)
        problem = problem_of(scenario)
        reference = reference_of(problem, scenario)
        problem.write(folder)
        scenario.write(folder / "scenario.toml")
        np.save(folder / "reference.npy", reference.values)
        results = _run(chosen, folder, options.time_limit)
    return {
        "machine": about,
        "spacing_mm": options.spacing,
        "states": scenario.states,
        "entries": len(problem.successors),
        "threshold": problem.threshold,
        "reference_error_bound": reference.error_bound,
        "results": [asdict(each) for each in results],
    }


def _run(chosen: Iterable[Contestant], folder: Path, time_limit: float) -> list[Result]:
    results = []
    for contestant in chosen:
        print(f"{contestant.label} ...", end=" ", file=sys.stderr, flush=True)
        result = measure(contestant, folder, time_limit)
        print(result.failure or f"{result.median:.4g} s", file=sys.stderr)
        results.append(result)
    if any(result.name == LATTICE.name for result in results):
        # Measured again at the end, to show whether the machine kept its speed.
        results.append(measure(LATTICE, folder, time_limit).renamed(report.AGAIN))
    return results


if __name__ == "__main__":
    sys.exit(main())
