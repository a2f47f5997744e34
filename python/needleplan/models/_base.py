"""Parameters of models: fields of a frozen dataclass with unit, range, scale and meaning.

----

What every model of the mechanics is.

A model is a frozen dataclass whose fields are its parameters. Driven by a motion u(t) it has a state x and output y::

    x' = derivative(x, u)          y = output(x, u)

A static model has an empty state. Nothing else is asked of a member: simulation, fitting, filtering and residuals are
written once for all of them. A member whose state is a single number that enters its equation linearly::

    z' = forcing(u) - rate(u) z

says so (`LinearStateModel`), and is then integrated exactly for frozen coefficients, fast and for any step. A member
that no general method integrates well, such as a stiff one, or one that is solved in closed form, brings its own
(`SelfIntegratingModel`).
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from dataclasses import MISSING, dataclass, fields, replace
from enum import StrEnum
from functools import cache
from typing import Any, ClassVar, Self

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.signals import Array, Motion

__all__ = [
    "Channel",
    "LinearStateModel",
    "Model",
    "Parameter",
    "Scale",
    "SelfIntegratingModel",
    "constant",
    "parameter",
    "parameters_of",
]


class Scale(StrEnum):
    """In which coordinate a parameter is well scaled."""

    LOG = "log"
    """u = ln(p): positive, known to within a factor."""

    LINEAR = "linear"
    """u = p / typical: may be zero or change its sign."""


@dataclass(frozen=True)
class Parameter:
    """What is known of a parameter before it is identified.

    The closed range [lower, upper] is where it makes physical sense; `typical` is the size of a LINEAR one. A parameter
    that is not `free` is a constant of the experiment, or fixes a symmetry; `fit` leaves it alone unless told.
    """

    unit: str
    lower: float
    upper: float
    about: str
    scale: Scale
    typical: float
    free: bool

    def coordinate(self, value: float) -> float:
        """Return the well-scaled coordinate of a value; a positive lower bound is needed for LOG."""
        return math.log(value) if self.scale is Scale.LOG else value / self.typical

    def value(self, coordinate: float) -> float:
        """Return the value of a coordinate."""
        return math.exp(coordinate) if self.scale is Scale.LOG else coordinate * self.typical

    def slope(self, value: float) -> float:
        """Return d(value)/d(coordinate) at a value."""
        return value if self.scale is Scale.LOG else self.typical


def parameter(
    unit: str,
    lower: float,
    upper: float,
    about: str,
    *,
    default: Any = MISSING,
    typical: float | None = None,
    free: bool = True,
) -> Any:
    """Declare a parameter that can be identified. Its scale is LOG unless `typical` gives a size for LINEAR."""
    scale = Scale.LOG if typical is None else Scale.LINEAR
    what = Parameter(unit, lower, upper, about, scale, 1.0 if typical is None else typical, free)
    return dataclasses.field(default=default, metadata={"parameter": what})


def constant(unit: str, lower: float, upper: float, about: str, *, default: Any = MISSING) -> Any:
    """Declare a number of the experiment that is known beforehand, such as a length."""
    return parameter(unit, lower, upper, about, default=default, typical=max(abs(lower), abs(upper)), free=False)


def parameters_of(model: object) -> dict[str, Parameter]:
    """Return the parameters of a model or its class by name, in the order of its fields."""
    return dict(_parameters_of(model if isinstance(model, type) else type(model)))


@cache
def _parameters_of(kind: type) -> dict[str, Parameter]:
    fields = dataclasses.fields(kind)
    return {each.name: each.metadata["parameter"] for each in fields if "parameter" in each.metadata}


class Channel(StrEnum):
    """What a model predicts: the column of a record that it is compared with."""

    FORCE = "force_n"
    """Axial force on the needle at its base, positive where it resists insertion (N)."""

    LATERAL = "y_mm"
    """Lateral position of the tip, or of the tracked point, in the plane of bending (mm)."""

    VELOCITY = "velocity_mm_s"
    """A velocity (mm/s)."""

    TIP = "tip_mm"
    """Position of the tip in space: the columns x_mm, y_mm and z_mm; outputs have the shape (3, ...)."""

    @property
    def columns(self) -> tuple[str, ...]:
        """The columns of a record."""
        return ("x_mm", "y_mm", "z_mm") if self is Channel.TIP else (str(self),)


@dataclass(frozen=True)
class Model(ABC):
    """A member of the family; abstract.

    Shapes: a state is (n, ...) and the fields of a motion are (...), so that one call serves one instant or all
    samples. Units: mm, N, s, rad.
    """

    name: ClassVar[str]
    """Name in model files and on the command line."""

    channel: ClassVar[Channel]

    def __post_init__(self) -> None:
        mistakes = []
        for name, what in parameters_of(self).items():
            value = getattr(self, name)
            if not isinstance(value, (int, float, np.number)) or isinstance(value, bool):
                mistakes.append(Mistake(name, str(value), f"must be a number in {what.unit or '1'}"))
            elif not what.lower <= value <= what.upper:  # also where it is NaN
                rule = f"must be from {what.lower:g} to {what.upper:g} {what.unit}".rstrip()
                mistakes.append(Mistake(name, f"{value:g}", rule))
            else:
                object.__setattr__(self, name, float(value))
        if mistakes:
            raise ModelError(mistakes, type(self).__name__)

    @abstractmethod
    def initial_state(self, motion: Motion) -> Array:
        """Return the state at rest, shape (n,), before the first sample of `motion`."""

    @abstractmethod
    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rate of change of the state per second, shape (n, ...)."""

    @abstractmethod
    def output(self, state: Array, motion: Motion) -> Array:
        """Return what is measured, in the unit of the channel, shape (...)."""

    @classmethod
    def parameters(cls) -> dict[str, Parameter]:
        """Return unit, range, scale and meaning of every parameter, by name."""
        return parameters_of(cls)

    def values(self) -> dict[str, float]:
        """Return the value of every parameter, by name."""
        return {name: getattr(self, name) for name in parameters_of(self)}

    def with_values(self, **values: float) -> Self:
        """Return the model with some parameters changed. Raises ModelError for a name that it does not have."""
        known = {each.name for each in fields(self)}
        unknown = [Mistake(name, "", f"is not a parameter of {self.name}") for name in values if name not in known]
        if unknown:
            raise ModelError(unknown, type(self).__name__)
        changed: Any = values
        return replace(self, **changed)


@dataclass(frozen=True)
class LinearStateModel(Model):
    """A model with one state z that obeys z' = forcing - rate z; abstract."""

    @abstractmethod
    def coefficients(self, motion: Motion) -> tuple[Array, Array]:
        """Return forcing (state per second) and rate (1/s), each of the shape of the motion's fields."""

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return z = 0, shape (1,)."""
        return np.zeros(1)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return z', shape (1, ...)."""
        forcing, rate = self.coefficients(motion)
        return np.asarray(forcing - rate * state)


@dataclass(frozen=True)
class SelfIntegratingModel(Model):
    """A model that integrates its own equations; abstract. `derivative` says what they are."""

    @abstractmethod
    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states at the samples of the motion, shape (n, samples), from `start`, shape (n,)."""
