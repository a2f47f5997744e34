"""Effects that a catalogue entry defines: equation, explanation, search grid, and the class that implements them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.errors import Mistake, ModelError
from needleplan.models._base import Channel, Model
from needleplan.models._parameter import Parameter, parameters_of
from needleplan.models._simulate import simulate
from needleplan.models.effects._base import SIZE, Effect, Enters, Family, Reach, Term, WithTerm
from needleplan.models.effects._drive import WithDrive
from needleplan.models.effects._sensor import Lagging
from needleplan.models.effects._shaft import Puncture
from needleplan.models.effects._tissue import BreathingTissue, breathing_forces
from needleplan.models.friction import ShaftAndTip
from needleplan.signals import Array, Motion

__all__ = ["TermEffect", "WrapEffect", "presliding_of"]

Grid = Callable[[Reach], Mapping[str, Sequence[float] | Array] | Sequence[Mapping[str, float]]]
"""Function that takes the available ranges and returns the axes of a search grid, or a list of all grid points."""

Nearby = Callable[[Mapping[str, float], Reach, float], list[dict[str, float]]]
"""Function that takes values, available ranges and scale, and returns the start values of `Effect.nearby`."""


@dataclass(frozen=True)
class _Described(CallRepr, Effect):
    """An effect whose texts and search functions are fields."""

    name: str
    title: str
    family: Family
    enters: Enters
    equation: str
    meaning: str
    source: str
    looked_for: Grid = lambda reach: {}  # noqa: ARG005
    """Implementation of `grid`."""

    tried: Nearby = lambda values, reach, scale: []  # noqa: ARG005
    """Implementation of `nearby`."""

    channel: Channel = Channel.FORCE
    repeats: bool = False
    is_lag: bool = False
    imitated: str = ""
    further: bool = False
    by_trial: tuple[str, ...] = ()
    beside: tuple[type[Model], ...] = ()
    """Classes of models that the effect can be added to; if empty, any model."""

    def suits(self, model: Model) -> bool:
        """Return whether the effect can be added to `model` or to a model that `model` wraps."""
        inner = model
        while not isinstance(inner, self.beside) and hasattr(inner, "base"):
            inner = inner.base
        return not self.beside or isinstance(inner, self.beside)

    def grid(self, reach: Reach) -> list[dict[str, float]]:
        """Return all points of the search grid."""
        axes = self.looked_for(reach)
        if not isinstance(axes, Mapping):
            return [dict(axis) for axis in axes]
        return [dict(zip(axes, map(float, point), strict=True)) for point in product(*axes.values())]

    def nearby(self, values: Mapping[str, float], reach: Reach, scale: float) -> list[dict[str, float]]:
        """Return further start values of a fit, clipped to the ranges of the parameters."""
        bounds = self.parameters
        return [
            {name: min(max(value, bounds[name].lower), bounds[name].upper) for name, value in each.items()}
            for each in self.tried(values, reach, scale)
        ]


@dataclass(frozen=True)
class TermEffect(_Described):
    """An effect that is implemented by a term."""

    term: type[Term] = Puncture

    @property
    def parameters(self) -> Mapping[str, Parameter]:  # type: ignore[override]
        """Amplitude, and parameters for place, time or rate."""
        return {name: parameter for name, parameter in self.term.parameters().items() if parameter.free}

    def apply(self, model: Model, values: Mapping[str, float]) -> Model:
        """Return the model with the term; the model itself if the amplitude is 0."""
        return WithTerm(model, self._term(model, values)) if values.get(SIZE, 0.0) else model

    def columns(self, model: Model, motion: Motion, grid: Sequence[Mapping[str, float]]) -> Array:
        """Return the derivative of the output with respect to the amplitude, shape (samples, len(grid)).

        Grid points that agree in the parameters of the internal state share one integration of this state.
        """
        plain = simulate(model, motion).output
        states: dict[tuple[float, ...], Array] = {}
        columns = np.empty((len(motion), len(grid)))
        for index, values in enumerate(grid):
            term = self._term(model, {**values, SIZE: 1.0})
            key = tuple(values[name] for name in _STATE_PARAMETERS.get(self.name, ()))
            if key not in states:
                states[key] = term.states(motion, term.initial(motion))
            columns[:, index] = term.shape(states[key], motion, plain)
        return columns

    def _term(self, model: Model, values: Mapping[str, float]) -> Term:
        constants = (name for name, parameter in self.term.parameters().items() if not parameter.free)
        known = {name: _of_base(model, name) for name in constants}
        return self.term(**{name: value for name, value in known.items() if value is not None}, **values)


_STATE_PARAMETERS = {
    "relaxation": ("time_s", "recovery_mm"),
}
"""Parameters on which the internal state of a term depends, by the name of the effect."""


@dataclass(frozen=True)
class WrapEffect(_Described):
    """An effect that is implemented by a model that wraps another one: `wrapper(base=model, size=..., ...)`."""

    wrapper: type[Model] = Lagging

    @property
    def parameters(self) -> Mapping[str, Parameter]:  # type: ignore[override]
        """Amplitude, and parameters for place, time or rate."""
        return parameters_of(self.wrapper)

    def apply(self, model: Model, values: Mapping[str, float]) -> Model:
        """Return `model` with the wrapper around it or, if it does not suit, around a model inside of it.

        Returns `model` itself if the amplitude is 0.
        """
        if not values.get(SIZE, 0.0):
            return model
        if (self.beside and not isinstance(model, self.beside)) or self._is_behind(model):
            return self._inside(model, values)
        made: Model = self.wrapper(base=model, **values)  # type: ignore[call-arg]
        return made

    def columns(self, model: Model, motion: Motion, grid: Sequence[Mapping[str, float]]) -> Array:
        """Return the sensitivity to the amplitude, of the shape of `Effect.columns`.

        Breathing motions around a `ShaftAndTip` are computed together, which is faster.
        """
        names = set(self.parameters)
        if not (
            self.wrapper is BreathingTissue
            and isinstance(model, ShaftAndTip)
            and all(point.keys() == names and point[SIZE] for point in grid)
        ):
            return super().columns(model, motion, grid)
        gained = breathing_forces(model, motion, grid) - simulate(model, motion).output
        return np.asarray((gained / np.array([[point[SIZE]] for point in grid])).T)

    def _is_behind(self, model: Model) -> bool:
        """Return whether `model` is a drive in whose motion of the needle this effect acts."""
        return isinstance(model, WithDrive) and self.enters is Enters.TISSUE

    def _inside(self, model: Model, values: Mapping[str, float]) -> Model:
        """Return a copy of `model` in which this effect is wrapped around the outermost suitable model inside `model`.

        Raises ModelError if there is no suitable model inside.
        """
        if not self.suits(model):
            wanted = " or ".join(kind.name for kind in self.beside)
            raise ModelError(Mistake("effect", self.name, f"can be added to {wanted} only"), type(model).__name__)
        inner: Any = model
        whole: Model = dataclasses.replace(inner, base=self.apply(inner.base, values))
        return whole


def presliding_of(model: Model) -> float:
    """Return the travel (mm) over which friction reverses in a model; 0.05 if the model does not define this travel."""
    return _of_base(model, "presliding_mm") or 0.05


def _of_base(model: Model, name: str) -> float | None:
    """Return a parameter of a model or, if the model lacks it, of the models inside; None if all of them lack it."""
    while not hasattr(model, name) and hasattr(model, "base"):
        model = model.base
    value = getattr(model, name, None)
    return None if value is None else float(value)
