"""Replanning with a table set: the nearest stored table at once, the exact new one when it is computed."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor

from needleplan.control._replanning import FROM_TABLE_SET, Replanner
from needleplan.errors import NeedleplanError
from needleplan.planning import SpaceTask, Table
from needleplan.scenario import Scenario
from needleplan.sweep import CurvatureLookup, TableSetEntry

__all__ = ["TableSetReplanner"]

# States of all the tables that are read ahead: 450 MB of memory, since a table has at most 9 bytes a state.
_STATES_AHEAD = 50_000_000

_Reading = Future[Table]


class TableSetReplanner(Replanner):
    """Replanner that first returns the stored table with the nearest curvature, then a newly computed table.

    The stored table is used only if its curvature is nearer to the asked one than that of the present table. A thread
    reads the tables and verifies their digests. It begins when the replanner is made, with the curvatures nearest to
    that of the present table, so that the stored table is mostly in memory when it is asked for.

    Parameters
    ----------
    stored : CurvatureLookup
        Tables of a table set.
    table : Table
        The present table.
    fresh : Replanner
        Computes the new table.
    wait : bool
        Whether the first decision after a request waits for the stored table and uses it. Simulated time needs this.
    at : iterable of int, optional
        Numbers of the decisions at which a stored table is returned, as in a recording. Default: as soon as it is read.
    tell : callable, optional
        Called with a remark if a stored table cannot be read. Default: none.
    """

    def __init__(
        self,
        stored: CurvatureLookup,
        table: Table,
        fresh: Replanner,
        *,
        wait: bool,
        at: Iterable[int] | None = None,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._fresh, self._wait, self._tell = fresh, wait, tell
        self._decides_at = -1  # number of the decision that a stored table makes on simulated time
        self._at = None if at is None else sorted(at)
        self._present = table.scenario
        self._pool = ThreadPoolExecutor(1, "table set")
        self._readings: dict[str, tuple[TableSetEntry, _Reading]] = {}
        self._stored = stored
        self._read_ahead(stored.nearest_first(table.scenario))
        self._near: _Reading | None = None
        self._source = fresh.source

    @property
    def busy(self) -> bool:
        """Whether a new table was requested that `take` has neither returned nor reported as failed."""
        return self._fresh.busy

    @property
    def source(self) -> str:
        """Where the last table came from: "table set" or "replan"."""
        return self._source

    def ask(self, scenario: Scenario | SpaceTask) -> None:
        """Begin to compute a table for a scenario, and to read the nearest stored one if it is not yet read."""
        self._fresh.ask(scenario)
        self._near = None
        wanted = scenario.scenario if isinstance(scenario, SpaceTask) else scenario
        entry = self._stored.nearest(wanted, nearer_than=self._present)
        self._near = None if entry is None else self._reading(entry)

    def take(self, step: int) -> Table | None:
        """Return the stored table once, then the new table; None if there is none yet at decision number `step`.

        Raises NeedleplanError if planning failed.
        """
        if step == self._decides_at:
            return None
        near = self._take_near(step)
        if near is not None and self._wait:
            self._decides_at = step
        self._source = "replan" if near is None else FROM_TABLE_SET
        table = near or self._fresh.take(step)
        if table is not None:
            self._present = table.scenario
        if table is not None and near is None:
            self._near = None
        return table

    def close(self) -> None:
        """Wait until both threads have ended; their tables are not used."""
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._fresh.close()

    def _take_near(self, step: int) -> Table | None:
        if self._near is None:
            return None
        if self._at is not None:
            if step not in self._at:
                return None
        elif not (self._wait or self._near.done()):
            return None
        near, self._near = self._near, None
        try:
            return near.result()
        except NeedleplanError as error:  # a damaged table of the table set is no reason not to plan
            self._tell(f"the nearest table of the table set is not used: {error}")
            return None

    def _read_ahead(self, nearest_first: list[TableSetEntry]) -> None:
        states = 0
        for entry in nearest_first:
            states += entry.record["states"] if entry.record else 0
            if states > _STATES_AHEAD:
                return
            self._submit(entry)

    def _reading(self, entry: TableSetEntry) -> _Reading:
        """Return the reading of a table, which goes before all others that have not begun."""
        _, known = self._readings.get(_digest(entry), (entry, None))
        if known is not None and not known.cancel():
            return known
        waiting = [other for other, reading in list(self._readings.values()) if reading.cancel()]
        self._submit(entry)
        for other in waiting:
            if _digest(other) != _digest(entry):
                self._submit(other)
        return self._readings[_digest(entry)][1]

    def _submit(self, entry: TableSetEntry) -> None:
        self._readings[_digest(entry)] = entry, self._pool.submit(self._read, entry)

    def _read(self, entry: TableSetEntry) -> Table:
        table = self._stored.read(entry)
        _ = table.digest  # computed and kept here, so that the control loop need not wait for it
        return table


def _digest(entry: TableSetEntry) -> str:
    assert entry.record is not None  # the look-up holds made tables only
    return str(entry.record["digest"])
