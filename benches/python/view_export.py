"""How long `needleplan view ANATOMY --export` takes, and what for.

python benches/python/view_export.py > benches/results/view_export.md
python benches/python/view_export.py --kinds brain     # short test run

The anatomies are those of `needleplan new --seed 3`. Processor times count all threads, so that other programs change
them little; two free processors need about half of them.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import machine

from needleplan.anatomy import PHANTOMS, Anatomy, SpaceScenario, write_phantom
from needleplan.page import SpacePage
from needleplan.planning import plan_space, rank_entries

SEED, ENTRIES, DRAWN = 3, 20, 40


def spent_s(work: Callable[[], object]) -> float:
    """Return the processor time of a call."""
    began = time.process_time()
    work()
    return time.process_time() - began


def row(kind: str) -> tuple[int, list[float]]:
    """Return the states of a phantom, and the processor times (s) of the export and of its parts."""
    with tempfile.TemporaryDirectory() as folder:
        anatomy = Anatomy.read(write_phantom(kind, Path(folder), SEED))
    page = spent_s(lambda: SpacePage(SpaceScenario.of(anatomy), "anatomy.toml", anatomy).page({}))
    solve = spent_s(lambda: plan_space(SpaceScenario.of(anatomy)))
    entries = rank_entries(anatomy)
    best = entries.best(ENTRIES)
    estimates = spent_s(lambda: [entries.estimate(number) for number in best])
    drawn = spent_s(lambda: [entries.table.executions(entries.poses[number], DRAWN) for number in best])
    return entries.table.stats.states, [page, solve, estimates, drawn]


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", choices=PHANTOMS, default=list(PHANTOMS))
    options, of = parser.parse_args(), machine.description()
    print("# The export of a 3D page\n")
    print(f"{of['processor']}, {of['threads']} threads, commit {of['commit']}, {of['date']}, load {of['load_before']}.")
    print(f"Phantoms with the seed {SEED}; processor time of all threads, s.\n")
    print(f"| phantom | states | export | solve | {ENTRIES} estimates | {ENTRIES} times {DRAWN} drawn executions |")
    print("|---|--:|--:|--:|--:|--:|")
    for kind in options.kinds:
        states, times = row(kind)
        print(f"| {kind} | {states:,} | {' | '.join(f'{each:.1f}' for each in times)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
