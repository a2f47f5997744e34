"""A state that decays from sample to sample: serial, and therefore solved by LAPACK and not by a loop."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg.lapack import dtbtrs

from needleplan.signals import Array

__all__ = ["recurrence"]


def recurrence(factor: Array, offset: Array, start: Array | float) -> Array:
    """Return y, shape (n + 1, ...), of y[0] = start and y[k + 1] = factor[k] y[k] + offset[k].

    `factor` has the shape (n,), `offset` (n, ...) and `start` that of one of its rows. It is a band matrix with two
    diagonals, solved from its first row on: the same sums in the same order as a loop's.
    """
    n = len(factor) + 1
    band = np.zeros((2, n), order="F")
    band[0], band[1, :-1] = 1.0, -factor
    width = math.prod(offset.shape[1:])
    right = np.empty((n, width), order="F")
    right[0] = np.ravel(start)
    right[1:] = offset.reshape((n - 1, width))
    solved, _ = dtbtrs(band, right, uplo="L", diag="U", overwrite_b=True)
    return np.asarray(solved.reshape((n, *offset.shape[1:])), float)
