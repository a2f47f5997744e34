"""What an effect is: something of the tissue, the needle or a sensor that a model lacks, and how it is added.

An effect has a size, 0 where it is not there, and parameters that say where, when or how fast. Added to a model it
makes another model, that simulates, filters, is fitted and written like any. At size 0 that model gives what the first
gives, to the last bit.

Most effects are a *term*: a force that is added to that of the model, with a memory of its own::

    x' = rate(x, u)          F = F_model + size * shape(x, u)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any, ClassVar, Self

import numpy as np

from needleplan.models._base import Channel, Model, Parameter, SelfIntegratingModel, parameters_of
from needleplan.models._simulate import simulate
from needleplan.signals import Array, Motion

__all__ = ["SIZE", "Effect", "Enters", "Family", "Memoryless", "Reach", "Term", "WithTerm"]

SIZE = "size"
"""Name of the parameter that is 0 where an effect is absent."""


class Family(StrEnum):
    """Which physics an effect belongs to; effects of one family are the ones that are mistaken for one another."""

    CUTTING = "cutting"
    FRICTION = "friction"
    TISSUE = "tissue"
    SENSOR = "sensor"
    DRIVE = "drive"
    NEEDLE = "needle"


class Enters(StrEnum):
    """Where an effect enters: decides whether it belongs to the plant or to its measurement."""

    TIP = "tip"
    SHAFT = "shaft"
    TISSUE = "tissue"
    SENSOR = "sensor"
    """What is measured, and not what happens: planner and plant leave it out."""


@dataclass(frozen=True)
class Reach:
    """What the motions at hand visit: the hull in which an effect can be looked for."""

    depth_mm: tuple[float, float]
    speed_mm_s: tuple[float, float]
    duration_s: float

    @classmethod
    def of(cls, motions: Sequence[Motion]) -> Reach:
        """Return the hull of some motions; the lower speed is that of the slowest twentieth of what moves."""
        speeds = np.concatenate([np.abs(each.velocity_mm_s) for each in motions])
        moving = speeds[speeds > 0.02 * speeds.max()] if speeds.max() > 0 else np.ones(1)
        return cls(
            (min(float(each.depth_mm.min()) for each in motions), max(float(each.depth_mm.max()) for each in motions)),
            (float(np.quantile(moving, 0.05)), float(moving.max())),
            max(float(each.time_s[-1] - each.time_s[0]) for each in motions),
        )


class Effect(ABC):
    """An effect that can be looked for, named and added; abstract. A plug-in is an object of a member.

    `parameters` gives units and bounds by name, `size` among them. Only `apply` must be written.
    """

    name: str
    """Name in files and on the command line."""

    title: str
    family: Family
    enters: Enters
    channel: Channel
    parameters: Mapping[str, Parameter]
    equation: str
    meaning: str
    """In words for the lab."""

    source: str
    """Paper or page."""

    version: str = "1"

    repeats: bool = False
    """Whether there may be several of it."""

    is_lag: bool = False
    """Whether it makes the reading late, as a calibration does too."""

    def suits(self, model: Model) -> bool:  # noqa: ARG002
        """Whether it can be added to a model. Default: to any of its channel."""
        return True

    @abstractmethod
    def apply(self, model: Model, values: Mapping[str, float]) -> Model:
        """Return `model` with the effect of these values; the model itself, where the size is 0."""

    def grid(self, reach: Reach) -> list[dict[str, float]]:  # noqa: ARG002
        """Return where its other parameters are looked for: values by name, without the size. Default: nowhere else."""
        return [{}]

    def nearby(
        self,
        values: Mapping[str, float],  # noqa: ARG002
        reach: Reach,  # noqa: ARG002
        scale: float,  # noqa: ARG002
    ) -> list[dict[str, float]]:
        """Return what to try about where a fit is to start, the size too, from far (scale 1) to near. Default: nothing.

        For effects that are far from linear: between two places of a grid there may be more than one hill.
        """
        return []

    def columns(self, model: Model, motion: Motion, grid: Sequence[Mapping[str, float]]) -> Array:
        """Return what the output gains for a unit of size, shape (samples, len(grid)).

        Where the output has several axes, shape (axes, samples), they follow one another: (axes * samples, len(grid)).
        Default: the difference of two simulations, with the size of the grid, or else a thousandth of its scale.
        """
        plain = simulate(model, motion).output
        small = 1e-3 * self.parameters[SIZE].typical
        found = np.empty((plain.size, len(grid)))
        for index, values in enumerate(grid):
            step = values.get(SIZE, small)
            gained = simulate(self.apply(model, {**values, SIZE: step}), motion).output - plain
            found[:, index] = gained.ravel() / step
        return found


@dataclass(frozen=True, kw_only=True)
class Term(ABC):
    """What is added to the output of a model, with a memory of its own; abstract. Its fields are its parameters.

    Shapes as for a model. `states` is `rate` integrated along a motion, in closed form where there is one.
    """

    name: ClassVar[str]
    order: ClassVar[int]
    """How many numbers the memory has, k."""

    size: float

    @abstractmethod
    def initial(self, motion: Motion) -> Array:
        """Return the memory before the first sample, shape (k,)."""

    @abstractmethod
    def rate(self, state: Array, motion: Motion) -> Array:
        """Return the rate of change of the memory per second, shape (k, ...)."""

    @abstractmethod
    def states(self, motion: Motion, start: Array) -> Array:
        """Return the memory at the samples, shape (k, samples), from `start` at the first."""

    @abstractmethod
    def shape(self, state: Array, motion: Motion, plain: Array) -> Array:
        """Return what is added for size 1, shape (...); `plain` is the output of the model without the term."""

    @classmethod
    def parameters(cls) -> dict[str, Parameter]:
        """Return the parameters by name."""
        return parameters_of(cls)

    def with_values(self, **values: float) -> Self:
        """Return the term with some parameters changed."""
        changed: dict[str, Any] = {each.name: getattr(self, each.name) for each in fields(self)} | values
        return type(self)(**changed)


@dataclass(frozen=True, kw_only=True)
class Memoryless(Term):
    """A term without a memory; abstract. Only `shape` must be written."""

    order: ClassVar[int] = 0

    def initial(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return nothing, shape (0,)."""
        return np.zeros(0)

    def rate(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return nothing, shape (0, ...)."""
        return state

    def states(self, motion: Motion, start: Array) -> Array:  # noqa: ARG002
        """Return nothing, shape (0, samples)."""
        return np.zeros((0, len(motion)))


@dataclass(frozen=True)
class WithTerm(SelfIntegratingModel):
    """A model and a term. State: that of the model, then the memory of the term."""

    base: Model
    term: Term

    @property
    def channel(self) -> Channel:  # type: ignore[override]
        """What the base predicts."""
        return self.base.channel

    def initial_state(self, motion: Motion) -> Array:
        """Return the states at rest, shape (n + k,)."""
        return np.concatenate([self.base.initial_state(motion), self.term.initial(motion)])

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of both, shape (n + k, ...)."""
        own, memory = self._split(state)
        return np.concatenate([self.base.derivative(own, motion), self.term.rate(memory, motion)])

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the output of the base and what the term adds; the first alone, where the size is 0."""
        own, memory = self._split(state)
        plain = self.base.output(own, motion)
        return np.asarray(plain + self.term.size * self.term.shape(memory, motion, plain)) if self.term.size else plain

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states, shape (n + k, samples)."""
        own, memory = self._split(start)
        return np.concatenate([simulate(self.base, motion, own).states, self.term.states(motion, memory)])

    def _split(self, state: Array) -> tuple[Array, Array]:
        count = len(state) - self.term.order
        return state[:count], state[count:]
