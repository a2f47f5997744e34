"""What a worker does: solves one scenario, writes its table into the store, and returns a record of the table."""

from __future__ import annotations

import json
import math
import os
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from needleplan.artifacts import version
from needleplan.errors import InputError, OutputError
from needleplan.planning import Outcome, PolicyTable, edge_profile, plan
from needleplan.planning import Path as Execution
from needleplan.scenario import Scenario

__all__ = [
    "TableTask",
    "TaskResult",
    "arc_points_mm",
    "clearance_mm",
    "record_of",
    "solve_on_worker",
    "solve_task",
]

# Digits of the success in the profile of an edge, which make up most of a record.
_PROFILE_DIGITS = 5

# Points of an arc at which its distance to the obstacles is measured.
_ARC_POINTS = 8


@dataclass(frozen=True)
class TableTask:
    """One table to make, as it is sent to a worker.

    `scenario` is the text of the scenario; `edge` and `start` (x_mm, y_mm, heading_deg) name the entries to record.
    """

    address: str
    scenario: str
    edge: str
    start: tuple[float, ...] | None
    folder: str
    identity: str
    version: str


@dataclass(frozen=True)
class TaskResult:
    """What a worker returns.

    Exactly one of the first four is not empty: the `record` of a table; `failed`, why the scenario has no table;
    `refused`, why this worker can make no table, so that another one must; `stopped`, why the store takes no table.
    `image` is the file of the table if the worker does not see the store.
    """

    record: dict[str, Any] | None = None
    failed: str = ""
    refused: str = ""
    stopped: str = ""
    image: bytes = b""


def solve_task(task: TableTask) -> TaskResult:
    """Make a table, or read it if its file is there, and return its record. Never raises for wrong input."""
    if version() != task.version:
        return TaskResult(refused=f"this worker has needleplan {version()}, not {task.version}")
    began, file = time.monotonic(), Path(task.folder) / "tables" / task.address[:2] / f"{task.address}.h5"
    try:
        shared = _sees_store(task)
        table = _finished(file) if shared else None
        solved = table is None
        if table is None:
            table = plan(Scenario.from_toml(task.scenario))
        record = record_of(table, task) | {"solved": solved}
    except MemoryError:
        return TaskResult(failed="the worker has not enough memory")
    except InputError as error:
        return TaskResult(failed=str(error))
    image = b""
    try:
        if not shared:
            image = _image(table)
        elif solved:
            file.parent.mkdir(exist_ok=True)
            table.write(file, compressed=True)
        size = len(image) or file.stat().st_size
    except (OutputError, OSError) as error:
        return TaskResult(stopped=str(error))
    return TaskResult(record | {"bytes": size, "worker_s": time.monotonic() - began, "at": time.time()}, image=image)


def solve_on_worker(task: TableTask) -> TaskResult:
    """Make a table as `solve_task` does, with one thread: a worker has a process, or a thread, for each processor."""
    os.environ.setdefault("RAYON_NUM_THREADS", "1")
    return solve_task(task)


def record_of(table: PolicyTable, task: TableTask) -> dict[str, Any]:
    """Return the numbers that describe a table: its best entry, the path from there, and how the solve went."""
    best = table.best_entry(task.edge)
    path, pose, profile = table.path(best), best.pose, edge_profile(table, task.edge)
    record: dict[str, Any] = {
        "table": task.address,
        "digest": table.digest,
        "edge": task.edge,
        "start": task.start,
        "success": best.success,
        "cost": best.value,
        "entry_x_mm": pose.x_mm,
        "entry_y_mm": pose.y_mm,
        "entry_heading_rad": pose.heading_rad,
        "entry_bevel": pose.bevel,
        "reached": path.outcome is Outcome.TARGET,
        "length_mm": path.length_mm,
        "rotations": len(path.turns),
        "clearance_mm": clearance_mm(path),
        "profile": {
            "position_mm": profile.position_mm.tolist(),
            "success": [round(each, _PROFILE_DIGITS) for each in profile.success.tolist()],
        },
        "status": str(table.stats.status),
        "states": table.scenario.states,
        "seconds": table.stats.seconds,
    }
    if task.start:
        x_mm, y_mm, heading_deg = task.start
        answer = table.lookup(table.start((x_mm, y_mm, math.radians(heading_deg))))
        record |= {"start_success": answer.success, "start_cost": answer.value}
    return record


def clearance_mm(path: Execution) -> float | None:
    """Return the smallest distance (mm) of a path without noise to an obstacle, or None without obstacles."""
    if not path.scenario.obstacles:
        return None
    import shapely

    line = shapely.linestrings(arc_points_mm(path.poses)) if len(path.poses) > 1 else shapely.points(path.poses[0, :2])
    return min(float(shapely.distance(each.region(), line)) for each in path.scenario.obstacles)


def arc_points_mm(poses: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return points (n, 2) on the arcs between poses (k, 4), whose headings are not wrapped.

    A chord of a circle has the mean direction of its ends, so the part f of an arc that turns by a has a chord of
    sin(f a / 2) / sin(a / 2) times the length of the whole one.
    """
    share = np.linspace(0, 1, _ARC_POINTS + 1)[1:]
    chord = np.diff(poses[:, :2], axis=0)
    half = np.diff(poses[:, 2]) / 2
    ratio = share * np.sinc(np.outer(half, share) / np.pi) / np.sinc(half / np.pi)[:, None]
    angle = np.arctan2(chord[:, 1], chord[:, 0])[:, None] + np.outer(half, share - 1)
    length = np.hypot(chord[:, 0], chord[:, 1])[:, None] * ratio
    inner = poses[:-1, None, :2] + np.stack([length * np.cos(angle), length * np.sin(angle)], axis=-1)
    return np.vstack([poses[:1, :2], inner.reshape(-1, 2)])


def _sees_store(task: TableTask) -> bool:
    """Return whether this worker sees the folder of the store, and not another folder of the same name."""
    try:
        with (Path(task.folder) / "atlas.jsonl").open(encoding="utf-8") as stream:
            return bool(json.loads(stream.readline())["identity"] == task.identity)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _finished(file: Path) -> PolicyTable | None:
    """Return the table in a file, or None if the file is missing or damaged; a damaged one is replaced."""
    try:
        return PolicyTable.read(file, isolated=False) if file.exists() else None
    except InputError:
        return None


def _image(table: PolicyTable) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "table.h5"
        table.write(file, compressed=True)
        return file.read_bytes()
