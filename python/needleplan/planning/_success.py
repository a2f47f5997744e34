"""The probability of reaching the target, with its interval and its source: the one form in which it is passed on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from needleplan.artifacts import short_html
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Success", "SuccessSource"]

# Standard deviations of a normal distribution on each side of a 95 % interval.
_NORMAL_95 = 1.959964


class SuccessSource(StrEnum):
    """How a success probability was computed."""

    EXECUTIONS = "executions"
    """Estimated by executions with tip noise in the continuous model; it has no error of the grid."""

    TABLE = "table"
    """Looked up in the policy table. It has the error of the grid, which is not known, so it has no interval."""


@dataclass(frozen=True, repr=False)
class Success:
    """Probability of reaching the target from a pose under the policy, with its 95 % interval and its source.

    Parameters
    ----------
    value : float
        The probability, from 0 to 1.
    interval : tuple of float, optional
        Lower and upper end of its 95 % interval. Default: None, not known, as for the source "table".
    source : SuccessSource, optional
        How it was computed. Default: "table".
    runs : int, optional
        Number of executions. Default: 0, as for the source "table".

    Raises
    ------
    InputError
        If a number is outside of its range, or the source is not known.

    Examples
    --------
    >>> import needleplan as npl
    >>> print(npl.Success(0.873, (0.866, 0.88), "executions", 2000))
    87.3 %, 95 % interval 86.6 to 88.0 %, by 2,000 executions
    >>> print(npl.Success(0.89))
    89.0 % by the table
    """

    value: float
    interval: tuple[float, float] | None = None
    source: SuccessSource = SuccessSource.TABLE
    runs: int = 0

    def __post_init__(self) -> None:
        mistakes = []
        if not _is_share(self.value):
            mistakes.append(Mistake("value", f"{self.value}", "must be a probability, from 0 to 1"))
        elif self.interval is not None and not _holds(self.interval, self.value):
            rule = "must be two probabilities, the lower one first, with the value between them"
            mistakes.append(Mistake("interval", f"{self.interval}", rule))
        if self.source not in list(SuccessSource):
            names = " or ".join(f'"{source}"' for source in SuccessSource)
            mistakes.append(Mistake("source", f"{self.source}", f"must be {names}"))
        if not isinstance(self.runs, int) or isinstance(self.runs, bool) or self.runs < 0:
            mistakes.append(Mistake("runs", f"{self.runs}", "must be a whole number from 0"))
        if mistakes:
            raise InputError(mistakes)
        object.__setattr__(self, "source", SuccessSource(self.source))

    @classmethod
    def of_executions(cls, numbers: NDArray[Any]) -> Success:
        """Return the success that unbiased numbers of executions show, by their mean and its normal 95 % interval.

        Parameters
        ----------
        numbers : numpy.ndarray
            One number for each execution, with the success as its mean, shape (runs,).

        Returns
        -------
        Success

        Examples
        --------
        >>> import numpy as np
        >>> import needleplan as npl
        >>> npl.Success.of_executions(np.array([1.0, 1.0, 0.0, 1.0])).value
        0.75
        """
        mean = min(max(float(numbers.mean()), 0.0), 1.0)
        # A success and a failure are added to the scatter, so that no interval is empty.
        scatter = float(((numbers - mean) ** 2).sum()) + mean**2 + (1 - mean) ** 2
        half = _NORMAL_95 * math.sqrt(scatter) / len(numbers)
        return cls(mean, (max(mean - half, 0.0), min(mean + half, 1.0)), SuccessSource.EXECUTIONS, len(numbers))

    def record(self, name: str = "success") -> dict[str, Any]:
        """Return the JSON record of the success: value, interval, source and number of executions.

        Parameters
        ----------
        name : str, optional
            First word of the keys. Default: "success".

        Returns
        -------
        dict
            By the default name `success`, `success_interval` (None if not known), `success_source`, `success_runs`.

        Examples
        --------
        >>> import needleplan as npl
        >>> npl.Success(0.89).record()
        {'success': 0.89, 'success_interval': None, 'success_source': 'table', 'success_runs': 0}
        """
        return {
            name: self.value,
            f"{name}_interval": self.interval,
            f"{name}_source": str(self.source),
            f"{name}_runs": self.runs,
        }

    @property
    def shown(self) -> float:
        """The probability in percent as it is printed, with one digit after the point."""
        return float(f"{100 * self.value:.1f}")

    def __str__(self) -> str:
        words = "by the table" if self.source is SuccessSource.TABLE else f"by {self.runs:,} executions"
        if self.interval is None:
            return f"{100 * self.value:.1f} % {words}"
        low, high = (100 * limit for limit in self.interval)
        return f"{100 * self.value:.1f} %, 95 % interval {low:.1f} to {high:.1f} %, {words}"

    _repr_html_ = short_html

    def __repr__(self) -> str:
        return f"<Success: {self}>"


def _is_share(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 1


def _holds(interval: object, value: float) -> bool:
    """Return whether an interval is two probabilities around a value."""
    if not isinstance(interval, tuple) or len(interval) != 2 or not all(map(_is_share, interval)):
        return False
    return bool(interval[0] <= value <= interval[1])
