"""Compare the success that users are told with what is realised in the voxels of their file.

PYTHONPATH=. python benches/python/space_truth.py --json benches/results/space_truth.json \
    > benches/results/space_truth.md
PYTHONPATH=. python benches/python/space_truth.py --seeds 3 --kinds "foreign brain" --random 2 --runs 200  # short

Anatomies: the four of `needleplan new --anatomy` as shipped, and three foreign ones of `tests/blind`, made from the
reference of the file format alone. A foreign file has no [lattice] and no margin; with an even seed its needle has
gauge 20, with an odd one no thickness. Entries: the first of the ranked list, and random ones: a place in the voxel of
a random entry point, with a direction tilted by up to 12 degrees from the line to the target. A random entry counts if
it can succeed: predicted above 0.5 %, or one of 200 other executions does.

Told: `estimate`. Realised: the share of executions (`SpaceTable.executions`) that succeed by a judge that shares no
code with the planner, `tests/blind/voxel_tracer.py`: the path, in RAS, meets the target of the file before the needle,
with the diameter and the margin of the file, touches a voxel of an obstacle. Every entry has seeds of its own.
"""

import argparse
import itertools
import json
import multiprocessing
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import machine
import numpy as np
import space_truth_report as report
from numpy.typing import NDArray
from space_starts import drawn

from needleplan.anatomy import PHANTOMS, Anatomy, write_phantom
from needleplan.planning import EntryMap, SpacePaths, SpaceTable, rank_entries
from tests.blind.foreign_anatomies import Organ, foreign_anatomy
from tests.blind.volume_files import FiledAnatomy, read_anatomy
from tests.blind.voxel_tracer import Path as TracedPath
from tests.blind.voxel_tracer import trace

# Predicted success below which a random entry is tried with pilot executions before it counts, and their number.
DOUBT, PILOT_RUNS = 0.005, 200
# Gauge of the needle in foreign anatomies with an even seed.
GAUGE = 20


@dataclass(frozen=True)
class Verdicts:
    """What the judge says of paths, each (n,)."""

    success: NDArray[np.bool_]  # meets the target before the needle or its margin touches an obstacle
    touches: NDArray[np.bool_]  # the needle or its margin touches an obstacle anywhere
    ends_in_target: NDArray[np.bool_]


@dataclass(frozen=True)
class TruthEntry:
    """An entry, what is told of it, and what the judge sees."""

    listed: bool
    entry_mm: tuple[float, ...]  # RAS
    direction: tuple[float, ...]  # RAS
    told: float
    interval: tuple[float, float]
    table: float
    realised: float
    reached: float  # share that the executions count as reached
    reached_and_touch: int
    reached_and_end_beside: int
    missed: int  # successes that the executions do not count as reached
    path_touches: bool  # the path without noise


@dataclass(frozen=True)
class TruthAnatomy:
    """An anatomy, what its plan cost, and its entries. Memory: the peak of a process that plans and does no more."""

    name: str
    seed: int
    diameter_mm: float
    voxels: int  # of the file
    spacing_mm: float
    states: int
    seconds: float
    processor_s: float
    memory_mb: float
    runs: int
    entries: tuple[TruthEntry, ...]


def until(points: NDArray[np.float64], length_mm: float) -> NDArray[np.float64]:
    """Return the part of a polyline (n, 3) up to a length."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    end = [np.interp(length_mm, lengths, points[:, axis]) for axis in range(3)]
    return np.vstack([points[lengths < length_mm], end])


def judged(file: FiledAnatomy, paths: list[NDArray[np.float64]]) -> Verdicts:
    """Return what the file says of polylines (n, 3) in RAS mm."""
    traces = trace(file.volume, [TracedPath(each) for each in paths], file.target, file.cleared_mm, reach_mm=0.0)
    success = np.isfinite(traces.target_mm) & (traces.target_mm < traces.first_mm)
    touches = traces.touches | traces.body_overlaps
    # What the needle touches after it has met the target does not count against it.
    doubtful = np.flatnonzero(success & touches)
    if doubtful.size and file.cleared_mm > 0.0:
        parts = [TracedPath(until(paths[number], traces.target_mm[number])) for number in doubtful]
        success[doubtful] = ~trace(file.volume, parts, None, file.cleared_mm, reach_mm=0.0).body_overlaps
    return Verdicts(success, touches, traces.ends_in_target)


def polylines(table: SpaceTable, paths: SpacePaths) -> list[NDArray[np.float64]]:
    """Return the positions of executions in RAS mm."""
    return [table.scenario.grid.frame.world(paths.points(run)) for run in range(len(paths.reached))]


def entry_of(
    found: EntryMap, file: FiledAnatomy, pose: tuple[float, ...], listed: int | None, runs: int, seed: int
) -> TruthEntry:
    """Judge an entry; `listed` is its number in the map, None if it is a random one."""
    table, frame = found.table, found.grid.frame
    told = table.estimate(pose) if listed is None else found.estimate(listed)
    executions = table.executions(pose, runs=runs, seed=seed)
    verdicts = judged(file, polylines(table, executions))
    ends = frame.world(np.array([pose[:3], np.add(pose[:3], pose[3:])]))
    return TruthEntry(
        listed is not None,
        tuple(ends[0].round(4).tolist()),
        tuple((ends[1] - ends[0]).round(6).tolist()),
        told.value,
        told.interval or (0.0, 1.0),
        table.lookup(pose).success if listed is None else float(found.success[listed]),
        float(verdicts.success.mean()),
        float(executions.reached.mean()),
        int((executions.reached & verdicts.touches).sum()),
        int((executions.reached & ~verdicts.ends_in_target).sum()),
        int((~executions.reached & verdicts.success).sum()),
        bool(judged(file, [frame.world(table.path(pose).points_mm)]).touches[0]),
    )


def planned(file: Path) -> tuple[EntryMap, float, float, float]:
    """Return the map of entries, seconds, processor time (s), and the peak memory (MB) of this process until then."""
    began, processor = time.perf_counter(), time.process_time()
    found = rank_entries(Anatomy.read(file))
    spent = time.perf_counter() - began, time.process_time() - processor
    # Not ru_maxrss, which begins with the memory of the process that started this one.
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return found, *spent, int(status.split("VmHWM:")[1].split()[0]) / 1e3


def judged_anatomy(file: Path, name: str, seed: int, listed: int, drawings: int, runs: int) -> TruthAnatomy:
    """Plan an anatomy, and judge listed and random entries."""
    found, *cost = planned(file)
    truth = read_anatomy(file)
    poses: list[tuple[tuple[float, ...], int | None]] = [
        (tuple(found.poses[number].tolist()), number) for number in found.best(listed)
    ]
    random = np.random.default_rng([11, seed])
    wanted = len(poses) + drawings
    while len(poses) < wanted:
        pose = drawn(found.table, random)
        hopeless = found.table.lookup(pose).success < DOUBT
        if hopeless and not found.table.rollout(pose, runs=PILOT_RUNS, seed=3).success:
            continue
        poses.append((pose, None))
    entries = tuple(
        entry_of(found, truth, pose, number, runs, 2000 + 100 * seed + place)
        for place, (pose, number) in enumerate(poses)
    )
    return TruthAnatomy(
        name, seed, truth.diameter_mm, truth.volume.labels.size, found.grid.frame.spacing_mm, found.stats["states"],
        *cost, runs, entries,
    )  # fmt: skip


def written(name: str, seed: int, folder: Path) -> Path:
    """Write an anatomy, "lung" or "foreign lung", into a folder; return its file."""
    if name.startswith("foreign "):
        return foreign_anatomy(name.split()[1], seed).write(folder, None if seed % 2 else GAUGE)
    return write_phantom(name, folder, seed)


def main() -> None:
    """Judge all anatomies and print the report; with --json, write the entries."""
    kinds = [*PHANTOMS, *(f"foreign {organ}" for organ in Organ)]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", default=kinds, choices=kinds, metavar="KIND", help=", ".join(kinds))
    parser.add_argument("--seeds", nargs="+", type=int, default=[101, 102], help="seeds of each kind (101 102)")
    parser.add_argument("--listed", type=int, default=5, help="listed entries of each anatomy (5)")
    parser.add_argument("--random", type=int, default=6, help="random entries of each anatomy (6)")
    parser.add_argument("--runs", type=int, default=1000, help="executions of each entry (1,000)")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    about, rows = machine.description(), list[dict[str, Any]]()
    for seed, name in itertools.product(options.seeds, options.kinds):
        # A process for each anatomy: the peak memory is that of one plan.
        with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(
            1, mp_context=multiprocessing.get_context("spawn")
        ) as pool:  # fmt: skip
            file = written(name, seed, Path(folder))
            task = pool.submit(judged_anatomy, file, name, seed, options.listed, options.random, options.runs)
            rows.append(asdict(task.result()))
        if options.json:  # after each anatomy: a run that is stopped keeps what it has
            record = {"machine": about, "anatomies": rows}
            options.json.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
        print(f"{name} {seed}", file=sys.stderr)
    print(report.text(about, rows))


if __name__ == "__main__":
    main()
