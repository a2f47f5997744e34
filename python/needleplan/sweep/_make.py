"""Makes the tables of a sweep: finds out what is missing, runs it, and records what came of it."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from needleplan.artifacts import ShortRepr, version, write_whole
from needleplan.errors import InputError, Mistake, OutputError, SweepError
from needleplan.planning import PolicyTable, SpaceTable, Status
from needleplan.sweep._engine import Engine, run_tasks
from needleplan.sweep._points import SweepPoint, points_of
from needleplan.sweep._store import RecordWriter, TableSetStore, address_of
from needleplan.sweep._sweep import Keep, Sweep
from needleplan.sweep._swept_parameter import values_text
from needleplan.sweep._work import TableTask, TaskResult

__all__ = ["TableSetReport", "make_table_set"]


@dataclass
class TableSetReport(ShortRepr):
    """What a run of a sweep did.

    Attributes
    ----------
    points : int
        Number of combinations of values in this run, those that are no scenario included.
    present : int
        Tables that were there before.
    solved, read : int
        Tables that were solved, and tables without a record that were read.
    checked : int
        Tables that were there and were read for `check`, damaged ones included.
    unconverged : dict
        Number of tables, those that were there included, whose solve ended with another status than "converged", by
        status.
    failures : dict
        Why there is no table, by the values of the point as text.
    missing : int
        Tables that were not made because the cluster was lost.
    stopped : str
        Why the run was given up, such as a full disk; empty if it was not.
    bytes : int
        Size of the tables of this run that were solved.
    """

    points: int = 0
    present: int = 0
    solved: int = 0
    read: int = 0
    checked: int = 0
    unconverged: dict[str, int] = field(default_factory=dict)
    failures: dict[str, str] = field(default_factory=dict)
    missing: int = 0
    stopped: str = ""
    bytes: int = 0

    @property
    def complete(self) -> bool:
        """Whether every point has its table."""
        return not (self.failures or self.missing or self.stopped)


class _StoreFault(Exception):
    """The store cannot be written; the text says why."""


def make_table_set(
    sweep: Sweep,
    folder: str | os.PathLike[str],
    engine: Engine | None = None,
    *,
    part: tuple[int, int] = (1, 1),
    check: bool = False,
    progress: Callable[[int, int], None] = lambda *_: None,
    tell: Callable[[str], None] = lambda _: None,
) -> TableSetReport:
    """Make the tables of a sweep that the store does not have yet.

    Parameters
    ----------
    sweep : Sweep
        The sweep.
    folder : str or path
        Folder of the table set. It is made if it does not exist.
    engine : Engine, optional
        Where the tables are solved. Default: processes of this machine.
    part : tuple of int, default (1, 1)
        (k, n): make only the k-th of n parts of the tables, as a job array does. The parts do not overlap.
    check : bool, default False
        Whether the tables that are there are read, and damaged ones made again. Otherwise their sizes are compared.
    progress : callable, optional
        Called with the number of tables that have ended and that of all tables of this run.
    tell : callable, optional
        Called with remarks, such as workers that are not used.

    Returns
    -------
    TableSetReport
        Failures, lost clusters and full disks are part of the report. All finished tables stay; the next run makes the
        others.

    Raises
    ------
    SweepError
        If the sweep is too large, a key does not exist, the folder holds something else, or no cluster answers.
    ScenarioError
        If the scenario, the anatomy or a volume of the sweep cannot be read.
    OutputError
        If the folder cannot be written at first.

    Examples
    --------
    >>> import tempfile
    >>> from needleplan.sweep import Engine, Sweep, SweptParameter, make_table_set
    >>> radius = SweptParameter("needle.curvature_radius_mm", values=[35.0, 45.0])
    >>> grid = SweptParameter("grid.spacing_mm", values=[[4.0, 4.0]])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     report = make_table_set(Sweep("four_obstacles", [radius, grid]), folder, Engine(workers=0))
    >>> report.solved, report.failures
    (2, {})
    """
    problems = sweep.problems()
    sweep.require_finite(problems)
    points = list(points_of(sweep, problems))
    if all(point.scenario is None for point in points):
        first = f"with {values_text(points[0].values)}, {points[0].why}"
        raise SweepError(Mistake("parameter", "", f"no combination of values is a scenario: {first}"))
    store = TableSetStore.make(folder, sweep, points)
    tasks, report = _tasks(store, points, part)
    done, there = store.records(), store.there()
    if check:
        report.checked = _remove_damaged(store, tasks, there, tell)
    unlisted = len(there.keys() - {point.address for point in store.points})
    if unlisted:
        tell(f"{unlisted} tables of the folder belong to another sweep or version; they stay, but are not listed")
    missing = [task for task in tasks.values() if not _current(done.get(task.address), task, there)]
    # Runs that fill one folder at the same time begin at different tables, so that few are solved twice.
    begin = random.randrange(max(len(missing), 1))
    missing = missing[begin:] + missing[:begin]
    report.present = len(tasks) - len(missing)
    for address in tasks.keys() - {task.address for task in missing}:
        _count_status(report, done[address])
    finished, writer = report.present, RecordWriter(store)

    def deliver(task: TableTask, result: TaskResult) -> None:
        nonlocal finished
        if result.stopped:
            raise _StoreFault(result.stopped)
        if result.record is None:
            report.failures[_named(store, task.address)] = result.failed
        else:
            if result.image:
                path = store.table_path(task.address)
                path.parent.mkdir(exist_ok=True)
                write_whole(path, result.image)
            writer.append(result.record)
            _count_status(report, result.record)
            report.solved += bool(result.record["solved"])
            report.read += not result.record["solved"]
            report.bytes += int(result.record["bytes"]) if result.record["solved"] else 0
        finished += 1
        progress(finished, len(tasks))

    progress(finished, len(tasks))
    if missing:
        _require_writable(store, len(missing))
        try:
            report.missing = len(run_tasks(missing, engine or Engine(), deliver, tell))
        except (_StoreFault, OutputError, OSError) as fault:
            report.stopped = str(fault)
            report.missing = len(tasks) - finished
    return report


def _count_status(report: TableSetReport, record: dict[str, Any]) -> None:
    if record["status"] != Status.CONVERGED:
        report.unconverged[record["status"]] = report.unconverged.get(record["status"], 0) + 1


def _require_writable(store: TableSetStore, missing: int) -> None:
    for folder in ("tables", "records"):
        if not os.access(store.folder / folder, os.W_OK):
            rule = f"cannot be written (a read-only disk, or no permission), and {missing} of its tables are missing"
            raise OutputError(Mistake("", "", rule), os.fspath(store.folder))


def _tasks(
    store: TableSetStore, points: list[SweepPoint], part: tuple[int, int]
) -> tuple[dict[str, TableTask], TableSetReport]:
    """Return the tasks of a part by address, and a report with the points of the part that are no scenarios."""
    number, parts = part
    if not 1 <= number <= parts:
        raise SweepError(Mistake("array", f"{number}/{parts}", "must be K/N with K from 1 to N"))
    tasks: dict[str, TableTask] = {}
    report = TableSetReport(points=len(points[number - 1 :: parts]))
    folder, entry = os.path.abspath(store.folder), store.sweep.entry  # noqa: PTH100  workers need no resolved links
    for point in points[number - 1 :: parts]:
        if point.scenario is None:
            report.failures[values_text(point.values)] = point.why
            continue
        address = address_of(point.identity)
        keep = store.sweep.keep is Keep.TABLES
        tasks[address] = TableTask(
            address, point.scenario.to_toml(), str(entry.edge), entry.start, folder, store.identity, version(), keep
        )
    return tasks, report


def _remove_damaged(
    store: TableSetStore, tasks: dict[str, TableTask], there: dict[str, int], tell: Callable[[str], None]
) -> int:
    """Remove the table files of tasks that cannot be read whole, from the disk and from `there`.

    Returns the number of files that were read.
    """
    checked = sorted(tasks.keys() & there.keys())
    for address in checked:
        path = store.table_path(address)
        try:
            (SpaceTable if store.sweep.in_space else PolicyTable).read(path)
        except InputError as error:
            tell(f"made again: {error}")
            path.unlink()
            del there[address]
    return len(checked)


def _current(record: dict[str, object] | None, task: TableTask, there: dict[str, int]) -> bool:
    """Return whether a table is there, has the recorded size, and is recorded for the entries of the task."""
    if record is None or (task.keep and there.get(task.address) != record.get("bytes")):
        return False
    start = list(task.start) if task.start else None
    return (record.get("edge"), record.get("start")) == (task.edge, start)


def _named(store: TableSetStore, address: str) -> str:
    return next((values_text(point.values) for point in store.points if point.address == address), address)
