"""Integration of a needle in moving tissue: one scalar equation per sample, in Python floats.

A step of length h from one sample to the next uses the means of the coefficients at its two ends::

    z+ = (z + A (1 + B/2)) / (1 + B + B^2/2),   A = h (forcing + forcing+)/2,   B = h (rate + rate+)/2
    u+ = u + h (s + s+)/2
    m (s+ - s)/h + c s+ + k u+ = F(z+, v+ - s+)

The first line is exp(-B) z + A (1 - exp(-B))/B to second order, and is stable for any B. The last line is solved for s+
by the secant method, from an extrapolation of the previous velocities. If the secant method does not reach a stable
root, `first_root` searches for it.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Protocol

import numpy as np
from scipy.optimize import brentq

from needleplan.signals import Array, Motion

__all__ = ["FrictionLaw", "bristle_step", "first_root", "step_through", "stepping"]

# Residual force at which a step counts as solved, N.
_TOLERANCE_N = 1e-12
# Number of secant steps before the search for the first root.
_SECANTS = 12
# First step of the search for the first root, mm/s; each further step is 20 % longer.
_FIRST_STEP_MM_S = 0.01
# Change of the tissue velocity beyond which the search gives up and the state becomes NaN, mm/s.
_FARTHEST_MM_S = 1e5


class FrictionLaw(Protocol):
    """Interface of a friction law with one bristle, evaluated with Python floats at a sample of a motion.

    `w_mm_s` is the velocity of the needle relative to the tissue. `bending` is the state of the bristle, `bending_rate`
    the rate of change of this state per second.
    """

    def coefficients(self, sample: int, w_mm_s: float) -> tuple[float, float]:
        """Return the forcing (unit of the bristle per second) and the rate (1/s) of the bristle."""

    def force(self, sample: int, w_mm_s: float, bending: float, bending_rate: float) -> float:
        """Return the friction on the needle (N)."""


def step_through(law: FrictionLaw, k: float, c: float, m: float, motion: Motion, start: Array) -> Array:
    """Return bristle state, tissue displacement (mm) and tissue velocity (mm/s) at every sample, shape (3, samples).

    `start`, shape (3,), is the state at the first sample. All samples after the state has grown without bound are NaN.
    """
    times, needle = motion.time_s.tolist(), motion.velocity_mm_s.tolist()
    bent, moved, speed = (float(number) for number in start)
    steps = stepping(law, k, c, m, needle[0], (bent, moved, speed))
    next(steps)
    rows = [(bent, moved, speed)]
    for sample in range(1, len(times)):
        row = steps.send((sample, times[sample] - times[sample - 1], needle[sample]))
        if row[2] != row[2]:
            break
        rows.append(row[:3])
    states = np.full((3, len(times)), np.nan)
    states[:, : len(rows)] = np.array(rows).T
    return states


def bristle_step(bent: float, half_s: float, forcing: tuple[float, float], rate: tuple[float, float]) -> float:
    """Return the bristle state after a step of twice `half_s`; `forcing` and `rate` have values at both ends."""
    decay = half_s * (rate[0] + rate[1])
    return (bent + half_s * (forcing[0] + forcing[1]) * (1 + decay / 2)) / (1 + decay + decay * decay / 2)


def stepping(
    law: FrictionLaw, k: float, c: float, m: float, velocity: float, start: tuple[float, float, float], first: int = 0
) -> Generator[tuple[float, float, float, float], tuple[int, float, float], None]:
    """Return a generator that integrates step by step, for motions that are not known in advance.

    The generator receives the sample (an index for `law`), the length of the step (s) and the velocity of the needle at
    the end of the step. The generator yields bristle state, tissue displacement (mm), tissue velocity (mm/s) and force
    on the needle (N). All four are NaN if the motion has diverged. `velocity` is the velocity of the needle at the
    sample `first`, and `start` is the state there. `k`, `c` and `m` are stiffness, damping and mass of the tissue.
    """
    coefficients, friction = law.coefficients, law.force
    bent, moved, speed = start
    forcing, rate = coefficients(first, velocity - speed)
    sample, half, held, spring, force = first, 0.0, 0.0, c, 0.0
    new_bent = new_forcing = new_rate = 0.0

    def balance(tried: float) -> float:
        """Return resisting minus driving force on the tissue (N) for the velocity `tried` at the end of the step."""
        nonlocal new_bent, new_forcing, new_rate, force
        relative = velocity - tried
        new_forcing, new_rate = coefficients(sample, relative)
        new_bent = bristle_step(bent, half, (forcing, new_forcing), (rate, new_rate))
        force = friction(sample, relative, new_bent, new_forcing - new_rate * new_bent)
        return held + spring * tried - force

    before = earlier = speed
    slope = c + 1.0
    while True:
        sample, step, velocity = yield bent, moved, speed, force
        half = step / 2
        held = k * (moved + half * speed) - m / step * speed
        spring = c + m / step + k * half
        tried = 3 * (speed - before) + earlier
        error = balance(tried)
        for _ in range(_SECANTS):
            if -_TOLERANCE_N < error < _TOLERANCE_N or not slope > 0:
                break
            last, tried = tried, tried - error / slope
            last_error, error = error, balance(tried)
            if tried == last:
                error = 0.0
                break
            slope = (error - last_error) / (tried - last)
        if not (slope > 0 and -_TOLERANCE_N < error < _TOLERANCE_N):
            tried = first_root(balance, speed)
            slope = c + 1.0
            balance(tried)
        earlier, before, moved, speed = before, speed, moved + half * (speed + tried), tried
        bent, forcing, rate = new_bent, new_forcing, new_rate


def first_root(balance: Callable[[float], float], speed: float) -> float:
    """Return the equilibrium velocity (mm/s) of the tissue nearest to `speed` in the direction of the force, or NaN.

    NaN means that no equilibrium was found. `balance` is the resisting force minus the driving force (N) as a function
    of the velocity: the tissue decelerates if `balance` is positive.
    """
    error = balance(speed)
    if error == 0:
        return speed
    near, step = speed, -_FIRST_STEP_MM_S if error > 0 else _FIRST_STEP_MM_S
    while abs(near - speed) < _FARTHEST_MM_S:
        far = near + step
        beyond = balance(far)
        if beyond != beyond:
            break
        if (beyond > 0) != (error > 0):
            return float(brentq(balance, near, far, xtol=1e-13, rtol=1e-14))
        near, step = far, 1.2 * step
    return float("nan")
