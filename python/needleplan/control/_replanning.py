"""Replanning during an insertion: when to replan, for which scenario, and the thread that computes the new table.

A plan assumes a curvature. The needle replans if the estimate differs from it by more than `replan_deviations` standard
deviations and by more than `replan_share` of the planned curvature. The new plan uses the estimated curvature. In a
scenario with layers or tissues, all radii are scaled alike, because the tip shows only the curvature of its own layer.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

from needleplan.control._options import Options
from needleplan.devices import Closing
from needleplan.errors import NeedleplanError
from needleplan.estimation.tip import TipEstimate
from needleplan.planning import PolicyTable, plan
from needleplan.scenario import Scenario

__all__ = ["Replanner", "ThreadReplanner", "curvature_left", "rescaled"]


def curvature_left(tip: TipEstimate, planned_per_mm: float, options: Options) -> str:
    """Return why the planned curvature (1/mm) is wrong, or an empty text if it is not."""
    off = tip.curvature_per_mm - planned_per_mm
    sd = tip.curvature_sd_per_mm
    if abs(off) <= options.replan_deviations * sd or abs(off) <= options.replan_share * planned_per_mm:
        return ""
    return (
        f"the curvature is {tip.curvature_per_mm:.4g} +- {sd:.2g} per mm where {planned_per_mm:.4g} was planned, "
        f"{off / planned_per_mm:+.1%} and {abs(off) / sd:.1f} standard deviations off"
    )


def rescaled(scenario: Scenario, factor: float) -> Scenario:
    """Return the scenario with all curvatures multiplied by `factor`. Raises ScenarioError."""
    needle = scenario.needle
    layers = tuple(replace(each, curvature_radius_mm=each.curvature_radius_mm / factor) for each in needle.layers)
    tissues = tuple(replace(each, curvature_radius_mm=each.curvature_radius_mm / factor) for each in scenario.tissues)
    made = replace(needle, curvature_radius_mm=needle.curvature_radius_mm / factor, layers=layers)
    return replace(scenario, needle=made, tissues=tissues)


class Replanner(Closing):
    """Computes new tables, one at a time; abstract."""

    @property
    @abstractmethod
    def busy(self) -> bool:
        """Whether a table was requested and has not been taken."""

    @abstractmethod
    def ask(self, scenario: Scenario) -> None:
        """Begin to plan for a scenario."""

    @abstractmethod
    def take(self, step: int) -> PolicyTable | None:
        """Return the new table, or None if it is not ready at decision `step`. Raises NeedleplanError if it failed."""


class ThreadReplanner(Replanner):
    """Plans in a thread.

    In real time, a table is taken at the first decision after it is ready. On simulated time, which does not pass while
    a plan is computed, `wait` makes the decision after the request wait for the table. For replays, `at` gives the
    numbers of the decisions at which tables are taken.
    """

    def __init__(self, *, wait: bool, at: Iterable[int] | None = None) -> None:
        self._wait = wait
        self._at = None if at is None else sorted(at)
        self._pool = ThreadPoolExecutor(1, "replan")
        self._asked: Future[PolicyTable] | None = None

    @property
    def busy(self) -> bool:
        """Whether a table was requested and has not been taken."""
        return self._asked is not None

    def ask(self, scenario: Scenario) -> None:
        """Begin to plan for a scenario."""
        self._asked = self._pool.submit(_made, scenario)

    def take(self, step: int) -> PolicyTable | None:
        """Return the new table, or None if it is not ready at decision `step`. Raises NeedleplanError if it failed."""
        asked = self._asked
        if asked is None:
            return None
        if self._at is not None:
            if not self._at or step < self._at[0]:
                return None
            self._at.pop(0)
        elif not (self._wait or asked.done()):
            return None
        self._asked = None
        try:
            return asked.result()
        except NeedleplanError:
            raise
        except Exception as error:  # a failed plan must not end an insertion that still has a table
            raise NeedleplanError(f"planning again failed: {error!r}") from error

    def close(self) -> None:
        """Wait for the plan under way, and discard it."""
        self._pool.shutdown(wait=True, cancel_futures=True)


def _made(scenario: Scenario) -> PolicyTable:
    table = plan(scenario)
    _ = table.digest  # computed here, because it takes long
    return table
