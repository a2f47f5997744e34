"""Joint systems: the state of a model and its free parameters as one state vector of a Kalman filter.

The joint vector is x = (state, u), where u are the scaled coordinates of the free parameters. The state follows the
model, and the coordinates are constant::

    x+ = (step(state; u), u)          y = output(state; u)

A filter needs both functions and their derivatives. `NumericJointSystem` computes the derivatives of any model by
central differences. `JointForce` has closed forms for the force-depth models.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import exp, log

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.models import Model
from needleplan.models.force import DepthForce
from needleplan.models.force.sensitivity import NAMES, Row, Values, exponential_step, force
from needleplan.signals import Array, Motion

__all__ = ["JointForce", "JointSystem"]

_F1, _F2 = NAMES.index("f1"), NAMES.index("f2")

# Value of f2 (N/mm) per unit of its coordinate.
_F2_SCALE = 0.02

# Bound of a coordinate: beyond e^40 the filter has diverged, and exp must not overflow before it reports that.
_FURTHEST = 40.0


class JointSystem(ABC):
    """The joint system of a model and its free parameters; abstract.

    `start` is the model with the fixed parameters, `free` are the names of the estimated parameters, and `states` is
    the number of states, which precede the coordinates in x. Call `initial` first: it may set `states`.
    """

    def __init__(self, model: Model, free: Sequence[str] | None = None) -> None:
        """Estimate the parameters named in `free`, and fix all others at their values in `model`.

        If `free` is None, all parameters are estimated that the model declares as free. Raises ModelError if `free`
        names a parameter that the model does not have.
        """
        known = model.parameters()
        names = tuple(name for name, parameter in known.items() if parameter.free) if free is None else tuple(free)
        unknown = [Mistake(name, "", f"must be one of {', '.join(known)}") for name in names if name not in known]
        if unknown:
            raise ModelError(unknown, model.name)
        self.start = model
        self.free: tuple[str, ...] = names
        self.states = 0

    @abstractmethod
    def initial(self, model: Model, motion: Motion) -> Array:
        """Return the joint vector before the first sample.

        Parameters
        ----------
        model : Model
            Model with the initial values of the parameters.
        motion : Motion
            Motion, or its first instant.

        Returns
        -------
        numpy.ndarray
            Joint vector (state, coordinates), shape (states + free,).
        """

    @abstractmethod
    def predict(self, x: Array, before: Motion, after: Motion) -> tuple[Array, Array]:
        """Return the joint vector one step later, and its derivative.

        Parameters
        ----------
        x : numpy.ndarray
            Joint vector at `before`, shape (n,).
        before : Motion
            Instant at which the step begins.
        after : Motion
            Instant at which the step ends.

        Returns
        -------
        tuple of numpy.ndarray
            Joint vector at `after`, shape (n,), and its Jacobian with respect to `x`, shape (n, n).
        """

    @abstractmethod
    def measure(self, x: Array, motion: Motion) -> tuple[float, Array]:
        """Return the output at an instant, and its gradient.

        Parameters
        ----------
        x : numpy.ndarray
            Joint vector, shape (n,).
        motion : Motion
            Instant.

        Returns
        -------
        tuple of float and numpy.ndarray
            Output in the unit of the channel, and its derivative with respect to `x`, shape (n,).
        """

    @abstractmethod
    def values(self, x: Array) -> dict[str, float]:
        """Return the values of the free parameters at x by name, in their units."""

    def released(self, model: Model, factor: float) -> Model:  # noqa: ARG002
        """Return a model with parameters away from their bounds, to start a filter from.

        At a bound, the output may not depend on the coordinate of a parameter. By default, the model is returned
        unchanged.

        Parameters
        ----------
        model : Model
            Model with the initial values of the parameters.
        factor : float
            Factor by which each parameter may be wrong.

        Returns
        -------
        Model
        """
        return model

    def model(self, x: Array) -> Model:
        """Return the model with the parameters at x, each clipped to its range."""
        known = self.start.parameters()
        kept = {
            name: float(np.clip(value, known[name].lower, known[name].upper))
            for name, value in self.values(x).items()
        }  # fmt: skip
        return self.start.with_values(**kept)


class JointForce(JointSystem):
    """The joint system of a force-depth model in closed form, in coordinates that keep the model stable.

    The coordinates are the logarithms of the parameters, except f2, which may be negative, and f1::

        f2 = 0.02 u          f1 = max(0, -f2) + exp(u)

    If f1 is free, g(l) = f1 + f2 exp(-alpha l) is therefore positive at every depth for all coordinates. The bristle
    deflection z takes an exponential step, which is bounded for any step size. With these two measures, the filter
    converges from initial parameters that are wrong by a factor of six. Without them, as the thesis reports for
    f2(0) = -0.01, "the filter tended to be unstable".
    """

    def __init__(self, model: DepthForce, free: Sequence[str] | None = None) -> None:
        """Take the arguments of `JointSystem`. Raises ModelError also if g(l) of `model` is not positive everywhere."""
        super().__init__(model, free)
        if not model.proper:
            raise ModelError(Mistake("f1", f"{model.f1:g}", "f1 and f1 + f2 must be positive"), model.name)
        self.states = 1
        self._fixed = [getattr(model, name) for name in NAMES]
        self._identity = np.eye(1 + len(self.free))
        self._places = [NAMES.index(name) for name in self.free]

    def initial(self, model: Model, motion: Motion) -> Array:  # noqa: ARG002
        """Return z = 0 and the coordinates of the free parameters."""
        return np.array([0.0, *(self._coordinate(model, name) for name in self.free)])

    def released(self, model: Model, factor: float) -> Model:
        """Return the model with f1 away from its bound.

        The true f1 is assumed to be between f1/factor and f1 factor, and above the bound b = max(0, -f2). If f1/factor
        is below b, the middle of the remaining interval is sqrt(b f1 factor), on a logarithmic scale. f1 is moved to
        this middle if f1 - b is smaller by more than the factor, because the filter would not reach the middle from
        there.
        """
        f1, floor = model.values()["f1"], max(0.0, -model.values()["f2"])
        middle = max(f1, (floor * f1 * factor) ** 0.5)
        clipped = "f1" in self.free and f1 < factor * floor and factor * (f1 - floor) < middle - floor
        return model.with_values(f1=middle) if clipped else model

    def predict(self, x: Array, before: Motion, after: Motion) -> tuple[Array, Array]:
        """Return the next x and its derivative. During the step, the depth is fixed at the mean of both depths."""
        z, *coordinates = x.tolist()
        values, slopes, floor_moves = self._natural(coordinates)
        middle = (float(before.depth_mm) + float(after.depth_mm)) / 2
        step = float(after.time_s) - float(before.time_s)
        row = exponential_step(z, values, middle, step)
        change = self._identity.copy()
        change[0] = self._chain(row, slopes, floor_moves)
        return np.array([row[0], *coordinates]), change

    def measure(self, x: Array, motion: Motion) -> tuple[float, Array]:
        """Return the force (N) and its derivative."""
        z, *coordinates = x.tolist()
        values, slopes, floor_moves = self._natural(coordinates)
        row = force(z, values, float(motion.depth_mm), float(motion.direction))
        return row[0], np.array(self._chain(row, slopes, floor_moves))

    def values(self, x: Array) -> dict[str, float]:
        """Return the values of the free parameters."""
        values, _, _ = self._natural(x[1:].tolist())
        return {name: values[place] for name, place in zip(self.free, self._places, strict=True)}

    def _coordinate(self, model: Model, name: str) -> float:
        value = getattr(model, name)
        if name == "f2":
            return float(value / _F2_SCALE)
        floor = max(0.0, -model.values()["f2"]) if name == "f1" else 0.0
        return log(value - floor)

    def _natural(self, coordinates: list[float]) -> tuple[Values, list[float], bool]:
        """Return all seven parameters, d(value)/du of the free parameters, and whether f1 depends on f2.

        Coordinates u beyond +-40 count as +-40.
        """
        values, slopes = self._fixed.copy(), []
        for place, u in zip(self._places, coordinates, strict=True):
            bounded = min(max(u, -_FURTHEST), _FURTHEST)
            value = bounded * _F2_SCALE if place == _F2 else exp(bounded)
            values[place] = value
            slopes.append(_F2_SCALE if place == _F2 else value)
        floor = max(0.0, -values[_F2])
        free_f1 = _F1 in self._places
        if free_f1:
            values[_F1] += floor
        sigma0, sigma1, sigma2, f1, f2, alpha, beta = values
        return (sigma0, sigma1, sigma2, f1, f2, alpha, beta), slopes, free_f1 and floor > 0

    def _chain(self, row: Row, slopes: list[float], floor_moves: bool) -> list[float]:
        """Return the derivative of `row` with respect to z and the free coordinates."""
        _, by_z, by_values = row
        chained = [by_z]
        for place, slope in zip(self._places, slopes, strict=True):
            by = by_values[place] - by_values[_F1] if place == _F2 and floor_moves else by_values[place]
            chained.append(by * slope)
        return chained
