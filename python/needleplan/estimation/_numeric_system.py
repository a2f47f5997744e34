"""The joint system of any model, with derivatives by central differences.

A step needs the model at 2 n + 1 points x: the estimate, and two points beside it for each of n components. One call of
the model takes all points at once: the parameters become arrays of the shape (2 n + 1,), the state has the shape
(states, 2 n + 1), and the motion is repeated. This works for a model whose functions broadcast, as those of a
`LinearStateModel` or of a model that is integrated by Kutta's method do. Two safeguards:

- A function that does not broadcast, for example with an `if` on a parameter, raises TypeError or ValueError. From then
  on, the points are computed one by one.
- At the first call, the points are computed in both ways. If the results differ, they are computed one by one.

A `SelfIntegratingModel` steps point by point, unless it has a method `step`. The points are models without the
checks of the constructor; their parameters are clipped to the ranges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields

import numpy as np

from needleplan.estimation._joint_system import JointSystem
from needleplan.models import LinearStateModel, Model, Scale, SelfIntegratingModel, simulate
from needleplan.signals import Array, Motion

__all__ = ["NumericJointSystem"]

# Distance of the two Gauss points from the middle of a step, as a share of the step (see `simulate`).
_GAUSS = math.sqrt(3) / 6
# Relative difference of both ways at the first call above which points are computed one by one.
_SAME = 1e-6
# Largest coordinate with the scale LOG, so that exp does not overflow.
_FURTHEST = 700.0

Values = Callable[[Model, Array], Array]
"""Function from a model, with numbers or arrays as parameters, and a state to values of the shape (k, ...)."""


class NumericJointSystem(JointSystem):
    """The joint system of any model. Derivatives are central differences."""

    states: int

    def __init__(
        self, model: Model, free: Sequence[str] | None = None, *, difference: float = 1e-5, at_once: bool = True
    ) -> None:
        """Use differences of the width `difference`: absolute for coordinates, relative for states.

        With `at_once` False, the points of a difference are simulated one by one by `simulate`, with all checks. This
        is the slow reference of the tests. The other arguments are those of `JointSystem`.
        """
        super().__init__(model, free)
        self._difference = difference
        self._what = [model.parameters()[name] for name in self.free]
        self._fields = {field.name: getattr(model, field.name) for field in fields(model)}
        self._log = np.array([parameter.scale is Scale.LOG for parameter in self._what], bool)[:, None]
        self._typical = np.array([parameter.typical for parameter in self._what])[:, None]
        self._lower = np.array([parameter.lower for parameter in self._what])[:, None]
        self._upper = np.array([parameter.upper for parameter in self._what])[:, None]
        self._checked = not at_once
        # Whether steps, and outputs, are computed for all points at once; None: not yet tried.
        self._steps_at_once: bool | None = None if at_once else False
        self._outputs_at_once: bool | None = None if at_once else False

    def initial(self, model: Model, motion: Motion) -> Array:
        """Return the initial state of the model and the coordinates of its parameters. Sets `states`."""
        state = model.initial_state(motion)
        self.states = state.size
        known = model.values()
        return np.array(
            [
                *state,
                *(parameter.coordinate(known[name]) for name, parameter in zip(self.free, self._what, strict=True)),
            ]
        )

    def predict(self, x: Array, before: Motion, after: Motion) -> tuple[Array, Array]:
        """Return the next x and its derivative, from 2 n + 1 steps."""
        n = self.states
        points, widths = self._points(x)
        both = Motion(
            *(np.array([getattr(before, field.name), getattr(after, field.name)]) for field in fields(Motion))
        )

        def step(model: Model, state: Array) -> Array:
            if self._checked:
                return simulate(model, both, state).states[:, -1]
            if isinstance(model, SelfIntegratingModel):
                if state.ndim == 1:
                    return np.asarray(model.integrate(both, state)[:, -1])
                return model.step(state, before, after)
            return _step(model, both, state)

        moved = points.copy()
        if n:
            moved[:n], self._steps_at_once = self._at(points, step, self._steps_at_once)
        change = (moved[:, 1 : x.size + 1] - moved[:, x.size + 1 :]) / widths
        return moved[:, 0], change

    def measure(self, x: Array, motion: Motion) -> tuple[float, Array]:
        """Return the output and its derivative, from 2 n + 1 outputs."""
        points, widths = self._points(x)

        def output(model: Model, state: Array) -> Array:
            told = motion if state.ndim == 1 else _repeated(motion, state.shape[1])
            return np.reshape(model.output(state, told), (1, *state.shape[1:]))

        seen, self._outputs_at_once = self._at(points, output, self._outputs_at_once)
        return float(seen[0, 0]), (seen[0, 1 : x.size + 1] - seen[0, x.size + 1 :]) / widths

    def values(self, x: Array) -> dict[str, float]:
        """Return the values of the free parameters."""
        return dict(zip(self.free, self._natural(x[self.states :, None])[:, 0].tolist(), strict=True))

    def _points(self, x: Array) -> tuple[Array, Array]:
        """Return x and the points beside it, shape (n, 2 n + 1), and the distances of opposite points, shape (n,)."""
        width = np.full(x.size, self._difference)
        width[: self.states] *= np.maximum(np.abs(x[: self.states]), 1e-3)
        offsets = np.diag(width)
        return np.concatenate([x[:, None], x[:, None] + offsets, x[:, None] - offsets], axis=1), 2 * width

    def _natural(self, coordinates: Array) -> Array:
        """Return the values of the free parameters, of the shape of the coordinates, (free, points)."""
        bounded = np.minimum(np.maximum(coordinates, -_FURTHEST), _FURTHEST)
        return np.where(self._log, np.exp(np.where(self._log, bounded, 0.0)), bounded * self._typical)

    def _at(self, points: Array, function: Values, at_once: bool | None) -> tuple[Array, bool | None]:
        """Return the function at all points, shape (k, points), and whether it can be computed at once (None: open)."""
        values = np.minimum(np.maximum(self._natural(points[self.states :]), self._lower), self._upper)
        if at_once is False:
            return self._one_by_one(points, values, function), False
        try:
            outputs = np.asarray(function(self._unchecked(list(values)), points[: self.states]))
        except NotImplementedError:
            return self._one_by_one(points, values, function), at_once
        except (TypeError, ValueError):
            return self._one_by_one(points, values, function), False
        if at_once is None:
            slow = self._one_by_one(points, values, function)
            if outputs.shape != slow.shape or not np.allclose(outputs, slow, rtol=_SAME, atol=_SAME, equal_nan=True):
                return slow, False
        return outputs, True

    def _one_by_one(self, points: Array, values: Array, function: Values) -> Array:
        columns = []
        for point, row in zip(points.T, values.T.tolist(), strict=True):
            model = (
                self.start.with_values(**dict(zip(self.free, row, strict=True)))
                if self._checked
                else self._unchecked(row)
            )
            columns.append(function(model, point[: self.states]))
        return np.array(columns).T

    def _unchecked(self, values: Sequence[float | Array]) -> Model:
        """Return the model with other values of the free parameters, without the checks of the constructor."""
        model = object.__new__(type(self.start))
        model.__dict__.update(self._fields)
        model.__dict__.update(zip(self.free, values, strict=True))
        return model


def _repeated(motion: Motion, count: int) -> Motion:
    """Return the motion of one instant, repeated: shape (count,)."""
    return Motion(*(np.full(count, getattr(motion, field.name)) for field in fields(Motion)))


def _step(model: Model, both: Motion, state: Array) -> Array:
    """Return the state after a step between the two samples of `both`, shape (states, ...), as `simulate` does."""
    h = float(both.time_s[1] - both.time_s[0])

    def at(share: float) -> Motion:
        instant = both.between(share)[0]
        return instant if state.ndim == 1 else _repeated(instant, state.shape[1])

    if isinstance(model, LinearStateModel):
        forcing_1, rate_1 = model.coefficients(at(0.5 - _GAUSS))
        forcing_2, rate_2 = model.coefficients(at(0.5 + _GAUSS))
        decay = h * (rate_1 + rate_2) / 2
        gain = h * (forcing_1 + forcing_2) / 2 + h**2 * (_GAUSS / 2) * (rate_1 * forcing_2 - rate_2 * forcing_1)
        small = np.abs(decay) < 1e-9
        phi = np.where(small, 1.0, -np.expm1(-decay) / np.where(small, 1.0, decay))
        return np.asarray(np.exp(-decay) * state + gain * phi)
    first, middle, last = at(0.0), at(0.5), at(1.0)
    k1 = model.derivative(state, first)
    k2 = model.derivative(state + h / 2 * k1, middle)
    k3 = model.derivative(state + h * (2 * k2 - k1), last)
    return np.asarray(state + h / 6 * (k1 + 4 * k2 + k3))
