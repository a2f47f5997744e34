"""Measure a table set: overhead a table, two workers beside one, size of the folder, and a model of many workers.

python benches/python/table_set.py --json benches/results/table_set.json > benches/results/table_set.md
python benches/python/table_set.py --tables 200        # short test run

All tables are those of the shipped scenario `four_obstacles` on a grid of 4 mm, over random radii and costs. The
scheduler of local processes runs in the process of the command, so its processor time is the work that is not
distributed: t_central a table. With n workers, a run of N tables of t_worker each takes at least
max(N t_worker / n, N t_central).
"""

import argparse
import json
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import machine

from needleplan.sweep import Engine, Sweep, SweptParameter, TableSet, make_table_set

# Number of tables of the runs that compare one worker with two: enough for a ratio within some percent.
_COMPARED = 600
# Tables at the beginning of a run that are left out, while processes start and load.
_WARM_UP = 40
_MODELLED = (1, 2, 10, 30, 100, 300)


@dataclass(frozen=True)
class Run:
    """One run: times in s, sizes in bytes. Rates are those after the warm-up."""

    tables: int
    workers: int
    seconds: float
    seconds_a_table: float
    worker_seconds_a_table: float
    central_seconds_a_table: float
    bytes_a_table: float
    states: int


def sweep_of(tables: int) -> Sweep:
    """Return a sweep of so many tables."""
    return Sweep(
        "four_obstacles",
        [
            SweptParameter("needle.curvature_radius_mm", low=30.0, high=90.0),
            SweptParameter("objective.rotation", low=1.0, high=64.0, scale="log"),
            SweptParameter("grid.spacing_mm", values=[[4.0, 4.0]]),
        ],
        design="sampled",
        samples=tables,
        seed=1,
    )


def measured(tables: int, workers: int, folder: Path) -> Run:
    """Make a table set in a new folder."""
    warm: list[float] = []

    def progress(done: int, of: int) -> None:
        if done == min(_WARM_UP, of):
            warm[:] = [time.perf_counter(), time.process_time()]

    began = time.perf_counter()
    report = make_table_set(sweep_of(tables), folder, Engine(workers=workers), progress=progress)
    ended, central = time.perf_counter(), time.process_time()
    if not report.complete or report.solved != tables:
        raise SystemExit(f"the run is not complete: {report}")
    records = [each.record for each in TableSet.open(folder) if each.record]
    rest = tables - min(_WARM_UP, tables)
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    return Run(
        tables, workers, ended - began, (ended - warm[0]) / rest, sum(each["worker_s"] for each in records) / tables,
        (central - warm[1]) / rest, size / tables, records[0]["states"],
    )  # fmt: skip


def page(runs: list[Run], whole: Run, about: dict[str, object]) -> str:
    """Return the Markdown page."""
    lines = [
        "# A table set: overhead, workers, size",
        "",
        f"Commit {about['commit']}, {about['processor']}, load before {about['load_before']}.",
        f"Tables of {whole.states:,} states. Overhead: time of a table in the run, times the number of workers, less",
        "the time in the worker. Central: processor time of scheduler and command together, a table.",
        "",
        "| workers | tables | time | tables a second | in the worker | overhead | central | table in the folder |",
        "|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for run in [*runs, whole]:
        overhead = run.seconds_a_table * run.workers - run.worker_seconds_a_table
        cells = (
            f"{run.workers}",
            f"{run.tables:,}",
            f"{run.seconds:.1f} s",
            f"{1 / run.seconds_a_table:.1f}",
            f"{1e3 * run.worker_seconds_a_table:.1f} ms",
            f"{1e3 * overhead:.1f} ms",
            f"{1e3 * run.central_seconds_a_table:.2f} ms",
            f"{run.bytes_a_table / 1e3:.0f} kB",
        )
        lines.append(f"| {' | '.join(cells)} |")
    one, two = (next(run for run in runs if run.workers == count) for count in (1, 2))
    lines += ["", f"Two workers are {one.seconds_a_table / two.seconds_a_table:.2f} times one.", ""]
    lines += ["## Many workers: a model", ""]
    lines += [
        "Time of 10,000 tables by max(N t_worker / n, N t_central), for these tables and for tables of 1 s. The model",
        "leaves out the network, a shared disk, memory, and workers of different speed. Measured with two workers.",
        "t_central contains what the event loops use while they wait, so the limit is rather too low.",
        "",
        "| workers | these tables | tables of 1 s |",
        "|--:|--:|--:|",
    ]
    central = whole.central_seconds_a_table
    for count in _MODELLED:
        cells = tuple(
            f"{max(1e4 * each / count, 1e4 * central):,.0f} s" for each in (whole.worker_seconds_a_table, 1.0)
        )
        lines.append(f"| {count} | {' | '.join(cells)} |")
    limit = whole.worker_seconds_a_table / central
    lines += [
        "",
        f"More than {limit:.0f} workers are of no use for these tables, more than {1 / central:.0f} for tables of 1 s.",
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure, and print the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=int, default=10_000)
    parser.add_argument("--json", metavar="FILE")
    options = parser.parse_args()
    runs, about = [], machine.description()
    with tempfile.TemporaryDirectory() as folder:
        for number, workers in enumerate((1, 2, 1, 2)):
            run = measured(min(_COMPARED, options.tables), workers, Path(folder) / str(number))
            print(asdict(run), file=sys.stderr, flush=True)
            runs.append(run)
        best = [
            min((run for run in runs if run.workers == count), key=lambda run: run.seconds_a_table) for count in (1, 2)
        ]
        whole = measured(options.tables, 2, Path(folder) / "whole")
    print(page(best, whole, about))
    if options.json:
        record: dict[str, Any] = {"machine": about, "runs": [asdict(run) for run in [*runs, whole]]}
        Path(options.json).write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
