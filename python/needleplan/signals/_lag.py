"""Linear recurrences, and the first-order lag of a sensor."""

from __future__ import annotations

import math

import numpy as np

from needleplan.signals._record import Array, Motion

__all__ = ["lag_taps", "lagged", "recurrence"]

# Decay of the lag filter over one sample below which two past samples suffice.
_FORGOTTEN = 0.05
# Logarithm of the tap weight at which the lag filter is truncated.
_ROUNDING = math.log(1e-14)


def recurrence(factor: Array, offset: Array, start: Array | float) -> Array:
    """Solve the linear recurrence y[k + 1] = factor[k] y[k] + offset[k].

    The recurrence is a bidiagonal system of equations, which LAPACK solves by forward substitution. The operations and
    their order are those of a loop.

    Parameters
    ----------
    factor : Array
        Factors, shape (n,).
    offset : Array
        Summands, shape (n, ...).
    start : Array or float
        y[0], of the shape of one row of `offset`.

    Returns
    -------
    Array
        y, shape (n + 1, ...).

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.models import recurrence
    >>> recurrence(np.array([0.5, 0.5]), np.array([1.0, 1.0]), 0.0)
    array([0. , 1. , 1.5])
    """
    from scipy.linalg.lapack import dtbtrs

    n = len(factor) + 1
    band = np.zeros((2, n), order="F")
    band[0], band[1, :-1] = 1.0, -factor
    width = math.prod(offset.shape[1:])
    right = np.empty((n, width), order="F")
    right[0] = np.ravel(start)
    right[1:] = offset.reshape((n - 1, width))
    solved, _ = dtbtrs(band, right, uplo="L", diag="U", overwrite_b=True)
    return np.asarray(solved.reshape((n, *offset.shape[1:])), float)


def lagged(force: Array, motion: Motion, lag_s: float) -> Array:
    """Return an output after a first-order sensor lag.

    The output is taken to be linear between the samples.

    Parameters
    ----------
    force : numpy.ndarray
        Output, shape (samples, ...), or (axes * samples, ...) with the samples of each axis in one block.
    motion : Motion
        Motion with the sampling times, of length `samples`.
    lag_s : float
        Time constant of the lag (s). A negative lag is a lead: a linear extrapolation.

    Returns
    -------
    numpy.ndarray
        Output after the lag, of the shape and unit of `force`.
    """
    if len(force) > len(motion):
        count = len(force) // len(motion)
        axes = np.moveaxis(force.reshape(count, len(motion), *force.shape[1:]), 0, -1)
        return np.moveaxis(lagged(axes, motion, lag_s), -1, 0).reshape(force.shape)
    h = motion.interval_s.reshape((-1,) + (1,) * (force.ndim - 1))
    rise = np.diff(force, axis=0) / h
    found: Array = np.array(force, float)
    if lag_s <= 0:  # a negative lag is a lead: linear extrapolation
        found[1:] -= lag_s * rise
        return found
    decay = np.exp(-h / lag_s)
    behind = -lag_s * rise * (1 - decay)
    if float(decay.max()) >= _FORGOTTEN:
        return force + recurrence(decay.ravel(), behind, np.zeros(force.shape[1:]))
    found[1:] += behind
    found[2:] += decay[1:] * behind[:-1]
    return found


def lag_taps(motion: Motion, lag_s: float) -> Array | None:
    """Return a first-order sensor lag as weights of the present and past samples.

    Parameters
    ----------
    motion : Motion
        Motion with the sampling times.
    lag_s : float
        Time constant of the lag (s). A negative lag is a lead.

    Returns
    -------
    numpy.ndarray or None
        Weights, shape (taps,), the present sample first. None if the lag is not 0 and the sampling is uneven.
    """
    h = motion.interval_s
    step = float(np.median(h))
    if lag_s == 0:
        return np.ones(1)
    decay = math.exp(-step / lag_s) if lag_s > 0 else 0.0
    if float(np.abs(h - step).max()) > 1e-3 * step:
        return None
    count = 3 if decay <= _FORGOTTEN else math.ceil(_ROUNDING / math.log(decay))
    rise = lag_s / step * (1 - decay) * decay ** np.arange(count)
    taps: Array = np.append(-rise, 0.0) + np.append(0.0, rise)
    taps[0] += 1
    return taps
