"""One thread that solves scenarios for all tabs of the page; of each tab, the newest request wins."""

from __future__ import annotations

import threading
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import dataclass, field

from needleplan.planning import PolicyTable, plan
from needleplan.scenario import Scenario

__all__ = ["PlanQueue", "Superseded"]

# Largest total number of states of the kept tables; a state takes 9 bytes.
_MOST_KEPT_STATES = 60_000_000


class Superseded(Exception):
    """A newer request of the same tab has replaced a request."""


@dataclass
class _Job:
    """A scenario to solve, and the future of its table."""

    scenario: Scenario
    table: Future[PolicyTable] = field(default_factory=Future)
    superseded: bool = False

    def progress(self, *_: float) -> None:
        """Abandon the solve if a newer request has replaced this one."""
        if self.superseded:
            raise Superseded


class PlanQueue:
    """Solves scenarios in a thread of its own, and keeps the tables that were used last.

    A tab has at most one request. A new request of the tab replaces one that waits, and interrupts one that is being
    solved.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: OrderedDict[str, _Job] = OrderedDict()
        self._running: tuple[str, _Job] | None = None
        self._tables: OrderedDict[str, PolicyTable] = OrderedDict()
        self._closed = False
        threading.Thread(target=self._work, name="needleplan solver", daemon=True).start()

    def submit(self, tab: str, scenario: Scenario) -> Future[PolicyTable]:
        """Request the table of a scenario for a tab.

        The future has the table, or raises Superseded if the tab has a newer request, or InputError.
        """
        with self._changed:
            job = _Job(scenario)
            self._supersede(tab)
            kept = self._kept(scenario.digest)
            if kept is not None:
                job.table.set_result(kept)
            else:
                self._waiting[tab] = job
                self._changed.notify()
            return job.table

    def find(self, digest: str) -> PolicyTable | None:
        """Return the kept table of the scenario with this digest, or None."""
        with self._changed:
            return self._kept(digest)

    def keep(self, table: PolicyTable) -> None:
        """Keep a table, so that a request for its scenario needs no solve. The oldest tables make room."""
        with self._changed:
            self._tables[table.scenario.digest] = table
            while len(self._tables) > 1 and sum(kept.values.size for kept in self._tables.values()) > _MOST_KEPT_STATES:
                self._tables.popitem(last=False)

    def forget(self) -> None:
        """Drop all kept tables, so that every later request is solved again."""
        with self._changed:
            self._tables.clear()

    def close(self) -> None:
        """Interrupt the solve and end the thread."""
        with self._changed:
            self._closed = True
            for tab in [*self._waiting, *([self._running[0]] if self._running else [])]:
                self._supersede(tab)
            self._changed.notify()

    def _kept(self, digest: str) -> PolicyTable | None:
        if digest in self._tables:
            self._tables.move_to_end(digest)
        return self._tables.get(digest)

    def _supersede(self, tab: str) -> None:
        waiting = self._waiting.pop(tab, None)
        if waiting and waiting.table.set_running_or_notify_cancel():
            waiting.table.set_exception(Superseded())
        if self._running and self._running[0] == tab:
            self._running[1].superseded = True

    def _work(self) -> None:
        while True:
            with self._changed:
                self._running = None
                while not self._waiting and not self._closed:
                    self._changed.wait()
                if self._closed:
                    return
                tab, job = self._waiting.popitem(last=False)
                self._running = tab, job
            self._solve(job)

    def _solve(self, job: _Job) -> None:
        if not job.table.set_running_or_notify_cancel():
            return
        try:
            # A request before this one may have been for the same scenario.
            table = self.find(job.scenario.digest) or plan(job.scenario, job.progress)
            self.keep(table)
        except BaseException as error:  # the thread must go on
            job.table.set_exception(error)
        else:
            job.table.set_result(table)
