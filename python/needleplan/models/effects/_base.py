"""Definition of an effect: a property of tissue, needle or sensor that can be added to a model.

An effect has an amplitude (the parameter `size`), which is 0 if the effect is absent, and parameters for its position,
time or rate. Applying an effect to a model gives another model, which can be simulated, fitted and written to a file
like any other. With amplitude 0 this model gives the output of the original model, bit by bit.

Most effects are a *term*: an additional force with its own internal state::

    x' = rate(x, u)          F = F_model + size * shape(x, u)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any, ClassVar, Self

import numpy as np

from needleplan.models._base import Channel, Model, WrappingModel
from needleplan.models._parameter import Parameter, parameters_of
from needleplan.models._simulate import output_from_rest, simulate
from needleplan.signals import Array, AveragedMotion, Motion

__all__ = ["SIZE", "Effect", "Enters", "Family", "Memoryless", "Reach", "Term", "WithTerm", "effect_columns"]

SIZE = "size"
"""Name of the amplitude in model files and in the parameters of an effect."""


class Family(StrEnum):
    """The physical origin of an effect. Effects of one family are easily mistaken for one another."""

    CUTTING = "cutting"
    FRICTION = "friction"
    TISSUE = "tissue"
    SENSOR = "sensor"
    DRIVE = "drive"
    NEEDLE = "needle"


class Enters(StrEnum):
    """Where an effect acts: on the plant (tip, shaft, tissue) or on its measurement (sensor)."""

    TIP = "tip"
    SHAFT = "shaft"
    TISSUE = "tissue"
    SENSOR = "sensor"
    """The effect changes the measurement only; planner and plant leave it out."""


@dataclass(frozen=True)
class Reach:
    """Ranges of depth, speed and duration of the available motions, within which an effect can be found."""

    depth_mm: tuple[float, float]
    speed_mm_s: tuple[float, float]
    duration_s: float

    @classmethod
    def of(cls, motions: Sequence[Motion]) -> Reach:
        """Return the ranges that several motions cover together, with the duration of the longest motion.

        The lower limit of the speed is the 5 % quantile of the samples that are faster than 2 % of the largest speed.
        If nothing moves, both limits are 1 mm/s.
        """
        speeds = np.concatenate([np.abs(motion.velocity_mm_s) for motion in motions])
        moving = speeds[speeds > 0.02 * speeds.max()] if speeds.max() > 0 else np.ones(1)
        return cls(
            (
                min(float(motion.depth_mm.min()) for motion in motions),
                max(float(motion.depth_mm.max()) for motion in motions),
            ),
            (float(np.quantile(moving, 0.05)), float(moving.max())),
            max(float(motion.time_s[-1] - motion.time_s[0]) for motion in motions),
        )


class Effect(ABC):
    """Abstract base class of effects; a plug-in is an instance of a subclass.

    `parameters` declares unit and range of every parameter by name, including the amplitude `size`. A subclass must
    implement `apply`; the other methods have defaults.
    """

    name: str
    """Name of the effect in files and on the command line."""

    title: str
    family: Family
    enters: Enters
    channel: Channel
    parameters: Mapping[str, Parameter]
    equation: str
    meaning: str
    """Explanation for the user of the robot."""

    source: str
    """Publication that describes the effect."""

    version: str = "1"

    repeats: bool = False
    """Whether the effect may be added to one model several times."""

    is_lag: bool = False
    """Whether the effect delays the measurement, as the calibrated sensor lag does."""

    imitated: str = ""
    """Name of a parameter of the base model. With an amplitude below it, the effect imitates another value of it."""

    further: bool = False
    """Whether the effect is left out of the default library; `effects_of(channel, further=True)` includes it."""

    by_trial: tuple[str, ...] = ()
    """Names of the parameters with a separate value for every trial."""

    def suits(self, model: Model) -> bool:  # noqa: ARG002
        """Return whether the effect can be added to a model of its channel. Default: True."""
        return True

    @abstractmethod
    def apply(self, model: Model, values: Mapping[str, float]) -> Model:
        """Return `model` with the effect; `model` itself if the amplitude is 0."""

    def grid(self, reach: Reach) -> list[dict[str, float]]:  # noqa: ARG002
        """Return the points of the search grid, each with parameter values by name. Default: one point without values.

        The points usually leave out the amplitude.
        """
        return [{}]

    def nearby(
        self,
        values: Mapping[str, float],  # noqa: ARG002
        reach: Reach,  # noqa: ARG002
        scale: float,  # noqa: ARG002
    ) -> list[dict[str, float]]:
        """Return further start values of a fit around `values`; a smaller `scale` (at most 1) gives closer values.

        Default: none. Override this method for strongly nonlinear effects, which may have several local optima between
        two grid points.
        """
        return []

    def columns(self, model: Model, motion: Motion, grid: Sequence[Mapping[str, float]]) -> Array:
        """Return the derivative of the output by the amplitude at each point of the grid, shape (samples, len(grid)).

        For an output of the shape (axes, samples) the rows of the axes follow one another: (axes * samples, len(grid)).
        Default: difference quotient of two simulations, with and without the effect. The amplitude is that of the grid
        point, or else a thousandth of the typical amplitude.
        """
        plain = output_from_rest(model, motion)
        small = 1e-3 * self.parameters[SIZE].typical
        columns = np.empty((plain.size, len(grid)))
        for index, values in enumerate(grid):
            step = values.get(SIZE, small)
            gained = output_from_rest(self.apply(model, {**values, SIZE: step}), motion) - plain
            columns[:, index] = gained.ravel() / step
        return columns


def effect_columns(effect: Effect, model: Model, motion: Motion, grid: Sequence[Mapping[str, float]]) -> Array:
    """Return the sensitivity of the output to the amplitude of an effect at grid points.

    Parameters
    ----------
    effect, model : Effect, Model
        The effect, and the model that it would be added to.
    motion : Motion
        Motion of the needle. For an `AveragedMotion` the sensitivities are means over its intervals.
    grid : sequence of mappings
        Parameter values of each point.

    Returns
    -------
    Array
        Sensitivities, shape (axes * samples, len(grid)).
    """
    if not isinstance(motion, AveragedMotion):
        return effect.columns(model, motion, grid)
    columns = effect.columns(model, motion.fine, grid).T
    axes = columns.shape[1] // len(motion.fine)
    means = motion.mean(np.ascontiguousarray(columns).reshape(len(grid), axes, len(motion.fine)))
    return np.ascontiguousarray(means.reshape(len(grid), -1).T)


@dataclass(frozen=True, kw_only=True)
class Term(ABC):
    """Abstract base class of a force that is added to the output of a model; its fields are its parameters.

    The term has its own internal state of k numbers. The shapes are as in `Model`.
    """

    order: ClassVar[int]
    """k, the number of internal states of the term."""

    size: float

    @abstractmethod
    def initial(self, motion: Motion) -> Array:
        """Return the internal state at the first sample, shape (k,), for a start from rest."""

    @abstractmethod
    def rate(self, state: Array, motion: Motion) -> Array:
        """Return the rate of change of the internal state per second, shape (k, ...)."""

    @abstractmethod
    def states(self, motion: Motion, start: Array) -> Array:
        """Return the internal state at every sample, shape (k, samples); `start` is the state at the first sample."""

    @abstractmethod
    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:
        """Return the additional output for amplitude 1, shape (...); `plain` is the output without the term."""

    @classmethod
    def parameters(cls) -> dict[str, Parameter]:
        """Return the declaration of every parameter, by name."""
        return parameters_of(cls)

    def with_values(self, **values: float) -> Self:
        """Return a copy of the term with some parameters changed."""
        changed: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)} | values
        return type(self)(**changed)


@dataclass(frozen=True, kw_only=True)
class Memoryless(Term):
    """Abstract base class of a term without an internal state. A subclass must implement `shape` only."""

    order: ClassVar[int] = 0

    def initial(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return the empty state, shape (0,)."""
        return np.zeros(0)

    def rate(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return an empty array, because there is no state, shape (0, ...)."""
        return state

    def states(self, motion: Motion, start: Array) -> Array:  # noqa: ARG002
        """Return the empty states, shape (0, samples)."""
        return np.zeros((0, len(motion)))


@dataclass(frozen=True)
class WithTerm(WrappingModel):
    """A model with an additional term. The internal state of the term follows the state of the model."""

    base: Model
    term: Term

    def initial_state(self, motion: Motion) -> Array:
        """Return the state at rest, shape (n + k,)."""
        return np.concatenate([self.base.initial_state(motion), self.term.initial(motion)])

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of change of both states, shape (n + k, ...)."""
        base_state, memory = self._split(state)
        return np.concatenate([self.base.derivative(base_state, motion), self.term.rate(memory, motion)])

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the sum of the base output and the term; the base output itself if the amplitude is 0."""
        base_state, memory = self._split(state)
        plain = self.base.output(base_state, motion)
        return np.asarray(plain + self.term.size * self.term.shape(memory, motion, plain)) if self.term.size else plain

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states of model (n) and term (k) at every sample, shape (n + k, samples)."""
        base_state, memory = self._split(start)
        return np.concatenate([simulate(self.base, motion, base_state).states, self.term.states(motion, memory)])

    def output_from_rest(self, motion: Motion) -> Array:
        """Return the output along a motion that starts at rest, shape (samples,)."""
        plain = output_from_rest(self.base, motion)
        memory = self.term.states(motion, self.term.initial(motion))
        return np.asarray(plain + self.term.size * self.term.shape(memory, motion, plain)) if self.term.size else plain

    def _split(self, state: Array) -> tuple[Array, Array]:
        count = len(state) - self.term.order
        return state[:count], state[count:]
