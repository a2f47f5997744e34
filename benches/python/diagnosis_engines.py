"""Judge the diagnosis on data sets of all generators: one table, with counts and bounds.

PYTHONPATH=.:python python benches/python/diagnosis_engines.py --generator first --runs 80
PYTHONPATH=.:python python benches/python/diagnosis_engines.py --generator second --runs 200 --seed 7
PYTHONPATH=.:python python benches/python/diagnosis_engines.py --generator first --report   # the table alone

Generator `first` is tests/blind with its tuning seeds: `--seed` shuffles the cases. Generator `second` is
benches/python/second_generator.py: `--seed` is its seed. Generator `tuning_foreign` is
benches/python/tuning_foreign.py, and `tuning_base_laws` is benches/python/tuning_base_laws.py: `--seed` 1 and 2 are the
data sets of odd and of even numbers.
Each outcome is appended at once to a file of JSON lines, and a repeated command continues from that file. Outcomes of
other sources of the engine are ignored.
The first edition of the diagnosis, an engine with a chain of thresholds, is gone from the tree. To count it:

git worktree add PATH 57f842d && cd PATH     # build there, then
PYTHONPATH=.:python python benches/python/diagnosis_engines.py --engine first --generator first --runs 80
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import diagnosis_engines_case as cases
import diagnosis_engines_table as table
import machine
from diagnosis_benchmark import engine_digest


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--generator", choices=cases.GENERATORS, default="first")
    parser.add_argument("--runs", type=int, default=80, help="number of data sets")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--stratum", action="append", choices=cases.STRATA, help="only these strata; may be repeated")
    parser.add_argument("--motion", choices=("rich", "poor", "one_speed", "cycles"), help="only this kind of motion")
    parser.add_argument("--least", type=float, default=0.0, help="skip hidden effects of a smaller noncentrality")
    parser.add_argument("--outcomes", type=Path, help="file for outcomes (build/engines_GENERATOR_posterior.jsonl)")
    parser.add_argument("--report", action="store_true", help="print the table of the outcomes so far, run nothing")
    parser.add_argument("--markdown", type=Path, help="also write the table to this file")
    parser.add_argument("--verbose", action="store_true", help="print one line for each data set")
    given = parser.parse_args()
    path = given.outcomes or machine.ROOT / "build" / f"engines_{given.generator}_posterior.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    digest = engine_digest()
    known = {line["key"]: line for line in _lines(path) if line["digest"] == digest}
    lines = []
    bench = cases.EngineBench()
    with path.open("a", encoding="utf-8") as file:
        for case in cases.draw(given.generator, given.runs, given.seed, given.stratum, given.motion, given.least):
            line = known.get(case.key)
            if line is None and not given.report:
                line = bench.outcome(case) | {"digest": digest}
                file.write(json.dumps(line) + "\n")
                file.flush()
                if given.verbose:
                    print(table.one_line(line), file=sys.stderr, flush=True)
            if line is not None:
                lines.append(line)
    if not lines:
        sys.exit("no data set was diagnosed: nothing to report")
    text = table.page(lines, given.generator, given.seed)
    if given.markdown:
        given.markdown.write_text(text, encoding="utf-8")
    print(text)


def _lines(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the outcomes in a file; a truncated last line is skipped."""
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            yield json.loads(text)
        except json.JSONDecodeError:
            continue


if __name__ == "__main__":
    main()
