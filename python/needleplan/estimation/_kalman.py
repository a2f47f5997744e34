"""The correction of a Kalman filter. The libraries that offer one import scipy.stats, which takes a second."""

from __future__ import annotations

import numpy as np

from needleplan.signals import Array

__all__ = ["corrected"]


def corrected(x: Array, covariance: Array, residual: Array, noise: Array, change: Array) -> tuple[Array, Array]:
    """Return state and covariance after a measurement, in Joseph form, which keeps the covariance positive.

    The state `x` has the shape (n,), its `covariance` (n, n), the measurement less its prediction (`residual`) (m,),
    the covariance of its `noise` (m, m), and `change`, the derivative of the prediction, (m, n).
    """
    cross = covariance @ change.T
    gain = cross @ np.linalg.inv(change @ cross + noise)
    left = np.eye(x.size) - gain @ change
    return x + gain @ residual, left @ covariance @ left.T + gain @ noise @ gain.T
