"""Simulation of any model along a sampled motion.

`simulate` chooses one of four integrators.

| model | integrator |
|---|---|
| no state | none: the output is evaluated at all samples at once |
| `LinearStateModel` | fourth-order Magnus integrator, below |
| `SelfIntegratingModel` | the model's own method |
| any other | Kutta's third-order method with `substeps` steps per sample, as in chapter 2 of the thesis |

The Magnus integrator solves z' = a(t) - b(t) z. Let a1, b1 and a2, b2 be the coefficients at the two Gauss points of a
step h::

    z+ = exp(-B) z + A phi(B),     phi(B) = (1 - exp(-B))/B
    B = h (b1 + b2)/2,             A = h (a1 + a2)/2 + sqrt(3)/12 h^2 (b1 a2 - b2 a1)

The integrator is exact for constant coefficients and stable for any b h (Iserles et al., Acta Numerica 9 (2000),
section 5). Between two samples the motion is linear.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.errors import Mistake, ModelError
from needleplan.models._base import LinearStateModel, Model, SelfIntegratingModel
from needleplan.signals import Array, AveragedMotion, Motion, recurrence

__all__ = ["Trajectory", "output_from_rest", "require_model", "simulate"]

# Distance of the two Gauss points from the middle of a step, as a share of the step.
_GAUSS = math.sqrt(3) / 6


def require_model(model: object) -> None:
    """Raise ModelError unless `model` is a model of needleplan.models."""
    if not isinstance(model, Model):
        raise ModelError(Mistake("model", f"<{type(model).__name__}>", "must be a model of needleplan.models"))


def output_from_rest(model: Model, motion: Motion) -> Array:
    """Return the output of a model along a motion that starts at rest, shape (samples,).

    Parameters
    ----------
    model : Model
        The model.
    motion : Motion
        Sampled motion of the needle.

    Returns
    -------
    Array
        Output at every sample.
    """
    direct = _direct(model)
    if direct is not None and not isinstance(motion, AveragedMotion):
        return direct(motion)
    return simulate(model, motion).output


def _direct(model: Model) -> Callable[[Motion], Array] | None:
    """Return the method of a model that gives its output from rest without its states, which is faster, if any."""
    return getattr(model, "output_from_rest", None)


@dataclass(frozen=True)
class Trajectory(ShortRepr):
    """Result of a simulation.

    Parameters
    ----------
    motion : Motion
        The motion along which the model was driven.
    states : Array
        State at every sample, shape (n, samples). Shape (0, samples) along an `AveragedMotion` if the model gives its
        output without them.
    output : Array
        Output at every sample in the unit of the channel, shape (samples,), or (3, samples) for the tip in 3D.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> run = npl.models.simulate(npl.models.Bicycle(0.01), insertion_cycles(50.0, 5.0))
    >>> run.states.shape == (2, len(run.motion)), run.finite
    (True, True)
    """

    motion: Motion
    states: Array
    output: Array

    @property
    def finite(self) -> bool:
        """Whether all outputs are finite. A state may grow without bound for unphysical parameters."""
        return bool(np.isfinite(self.output).all())


def simulate(model: Model, motion: Motion, state: Array | None = None, *, substeps: int = 1) -> Trajectory:
    """Simulate a model along a motion.

    Parameters
    ----------
    model : Model
        The model.
    motion : Motion
        Sampled motion of the needle. For an `AveragedMotion`, states and output are means over its intervals.
    state : Array, optional
        State at the first sample, shape (n,). The default is the model's initial state.
    substeps : int
        Steps from one sample to the next, for models that are integrated by Kutta's method.

    Returns
    -------
    Trajectory
        States and output. A state that grows without bound is returned as infinity or NaN (`Trajectory.finite`).

    Raises
    ------
    ModelError
        If `state` has the wrong shape, or `substeps` is less than 1.

    Examples
    --------
    A needle on an arc of 100 mm radius is inserted by 50 mm:

    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> motion = insertion_cycles(50.0, 5.0)
    >>> run = npl.models.simulate(npl.models.Bicycle(curvature_per_mm=0.01), motion)
    >>> print(f"{run.output.max():.2f} mm at a depth of {motion.depth_mm.max():.0f} mm")
    12.24 mm at a depth of 50 mm
    """
    require_model(model)
    if not isinstance(motion, Motion | AveragedMotion):
        rule = "must be a Motion: Motion.sampled(time_s, depth_mm) makes one of arrays, record.motion() of a trial"
        raise ModelError(Mistake("motion", f"<{type(motion).__name__}>", rule), model.name)
    if isinstance(motion, AveragedMotion):
        if state is None and (direct := _direct(model)) is not None:
            return Trajectory(motion, np.zeros((0, len(motion))), motion.mean(direct(motion.fine)))
        run = simulate(model, motion.fine, state, substeps=substeps)
        return Trajectory(motion, motion.mean(run.states), motion.mean(run.output))
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
