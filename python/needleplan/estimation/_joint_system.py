"""What a joint filter estimates: the state of a model and the coordinates of its free parameters, together.

The joint vector is x = (state, u). The state follows the model, the coordinates do not move by themselves::

    x+ = (step(state; u), u)          y = output(state; u)

A filter needs both with their derivatives. `NumericJoint` has them for any model, by differences in the well-scaled
coordinates of its parameters; a family with closed forms brings its own `Joint`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.models import Model, simulate
from needleplan.signals import Array, Motion

__all__ = ["Joint", "NumericJoint"]


class Joint(ABC):
    """The joint system of a model and its free parameters; abstract.

    `free` are the names of the parameters that are estimated, `states` is the number of states before them in x.
    """

    def __init__(self, model: Model, free: Sequence[str] | None = None) -> None:
        """Take the values of all other parameters from `model`. Raises ModelError for a name that it does not have."""
        known = model.parameters()
        names = tuple(name for name, what in known.items() if what.free) if free is None else tuple(free)
        unknown = [Mistake(name, "", f"must be one of {', '.join(known)}") for name in names if name not in known]
        if unknown:
            raise ModelError(unknown, model.name)
        self.start = model
        self.free = names
        self.states = 0

    @abstractmethod
    def initial(self, model: Model, motion: Motion) -> Array:
        """Return x before the first sample of `motion`, shape (states + free,), with the parameters of `model`."""

    @abstractmethod
    def predict(self, x: Array, before: Motion, after: Motion) -> tuple[Array, Array]:
        """Return x at the instant `after` from x at `before`, and its derivative by x, shape (n, n)."""

    @abstractmethod
    def measure(self, x: Array, motion: Motion) -> tuple[float, Array]:
        """Return the output at an instant, and its derivative by x, shape (n,)."""

    @abstractmethod
    def values(self, x: Array) -> dict[str, float]:
        """Return the values of the free parameters, in their units; x may be anything finite."""

    def model(self, x: Array) -> Model:
        """Return the model at x, with every parameter kept inside of its range."""
        known = self.start.parameters()
        kept = {
            name: float(np.clip(value, known[name].lower, known[name].upper))
            for name, value in self.values(x).items()
        }  # fmt: skip
        return self.start.with_values(**kept)


class NumericJoint(Joint):
    """The joint system of any model: one step of `simulate`, and central differences in the scaled coordinates."""

    def __init__(self, model: Model, free: Sequence[str] | None = None, *, difference: float = 1e-5) -> None:
        """`difference` is the step of the differences, in coordinates (and relative, for states)."""
        super().__init__(model, free)
        self._difference = difference
        self._what = [model.parameters()[name] for name in self.free]

    def initial(self, model: Model, motion: Motion) -> Array:
        """Return the initial state of the model and its coordinates."""
        state = model.initial_state(motion)
        self.states = state.size
        known = model.values()
        return np.array(
            [*state, *(what.coordinate(known[name]) for name, what in zip(self.free, self._what, strict=True))]
        )

    def predict(self, x: Array, before: Motion, after: Motion) -> tuple[Array, Array]:
        """Return the next x and its derivative; 2 n simulations of one step."""
        both = Motion(*(np.array([getattr(before, each.name), getattr(after, each.name)]) for each in fields(Motion)))

        def step(point: Array) -> Array:
            state = simulate(self.model(point), both, point[: self.states]).states[:, -1]
            return np.concatenate([state, point[self.states :]])

        return step(x), self._derivative(step, x)

    def measure(self, x: Array, motion: Motion) -> tuple[float, Array]:
        """Return the output and its derivative; 2 n outputs."""

        def output(point: Array) -> Array:
            return np.atleast_1d(self.model(point).output(point[: self.states], motion))

        return float(output(x)[0]), self._derivative(output, x)[0]

    def values(self, x: Array) -> dict[str, float]:
        """Return the values of the free parameters."""
        with np.errstate(over="ignore"):
            return {
                name: what.value(float(np.clip(u, -700, 700)))
                for name, what, u in zip(self.free, self._what, x[self.states :], strict=True)
            }

    def _derivative(self, function: object, x: Array) -> Array:
        columns = []
        for index in range(x.size):
            width = self._difference * (max(abs(x[index]), 1e-3) if index < self.states else 1.0)
            up, down = x.copy(), x.copy()
            up[index] += width
            down[index] -= width
            columns.append((function(up) - function(down)) / (2 * width))  # type: ignore[operator]
        return np.array(columns).T
