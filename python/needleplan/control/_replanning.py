"""Replanning during an insertion: when to replan, for which scenario, and the thread that computes the new table.

A plan assumes a curvature. The controller replans if the curvature that the tip filter expects on the way to the target
differs from the planned curvature by more than `replan_deviations` standard deviations and by more than `replan_share`
of the planned curvature. The expected curvature is the mean over the remaining length, with the estimated change of the
curvature per length. The new plan uses it. In a scenario with layers or tissues, all radii are multiplied by the same
factor, because only the curvature in the layer around the tip can be estimated.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

from needleplan.control._options import Options
from needleplan.devices import Closing
from needleplan.errors import NeedleplanError
from needleplan.planning import SpaceTask, Table, plan, plan_ahead
from needleplan.scenario import Scenario

__all__ = ["FROM_TABLE_SET", "Replanner", "ThreadReplanner", "curvature_mismatch", "rescaled"]

FROM_TABLE_SET = "table set"
"""Source of a table that was stored in a table set."""


def curvature_mismatch(expected_per_mm: float, sd: float, planned_per_mm: float, options: Options) -> str:
    """Return a text about the curvature mismatch if it requires replanning, else an empty text.

    Parameters
    ----------
    expected_per_mm : float
        Expected curvature (1/mm).
    sd : float
        Standard deviation of the expected curvature (1/mm).
    planned_per_mm : float
        Planned curvature (1/mm), not 0.
    options : Options
        Options with the limits `replan_deviations` and `replan_share`. The mismatch must exceed both.

    Returns
    -------
    str
    """
    off = expected_per_mm - planned_per_mm
    if abs(off) <= options.replan_deviations * sd or abs(off) <= options.replan_share * planned_per_mm:
        return ""
    deviations = f" and {abs(off) / sd:.1f} standard deviations" if sd else ""
    return (
        f"the curvature is {expected_per_mm:.4g} +- {sd:.2g} per mm, but {planned_per_mm:.4g} per mm was planned: "
        f"a difference of {off / planned_per_mm:+.1%}{deviations}"
    )


def rescaled(scenario: Scenario, factor: float) -> Scenario:
    """Return the scenario with all curvatures multiplied by a factor.

    Parameters
    ----------
    scenario : Scenario
        Scenario in the plane.
    factor : float
        Positive factor.

    Returns
    -------
    Scenario

    Raises
    ------
    ScenarioError
        The result breaks a rule of scenarios.
    """
    needle = scenario.needle
    layers = tuple(replace(layer, curvature_radius_mm=layer.curvature_radius_mm / factor) for layer in needle.layers)
    tissues = tuple(
        replace(tissue, curvature_radius_mm=tissue.curvature_radius_mm / factor) for tissue in scenario.tissues
    )
    made = replace(needle, curvature_radius_mm=needle.curvature_radius_mm / factor, layers=layers)
    return replace(scenario, needle=made, tissues=tissues)


class Replanner(Closing):
    """Abstract source of new tables; it computes one table at a time."""

    @property
    @abstractmethod
    def busy(self) -> bool:
        """Whether a table was requested that `take` has neither returned nor reported as failed."""

    @property
    def source(self) -> str:
        """Where the last table came from, for the event: "replan"."""
        return "replan"

    @abstractmethod
    def ask(self, scenario: Scenario | SpaceTask) -> None:
        """Begin to compute a table for a scenario."""

    @abstractmethod
    def take(self, step: int) -> Table | None:
        """Return the new table, or None if there is none yet at decision number `step`.

        Raises NeedleplanError if planning failed.
        """


class ThreadReplanner(Replanner):
    """Replanner that computes tables in a thread.

    - If not `wait`, `take` returns a table at the first decision after the table is ready.
    - If `wait`, the first decision after the request waits for the table. Simulated time needs this, because it does
      not pass while a table is computed.
    - If `at` is given, `take` returns tables only at the decisions with these numbers, and waits for them. Replays
      need this.
    """

    def __init__(self, *, wait: bool, at: Iterable[int] | None = None) -> None:
        self._wait = wait
        self._at = None if at is None else sorted(at)
        self._pool = ThreadPoolExecutor(1, "replan")
        self._asked: Future[Table] | None = None

    @property
    def busy(self) -> bool:
        """Whether a table was requested that `take` has neither returned nor reported as failed."""
        return self._asked is not None

    def ask(self, scenario: Scenario | SpaceTask) -> None:
        """Begin to compute a table for a scenario."""
        self._asked = self._pool.submit(_made, scenario)

    def take(self, step: int) -> Table | None:
        """Return the new table, or None if there is none yet at decision number `step`.

        Raises NeedleplanError if planning failed.
        """
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
        """Wait until the present computation has ended; its table is not used."""
        self._pool.shutdown(wait=True, cancel_futures=True)


def _made(scenario: Scenario | SpaceTask) -> Table:
    table = plan_ahead(scenario) if isinstance(scenario, SpaceTask) else plan(scenario)
    _ = table.digest  # cached; computed in this thread, because it takes long
    return table
