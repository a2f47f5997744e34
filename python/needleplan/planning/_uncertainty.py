"""Errors of an insertion: of its entry, its registration, its curvature and the estimate of its tip."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needleplan.config import ConfigTable, Maybe, Number, Pair, Violation, ruled
from needleplan.errors import InputError, Mistake
from needleplan.signals import RigidError

__all__ = ["Uncertainty"]

# Standard deviations of a normal distribution on each side of a 95 % interval.
_NORMAL_95 = 1.959964


class _IsRigidError:
    """Rule for a `RigidError`."""

    def read(self, value: object) -> RigidError:
        """Return the error. Raises Violation."""
        if not isinstance(value, RigidError):
            raise Violation("must be a RigidError", value)
        return value


def _one_registration(tre_mm: float, registration: RigidError | None) -> Iterator[Mistake]:
    if tre_mm and registration is not None:
        yield Mistake("tre_mm", f"{tre_mm:g}", "must be left out with a registration, whose points say its error")


def _low_first(curvature_ratio: tuple[float, float]) -> Iterator[Mistake]:
    low, high = curvature_ratio
    if low > high:
        yield Mistake("curvature_ratio", f"[{low:g}, {high:g}]", "must be an interval, its lower end first")


@dataclass(frozen=True)
class Uncertainty(ConfigTable, error=InputError, between=(_one_registration, _low_first)):
    """Errors of entry, registration, curvature and tip estimate in an insertion; by default, there is none.

    An execution draws the first three once and keeps them to its end (docs/explanation/promise.md).

    The constructor raises InputError, with every value that is outside of its range.

    Examples
    --------
    >>> from needleplan.planning import Uncertainty
    >>> Uncertainty(tre_mm=1.0, curvature_ratio=(0.9, 1.1)).is_exact
    False
    """

    entry_sd_mm: float = ruled(
        Number("mm", at_least=0, at_most=50), 0.0, about="standard deviation of the entry point, along each axis across"
    )
    """Standard deviation of the entry point along each axis across the needle; the point slides along the skin."""

    heading_sd_deg: float = ruled(
        Number("degrees", at_least=0, at_most=45), 0.0, about="standard deviation of the direction at the entry"
    )
    """Standard deviation of the direction at the entry, about each axis across the needle."""

    tre_mm: float = ruled(
        Number("mm", at_least=0, at_most=100), 0.0, about="registration error (TRE, root mean square in 3D), as a shift"
    )
    """Registration error as a shift of the whole anatomy: its root mean square length in three dimensions."""

    curvature_ratio: tuple[float, float] = ruled(
        Pair(Number(above=0, at_most=10)), (1.0, 1.0), about="95 % interval of the true curvature over the planned one"
    )
    """95 % interval of the true curvature, relative to the planned one; its logarithm is normally distributed."""

    coil_mm: float | None = ruled(
        Maybe(Number("mm", at_least=0, at_most=500)),
        None,
        about="distance of the coil, whose pose is measured, behind the tip; the tip noise acts all along the path",
    )
    """Distance of the coil, whose pose is measured, behind the tip: the tip noise of this length is not known yet.

    The noise acts all along the path. None: it acts at the ends of the steps, as the plan assumes, and is known.
    """

    registration: RigidError | None = ruled(Maybe(_IsRigidError()), None)
    """Error of a registration, instead of `tre_mm`, in the frame to which it leads: of the plan, in 3D RAS."""

    @property
    def is_exact(self) -> bool:
        """Whether everything is known exactly."""
        return not any(self.parts().values())

    def parts(self) -> dict[str, Uncertainty | None]:
        """Return the entry, the registration, the curvature and the tip, each alone; None if it is known exactly.

        Returns
        -------
        dict
            By the names `entry`, `registration`, `curvature` and `tip`.

        Examples
        --------
        >>> from needleplan.planning import Uncertainty
        >>> [name for name, part in Uncertainty(entry_sd_mm=1.0).parts().items() if part]
        ['entry']
        """
        exact = Uncertainty()
        alone = {
            "entry": replace(exact, entry_sd_mm=self.entry_sd_mm, heading_sd_deg=self.heading_sd_deg),
            "registration": replace(exact, tre_mm=self.tre_mm, registration=self.registration),
            "curvature": replace(exact, curvature_ratio=self.curvature_ratio),
            "tip": replace(exact, coil_mm=self.coil_mm),
        }
        return {name: part if part != exact else None for name, part in alone.items()}

    def record(self) -> dict[str, Any]:
        """Return the JSON record: the numbers, and of a registration its centre (mm) and covariance.

        Examples
        --------
        >>> from needleplan.planning import Uncertainty
        >>> Uncertainty(tre_mm=1.0).record()["tre_mm"]
        1.0
        """
        error = self.registration
        return {
            "entry_sd_mm": self.entry_sd_mm,
            "heading_sd_deg": self.heading_sd_deg,
            "tre_mm": self.tre_mm,
            "curvature_ratio": self.curvature_ratio,
            "coil_mm": self.coil_mm,
            "registration": error and {"centre_mm": error.centre_mm.tolist(), "covariance": error.covariance.tolist()},
        }

    def rigid_error(self) -> RigidError:
        """Return the error of the registration: `registration`, or a shift with the error `tre_mm`.

        Examples
        --------
        >>> from needleplan.planning import Uncertainty
        >>> round(Uncertainty(tre_mm=2.0).rigid_error().tre_mm((0, 0, 0)), 6)
        2.0
        """
        return self.registration or RigidError.of_tre(self.tre_mm)

    def ratios(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert standard normal numbers to ratios of the true to the planned curvature.

        Parameters
        ----------
        numbers : numpy.ndarray
            Standard normal numbers, shape (n,).

        Returns
        -------
        numpy.ndarray
            Ratios, shape (n,).

        Examples
        --------
        >>> import numpy as np
        >>> from needleplan.planning import Uncertainty
        >>> Uncertainty(curvature_ratio=(0.8, 1.25)).ratios(np.array([-1.959964, 0.0, 1.959964])).round(6).tolist()
        [0.8, 1.0, 1.25]
        """
        low, high = map(math.log, self.curvature_ratio)
        return np.exp((low + high) / 2 + (high - low) / (2 * _NORMAL_95) * numbers)
