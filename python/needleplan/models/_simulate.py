"""A state that decays from sample to sample: serial, and therefore solved by LAPACK and not by a loop.

----

Simulation of any model along a sampled motion.

Four ways, chosen by what the model is:

- no state: the output is evaluated, and that is all;
- one state that obeys z' = a(t) - b(t) z (`LinearStateModel`): the Magnus integrator of fourth order for that scalar
  equation. With a1, b1 and a2, b2 at the two Gauss points of a step h,
  z+ = exp(-B) z + A phi(B), where B = h (b1 + b2)/2, A = h (a1 + a2)/2 + sqrt(3)/12 h^2 (b1 a2 - b2 a1) and
  phi(B) = (1 - exp(-B))/B. It is exact for constant coefficients and stays stable however large b h is (Iserles et al.,
  Acta Numerica 9 (2000), section 5).
- a member with a method of its own (`SelfIntegratingModel`): that one.
- anything else: Kutta's method of third order, as in the thesis (chapter 2), with `substeps` steps a sample.

Between samples a motion is linear.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtbtrs

from needleplan.errors import Mistake, ModelError
from needleplan.models._base import LinearStateModel, Model, SelfIntegratingModel
from needleplan.signals import Array, Motion

__all__ = ["Trajectory", "recurrence", "simulate"]


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


_GAUSS = math.sqrt(3) / 6


@dataclass(frozen=True)
class Trajectory:
    """What a model did: states (n, samples) and output (samples,) at the samples of the motion."""

    motion: Motion
    states: Array
    output: Array

    @property
    def finite(self) -> bool:
        """Whether all outputs are numbers: a state may grow without bound where parameters are far off."""
        return bool(np.isfinite(self.output).all())


def simulate(model: Model, motion: Motion, state: Array | None = None, *, substeps: int = 1) -> Trajectory:
    """Drive `model` along `motion` from `state`, shape (n,), or from its initial state.

    `substeps` is the number of steps from one sample to the next for models that are integrated by Kutta's method. A
    state that grows without bound is returned as it is, infinite or NaN (`Trajectory.finite`). Raises ModelError where
    `state` has another shape or `substeps` is less than one.
    """
    initial = model.initial_state(motion)
    start = initial if state is None else np.asarray(state, float)
    if start.shape != initial.shape:
        raise ModelError(Mistake("state", f"shape {start.shape}", f"must have the shape {initial.shape}"), model.name)
    if substeps < 1:
        raise ModelError(Mistake("substeps", str(substeps), "must be at least 1"), model.name)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        if start.size == 0:
            states = np.zeros((0, len(motion)))
        elif isinstance(model, SelfIntegratingModel):
            states = model.integrate(motion, start)
        elif isinstance(model, LinearStateModel):
            states = _magnus(model, motion, float(start[0]))
        else:
            states = _kutta(model, motion, start, substeps)
        return Trajectory(motion, states, np.asarray(model.output(states, motion), float))


def _magnus(model: LinearStateModel, motion: Motion, start: float) -> Array:
    step = motion.interval_s
    forcing_1, rate_1 = model.coefficients(motion.between(0.5 - _GAUSS))
    forcing_2, rate_2 = model.coefficients(motion.between(0.5 + _GAUSS))
    decay = step * (rate_1 + rate_2) / 2
    gain = step * (forcing_1 + forcing_2) / 2 + step**2 * (_GAUSS / 2) * (rate_1 * forcing_2 - rate_2 * forcing_1)
    small = np.abs(decay) < 1e-9
    phi = np.where(small, 1.0, -np.expm1(-decay) / np.where(small, 1.0, decay))
    return recurrence(np.exp(-decay), gain * phi, start)[None]


def _kutta(model: Model, motion: Motion, start: Array, substeps: int) -> Array:
    states = np.empty((start.size, len(motion)))
    states[:, 0] = state = start
    step = motion.interval_s / substeps
    stages = [
        (motion.between(sub / substeps), motion.between((sub + 0.5) / substeps), motion.between((sub + 1) / substeps))
        for sub in range(substeps)
    ]
    for sample in range(len(motion) - 1):
        h = step[sample]
        for first, middle, last in stages:
            k1 = model.derivative(state, first[sample])
            k2 = model.derivative(state + h / 2 * k1, middle[sample])
            k3 = model.derivative(state + h * (2 * k2 - k1), last[sample])
            state = state + h / 6 * (k1 + 4 * k2 + k3)
        states[:, sample + 1] = state
    return states
