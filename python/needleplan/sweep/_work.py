"""What a worker does: solves one scenario, writes its table into the store, and returns a record of the table.

Numbers that describe a table: its best entry, the path from there, and how the solve went.
"""

from __future__ import annotations

import json
import math
import os
import tempfile
import time
from dataclasses import dataclass
from functools import singledispatch
from pathlib import Path
from typing import Any

from needleplan.anatomy import AnatomyFile
from needleplan.artifacts import version
from needleplan.errors import InputError, OutputError
from needleplan.planning import Outcome, PolicyTable, SpaceTable, Table, edge_profile, entry_map, plan
from needleplan.scenario import Scenario

__all__ = ["TableTask", "TaskResult", "record_of", "solve_on_worker", "solve_task"]


# Digits of the success in the profile of an edge, which make up most of a record.
_PROFILE_DIGITS = 5


@singledispatch
def record_of(table: Table, edge: str, start: tuple[float, ...] | None) -> dict[str, Any]:
    """Return the record of a table.

    Parameters
    ----------
    table : Table
        The table.
    edge : str
        The edge of the plane whose best entry is described.
    start : tuple of float, optional
        A fixed pose in the plane (x_mm, y_mm, heading_deg) whose success is recorded too.

    Returns
    -------
    dict
        Numbers by name, with the unit in the name; the best entry in 3D in RAS mm.
    """
    raise NotImplementedError(type(table))


@record_of.register(PolicyTable)
def _plane_record(table: PolicyTable, edge: str, start: tuple[float, ...] | None) -> dict[str, Any]:
    profile = edge_profile(table, edge)
    best = profile.best or table.best_entry(edge)  # which says that all positions are in obstacles
    path, pose = table.path(best), best.pose
    record: dict[str, Any] = {
        "digest": table.digest,
        "success": best.success,
        "cost": best.value,
        "entry_x_mm": pose.x_mm,
        "entry_y_mm": pose.y_mm,
        "entry_heading_rad": pose.heading_rad,
        "entry_bevel": pose.bevel,
        "reached": path.outcome is Outcome.TARGET,
        "length_mm": path.length_mm,
        "turns": len(path.turns),
        "clearance_mm": path.clearance_mm if path.scenario.obstacles else None,
        "profile": {
            "position_mm": profile.position_mm.tolist(),
            "success": [round(probability, _PROFILE_DIGITS) for probability in profile.success.tolist()],
        },
        "status": str(table.stats.status),
        "states": table.scenario.states,
        "seconds": table.stats.seconds,
    }
    if start:
        x_mm, y_mm, heading_deg = start
        answer = table.lookup(table.start((x_mm, y_mm, math.radians(heading_deg))))
        record |= {"start_success": answer.success, "start_cost": answer.value}
    return record


@record_of.register(SpaceTable)
def _space_record(table: SpaceTable, *_: object) -> dict[str, Any]:
    entries = entry_map(table)
    first = entries.first()
    best = entries.entry(first)
    names = ("entry_r_mm", "entry_a_mm", "entry_s_mm", "direction_r", "direction_a", "direction_s")
    return {
        "digest": table.digest,
        **best.success.record(),
        "cost": float(entries.value[first]),
        **dict(zip(names, [*best.position_mm, *best.direction], strict=True)),
        "reached": best.reached,
        "length_mm": best.length_mm,
        "turns": best.turns,
        "clearance_mm": best.clearance_mm,
        "shift_cost": best.shift_cost,
        "tilt_cost": best.tilt_cost,
        "impossible": entries.impossible,
        "status": str(table.stats.status),
        "states": table.stats.states,
        "seconds": table.stats.seconds,
    }


@dataclass(frozen=True)
class TableTask:
    """One table to make, as it is sent to a worker.

    `scenario` is the text of the scenario or anatomy file; `edge` and `start` (x_mm, y_mm, heading_deg) name the
    entries to record. If not `keep`, the record is all that is wanted.
    """

    address: str
    scenario: str
    edge: str
    start: tuple[float, ...] | None
    folder: str
    identity: str
    version: str
    keep: bool = True


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
            table = _solved(task.scenario)
        asked = {"table": task.address, "edge": task.edge, "start": task.start}
        record = asked | record_of(table, task.edge, task.start) | {"solved": solved}
    except MemoryError:
        return TaskResult(failed="the worker has not enough memory")
    except InputError as error:
        return TaskResult(failed=str(error))
    image, size = b"", 0
    try:
        if task.keep and not shared:
            image = _image(table)
        elif task.keep and solved:
            file.parent.mkdir(exist_ok=True)
            table.write(file, compressed=True, force=True)
        if task.keep:
            size = len(image) or file.stat().st_size
    except (OutputError, OSError) as error:
        return TaskResult(stopped=str(error))
    return TaskResult(record | {"bytes": size, "worker_s": time.monotonic() - began, "at": time.time()}, image=image)


def solve_on_worker(task: TableTask) -> TaskResult:
    """Make a table as `solve_task` does, with one thread: a worker has a process, or a thread, for each processor."""
    os.environ.setdefault("RAYON_NUM_THREADS", "1")
    return solve_task(task)


def _solved(text: str) -> Table:
    if f'schema = "{AnatomyFile.schema}"' not in text.split("[", 1)[0]:
        return plan(Scenario.from_toml(text))
    return plan(AnatomyFile.from_toml(text))


def _sees_store(task: TableTask) -> bool:
    """Return whether this worker sees the folder of the store, and not another folder of the same name."""
    try:
        with (Path(task.folder) / "tables.jsonl").open(encoding="utf-8") as stream:
            return bool(json.loads(stream.readline())["identity"] == task.identity)
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _finished(file: Path) -> Table | None:
    """Return the table in a file, or None if the file is missing or damaged; a damaged one is replaced."""
    try:
        if not file.exists():
            return None
        return Table.read(file)
    except (InputError, OSError):
        return None


def _image(table: Table) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "table.h5"
        table.write(file, compressed=True, force=True)
        return file.read_bytes()
