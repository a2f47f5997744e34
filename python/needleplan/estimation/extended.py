"""filterpy's extended Kalman filter with the nonlinear prediction done outside of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from needleplan.signals import Array

__all__ = ["Extended"]


class Extended(ExtendedKalmanFilter):  # type: ignore[misc]
    """An extended Kalman filter with one measured number, told what its state becomes and the derivative of that.

    filterpy's own prediction of x is linear, F x; its update has the form of Joseph, which keeps P symmetric and
    positive.
    """

    def __init__(self, x: Array, covariance: Array, walk: Array, variance: float) -> None:
        """Start at `x`, shape (n,), with `covariance` and `walk` (Q), shape (n, n); `variance` is R."""
        super().__init__(dim_x=x.size, dim_z=1)
        self.x, self.P, self.Q = x.copy(), covariance.copy(), walk
        self.R = np.array([[variance]])

    def predict_x(self, u: Any = 0) -> None:
        """Take the prediction as it is given."""
        self.x = u

    def advance(self, x: Array, change: Array) -> None:
        """Predict: the state becomes `x`, whose derivative by the state before is `change`, shape (n, n)."""
        self.F = change
        self.predict(x)

    def correct(self, measured: float, expected: float, change: Array) -> None:
        """Update with a measured number; `change` is the derivative of the expected one, shape (n,)."""
        self.update(np.array([measured]), lambda _: change[np.newaxis], lambda _: np.array([expected]))

    @property
    def lost(self) -> bool:
        """Whether the estimate is no longer a number."""
        return not (np.isfinite(self.x).all() and np.isfinite(self.P).all())
