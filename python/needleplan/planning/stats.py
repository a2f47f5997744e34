"""How a solve went."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Progress", "Stats", "Status"]

Progress = Callable[[float, float, float], None]
"""Called while solving with the number of sweeps so far, the residual, and the residual at which the solve ends."""


class Status(StrEnum):
    """Why a solve ended."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration_limit"
    TIME_LIMIT = "time_limit"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Stats:
    """Counts, proofs and times of a solve.

    `sweeps` is `backups` divided by the number of states that can be backed up; `residual` is the largest Bellman
    residual max |TV - V| of the values; `error_bound` bounds max |V - V*|, infinite where the problem gives no bound.
    `partitions_processed` counts the partitions that were processed at all; `order` lists their numbers, iy * px + ix,
    in the order of their first processing. `seconds` is the time from the scenario to the table.
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
