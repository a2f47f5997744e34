"""The success under what is not known exactly, by executions in which the truth differs from the plan.

`docs/explanation/promise.md` has the model and its assumptions. Executions k of all parts of a promise share their
random numbers: those of the tip noise, and those of each error.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleplan.artifacts import short_html
from needleplan.errors import InputError, Mistake
from needleplan.planning._execution import wilson
from needleplan.planning._poses import whole_number
from needleplan.planning._success import Success, SuccessSource
from needleplan.planning._uncertainty import Uncertainty

if TYPE_CHECKING:
    from needleplan.signals import RigidError

__all__ = ["PROMISED_RUNS", "ErrorDraws", "Promise", "PromisingTable", "Truths", "share_of"]

PROMISED_RUNS = 2000
"""Number of executions of each part of a promise: its standard error is at most 1.1 percentage points."""


class Truths(NamedTuple):
    """What is true in n executions.

    `motions` are the rows of the rigid motions that take believed to true positions (mm), shape (n, 3, 4), `ratios` the
    curvatures relative to the planned one, shape (n,), and `coil_mm` the distance of the coil behind the tip; 0 if the
    noise acts at the ends of the steps and is known.
    """

    motions: NDArray[np.float64]
    ratios: NDArray[np.float64]
    coil_mm: float = 0.0


# Distance (mm) of a coil at the tip: the noise acts all along the path, and next to nothing of it is unknown.
_AT_TIP_MM = 1e-6

# Largest number of executions of a part, limited by memory.
_MOST_RUNS = 1_000_000


class ErrorDraws(NamedTuple):
    """Standard normal numbers of n executions: those of the entry, (n, 4), registration, (n, 6), and curvature, (n,).

    The entry has two for its point and two for its direction; the plane uses the first of each two.
    """

    entry: NDArray[np.float64]
    registration: NDArray[np.float64]
    curvature: NDArray[np.float64]

    @classmethod
    def of(cls, runs: int, seed: int) -> ErrorDraws:
        """Draw the numbers of `runs` executions."""
        entry, registration, curvature = (np.random.default_rng([seed, stream]) for stream in range(3))
        return cls(
            entry.standard_normal((runs, 4)), registration.standard_normal((runs, 6)), curvature.standard_normal(runs)
        )


@dataclass(frozen=True, repr=False)
class Promise:
    """The success from a pose: exact, under each error alone, and under all of them together.

    Parameters
    ----------
    uncertainty : Uncertainty
        Errors of the entry, the registration, the curvature and the tip.
    exact : Success
        The success if the entry, the registration and the curvature are as planned, and the tip is known.
    entry, registration, curvature, tip : Success or None
        The success under one of the errors alone; None if it is known exactly.
    together : Success
        The success under all errors.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.planning import Uncertainty
    >>> table = npl.plan("four_obstacles")
    >>> promise = table.success_under(Uncertainty(tre_mm=1.5), table.best_entry(), executions=500)
    >>> promise.together.value < promise.exact.value, promise.entry
    (True, None)
    """

    uncertainty: Uncertainty
    exact: Success
    entry: Success | None
    registration: Success | None
    curvature: Success | None
    tip: Success | None
    together: Success

    def parts(self) -> dict[str, Success]:
        """Return the successes that are known, by name, the exact one first.

        Examples
        --------
        >>> import needleplan as npl
        >>> from needleplan.planning import Uncertainty
        >>> table = npl.plan("four_obstacles")
        >>> list(table.success_under(Uncertainty(tre_mm=1.5), table.best_entry(), executions=10).parts())
        ['exact', 'registration', 'together']
        """
        names = ("exact", "entry", "registration", "curvature", "tip", "together")
        return {name: part for name in names if (part := getattr(self, name)) is not None}

    def record(self) -> dict[str, Any]:
        """Return the JSON record: each known success by its name, and `uncertainty`.

        Examples
        --------
        >>> import needleplan as npl
        >>> from needleplan.planning import Uncertainty
        >>> table = npl.plan("four_obstacles")
        >>> table.success_under(Uncertainty(), table.best_entry(), executions=10).record()["exact"]["success_source"]
        'executions'
        """
        return {name: part.record() for name, part in self.parts().items()} | {"uncertainty": self.uncertainty.record()}

    _repr_html_ = short_html

    def __repr__(self) -> str:
        return f"<Promise: {self.together}; exact {self.exact.shown} %>"


class PromisingTable(ABC):
    """Base class of policy tables with the method `success_under`."""

    def success_under(
        self, uncertainty: Uncertainty, pose: Any, *, executions: int = PROMISED_RUNS, seed: int = 0
    ) -> Promise:
        """Return the success from a pose under errors of the entry, the registration, the curvature and the tip.

        Parameters
        ----------
        uncertainty : Uncertainty
            Errors of the entry, the registration, the curvature and the tip.
        pose : Entry, Pose, SpacePose or sequence of float
            Where the needle is meant to enter; in the plane with or without bevel.
        executions : int, default 2000
            Number of executions for each success, from 1 to 1,000,000.
        seed : int, default 0
            Seed of the tip noise and of the errors. The same seed gives the same promise on any number of threads.

        Returns
        -------
        Promise

        Raises
        ------
        PoseError
            If the pose is no pose of this kind of table, or lies outside, or a number is no such whole number.
        InputError
            If `uncertainty` is no `Uncertainty`.

        Examples
        --------
        >>> import needleplan as npl
        >>> from needleplan.planning import Uncertainty
        >>> table = npl.plan("four_obstacles")
        >>> uncertainty = Uncertainty(entry_sd_mm=1.0, heading_sd_deg=2.0, tre_mm=1.5, curvature_ratio=(0.9, 1.1))
        >>> promise = table.success_under(uncertainty, table.best_entry(), executions=500)
        >>> promise.together.value < promise.exact.value
        True
        """
        if not isinstance(uncertainty, Uncertainty):
            raise InputError(Mistake("uncertainty", type(uncertainty).__name__, "must be an Uncertainty"))
        executions = whole_number("executions", executions, 1, _MOST_RUNS, f"from 1 to {_MOST_RUNS:,}")
        seed = whole_number("seed", seed, 0, 2**64 - 1, "from 0 to 2^64 - 1")
        draws = ErrorDraws.of(executions, seed)
        exact = self._exact_success(pose, executions, seed)
        alone = uncertainty.parts()
        known = {name: self._success_of(part, pose, draws, seed) if part else None for name, part in alone.items()}
        errors = [part for part in known.values() if part]
        together = self._success_of(uncertainty, pose, draws, seed) if len(errors) > 1 else (*errors, exact)[0]
        return Promise(uncertainty, exact, **known, together=together)

    def _success_of(self, uncertainty: Uncertainty, pose: Any, draws: ErrorDraws, seed: int) -> Success:
        starts = self._scattered(pose, uncertainty, draws.entry)
        motions = self._error_in_plan(uncertainty.rigid_error()).motions(draws.registration)
        truths = Truths(motions, uncertainty.ratios(draws.curvature), _seen_behind(uncertainty.coil_mm))
        return share_of(self._reached(starts, truths, seed))

    @abstractmethod
    def _exact_success(self, pose: Any, executions: int, seed: int) -> Success:
        """Return the success if nothing is uncertain, from the source that `plan` and `entry` print."""

    @abstractmethod
    def _scattered(self, pose: Any, uncertainty: Uncertainty, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the scattered poses of the entry, shape (n, 4) or (n, 6); those that do not exist are NaN."""

    def _error_in_plan(self, error: RigidError) -> RigidError:
        """Return the error of a registration in the frame of the table's poses."""
        return error

    @abstractmethod
    def _reached(self, starts: NDArray[np.float64], truths: Truths, seed: int) -> NDArray[np.bool_]:
        """Return which executions reach the target, shape (n,); those without a start do not."""


def _seen_behind(coil_mm: float | None) -> float:
    """Return the distance of the coil for `Truths`."""
    return 0.0 if coil_mm is None else max(coil_mm, _AT_TIP_MM)


def share_of(reached: NDArray[np.bool_]) -> Success:
    """Return the share of executions that have reached the target, with its interval (Wilson)."""
    runs, count = len(reached), int(reached.sum())
    low, high = wilson(count, runs)
    value = count / runs
    return Success(value, (min(low, value), max(high, value)), SuccessSource.EXECUTIONS, runs)
