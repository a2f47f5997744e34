"""Replanning with an atlas: the nearest stored table at once, the exact new one when it is computed."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor

from needleplan.atlas import Atlas, CurvatureLookup
from needleplan.control._replanning import Replanner
from needleplan.errors import NeedleplanError
from needleplan.planning import PolicyTable, SpaceTable, SpaceTask
from needleplan.scenario import Scenario

__all__ = ["AtlasReplanner"]


class AtlasReplanner(Replanner):
    """Replanner that first returns the table of an atlas with the nearest curvature, then a newly computed table.

    The stored table is used only if its curvature is nearer to the asked one than that of the present table. A thread
    reads it and verifies its digest.

    Parameters
    ----------
    atlas : Atlas
        Stored tables.
    table : PolicyTable or SpaceTable
        The present table.
    fresh : Replanner
        Computes the new table.
    wait : bool
        Whether the first decision after a request waits for the stored table, as simulated time needs it.
    at : iterable of int, optional
        Numbers of the decisions at which a stored table is returned, as in a recording. Default: as soon as it is read.
    """

    def __init__(
        self,
        atlas: Atlas,
        table: PolicyTable | SpaceTable,
        fresh: Replanner,
        *,
        wait: bool,
        at: Iterable[int] | None = None,
    ) -> None:
        self._lookup = CurvatureLookup(atlas)
        self._fresh, self._wait = fresh, wait
        self._at = None if at is None else sorted(at)
        self._curvature_per_mm = 1 / table.scenario.needle.curvature_radius_mm
        self._pool = ThreadPoolExecutor(1, "atlas")
        self._near: Future[PolicyTable | SpaceTable | None] | None = None
        self._source = fresh.source

    @property
    def busy(self) -> bool:
        """Whether a new table was requested that `take` has neither returned nor reported as failed."""
        return self._fresh.busy

    @property
    def source(self) -> str:
        """Where the last table came from: "atlas" or "replan"."""
        return self._source

    def ask(self, scenario: Scenario | SpaceTask) -> None:
        """Begin to compute a table for a scenario, and to read the nearest stored one."""
        self._fresh.ask(scenario)
        self._near = self._pool.submit(self._read, scenario, self._curvature_per_mm)

    def take(self, step: int) -> PolicyTable | SpaceTable | None:
        """Return the stored table once, then the new table; None if there is none yet at decision number `step`.

        Raises NeedleplanError if planning failed.
        """
        near = self._take_near(step)
        self._source = "replan" if near is None else "atlas"
        table = near or self._fresh.take(step)
        if table is not None:
            self._curvature_per_mm = 1 / table.scenario.needle.curvature_radius_mm
        if table is not None and near is None:
            self._near = None
        return table

    def close(self) -> None:
        """Wait until both threads have ended; their tables are not used."""
        self._pool.shutdown(wait=True, cancel_futures=True)
        self._fresh.close()

    def _take_near(self, step: int) -> PolicyTable | SpaceTable | None:
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
        except NeedleplanError:  # a damaged table of the atlas is no reason not to plan
            return None

    def _read(self, scenario: Scenario | SpaceTask, present_per_mm: float) -> PolicyTable | SpaceTable | None:
        if not isinstance(scenario, Scenario):
            return None
        entry = self._lookup.nearest(scenario)
        if entry is None:
            return None
        table = entry.table()
        wanted_per_mm = 1 / scenario.needle.curvature_radius_mm
        stored_per_mm = 1 / table.scenario.needle.curvature_radius_mm
        return table if abs(stored_per_mm - wanted_per_mm) < abs(present_per_mm - wanted_per_mm) else None
