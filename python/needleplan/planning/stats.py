"""How a solve went."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from needleplan._ppvi import _Solution

__all__ = ["Progress", "Stats", "Status"]

Progress = Callable[[float, float, float], None]
"""Called while solving with the number of sweeps so far, the residual, and the residual at which the solve ends."""


class Status(StrEnum):
    """Why a solve ended."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration_limit"
    TIME_LIMIT = "time_limit"
    PRECISION_LIMIT = "precision_limit"
    """Rounding hides what is left of the residual: the tolerance asks for more than double precision."""

    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Stats:
    """Counts, proofs and times of a solve.

    `sweeps` is `backups` in units of the number of states; `residual` is the largest Bellman residual max |TV - V| of
    the values (a bound on it for the directional sweeps); `error_bound` bounds max |V - V*|, infinite where the problem
    gives no bound. `partitions_processed` counts every visit of a partition; `order` lists the partitions that were
    visited at all, ix * py + iy, in the order of their first visit (for the directional sweeps: their sectors).
    `seconds` is the time from scenario to table.
    """

    states: int
    partitions: int
    partitions_processed: int
    backups: int
    sweeps: float
    residual: float
    error_bound: float
    status: Status
    seconds: float
    seconds_solving: float
    seconds_priorities: float
    order: tuple[int, ...]

    @classmethod
    def of(cls, solved: _Solution, states: int, seconds: float) -> Stats:
        """Make them of what the compiled solver reports."""
        return cls(
            states=states,
            partitions=solved["partitions"],
            partitions_processed=solved["partitions_processed"],
            backups=solved["backups"],
            sweeps=solved["sweeps"],
            residual=solved["residual"],
            error_bound=solved["error_bound"],
            status=Status(solved["status"]),
            seconds=seconds,
            seconds_solving=solved["seconds_solving"],
            seconds_priorities=solved["seconds_priorities"],
            order=tuple(solved["order"].tolist()),
        )
