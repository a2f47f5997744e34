"""The interface of a supervisor, which stops a stage without waiting for the program.

A robot that is reached by UDP has one: two threads of Rust own its socket (`rust/guard/src/supervisor.rs`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod

__all__ = ["GuardNumbers", "StageSupervisor", "SupervisedLimits", "SupervisedTimes"]

GuardNumbers = tuple[int, bool, bool, int, int, int, int | None, int | None, bool, int, bool, int | None]
"""Fields of a state of the guard, as the guard of Rust takes them."""

SupervisedLimits = tuple[tuple[float, float, float, float, float], tuple[float, float], tuple[float, float], float]
"""Largest ages (s) of samples of the stage, signs of life of the loop, samples of force sensor and tracker, and signals
of the deadman switch, infinite if not watched; then the ranges that may be measured: shallowest and deepest depth,
velocities inward and outward, and roll."""

_Times = tuple[int | None, int | None, bool]
SupervisedTimes = tuple[_Times, _Times, int | None]
"""Times (ns) of the last and of the last usable sample of force sensor and tracker, with whether the tracker sees no
coil, and the time at which a person last held the deadman switch."""


class StageSupervisor(ABC):
    """Abstract supervisor of a stage, which stops the needle without waiting for the program; only the guard uses it.

    The supervisor sees every sample of the stage on its arrival. The guard posts its state, and the times of its other
    inputs. If these or the samples require it, the supervisor sends a STOP by itself: a *trip*.
    """

    @abstractmethod
    def seen(self, stage_age_s: float) -> tuple[int, int, int, int]:
        """Return the number of trips, the causes and time (ns) of the last trip, and the causes by old samples."""

    @abstractmethod
    def post(self, limits: SupervisedLimits, state: GuardNumbers, trips: int | None, times: SupervisedTimes) -> None:
        """Post the state of the guard and the times of its inputs; `trips` is the number of trips that the guard knew.

        The supervisor ignores a state that was decided before its last trip; None: the state always counts.
        """

    @abstractmethod
    def tick(self) -> None:
        """Note that the loop runs; heartbeats are sent for `loop_age_s`."""

    @abstractmethod
    def withhold(self) -> None:
        """Send no heartbeat until the next `tick`."""
