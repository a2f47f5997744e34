"""Planning again while the needle goes on: when, with what, and where the new table is made.

The plan takes a curvature for granted. It is left when the estimate differs from it by more than so many standard
deviations of the estimate, and by more than a share that would change the policy. The new plan has the estimated
curvature: of a scenario with layers or tissues all radii are scaled alike, since the tip knows only the one it is in.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

from needleplan.control.options import Options
from needleplan.devices import Closing
from needleplan.errors import NeedleplanError
from needleplan.estimation.tip import TipEstimate
from needleplan.planning import PolicyTable, plan
from needleplan.scenario import Scenario

__all__ = ["Replanner", "ThreadReplanner", "curvature_left", "rescaled"]


def curvature_left(tip: TipEstimate, planned_per_mm: float, options: Options) -> str:
    """Return why the curvature of the plan cannot be true any more, or nothing."""
    off = tip.curvature_per_mm - planned_per_mm
    sd = tip.curvature_sd_per_mm
    if abs(off) <= options.replan_deviations * sd or abs(off) <= options.replan_share * planned_per_mm:
        return ""
    return (
        f"the curvature is {tip.curvature_per_mm:.4g} +- {sd:.2g} per mm where {planned_per_mm:.4g} was planned, "
        f"{off / planned_per_mm:+.1%} and {abs(off) / sd:.1f} standard deviations off"
    )


def rescaled(scenario: Scenario, factor: float) -> Scenario:
    """Return the scenario with all its curvatures multiplied. Raises ScenarioError."""
    needle = scenario.needle
    layers = tuple(replace(each, curvature_radius_mm=each.curvature_radius_mm / factor) for each in needle.layers)
    tissues = tuple(replace(each, curvature_radius_mm=each.curvature_radius_mm / factor) for each in scenario.tissues)
    made = replace(needle, curvature_radius_mm=needle.curvature_radius_mm / factor, layers=layers)
    return replace(scenario, needle=made, tissues=tissues)


class Replanner(Closing):
    """Makes new tables; abstract. One at a time."""

    @property
    @abstractmethod
    def busy(self) -> bool:
        """Whether a table is asked for and not taken."""

    @abstractmethod
    def ask(self, scenario: Scenario) -> None:
        """Begin to plan."""

    @abstractmethod
    def take(self, step: int) -> PolicyTable | None:
        """Return the table for the decision of this number if there is one. Raises NeedleplanError, once."""


class ThreadReplanner(Replanner):
    """Plans in a thread of its own.

    In real time a table is taken at the first decision at which it is there. On simulated time, which would not pass
    while it is made, it is waited for at the decision after the one that asked. `at`, for replays, gives the numbers of
    the decisions at which the tables are to be taken.
    """

    def __init__(self, *, wait: bool, at: Iterable[int] | None = None) -> None:
        self._wait = wait
        self._at = None if at is None else sorted(at)
        self._pool = ThreadPoolExecutor(1, "replan")
        self._asked: Future[PolicyTable] | None = None

    @property
    def busy(self) -> bool:
        """Whether a table is asked for and not taken."""
        return self._asked is not None

    def ask(self, scenario: Scenario) -> None:
        """Begin to plan."""
        self._asked = self._pool.submit(_made, scenario)

    def take(self, step: int) -> PolicyTable | None:
        """Return the table for the decision of this number if there is one. Raises NeedleplanError, once."""
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
        except Exception as error:  # a plan that fails must not end an insertion that has one
            raise NeedleplanError(f"planning again failed: {error!r}") from error

    def close(self) -> None:
        """Wait for what is being planned, and forget it."""
        self._pool.shutdown(wait=True, cancel_futures=True)


def _made(scenario: Scenario) -> PolicyTable:
    table = plan(scenario)
    _ = table.digest  # takes its time, which is this thread's
    return table
