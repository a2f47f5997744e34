"""Base classes of all mechanical models.

A model is a frozen dataclass whose fields are its parameters. A motion u(t) drives the model, which has a state x and
an output y::

    x' = derivative(x, u)          y = output(x, u)

A static model has an empty state. A model class defines these two functions and the initial state. Simulation, fitting,
filtering and residual tests are written once for all models.

| base class | use it for | integration |
|---|---|---|
| `Model` | any model | Kutta's third-order method |
| `LinearStateModel` | one state with z' = forcing(u) - rate(u) z | exact for constant coefficients |
| `SelfIntegratingModel` | stiff models, or models with a closed-form solution | the model's own method |

`parameter` and `constant` declare a field together with its unit, range, scale and meaning. A list of parameters is
generated from these declarations and inserted into the docstring of every model class.
"""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, ClassVar, Self

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.errors import Mistake, ModelError
from needleplan.models._parameter import Parameter, parameter_section, parameters_of
from needleplan.signals import Array, Motion

__all__ = ["Channel", "LinearStateModel", "Model", "SelfIntegratingModel", "WrappingModel"]


class Channel(StrEnum):
    """The measured quantity that a model predicts. The value is the name of a record's column, except for TIP.

    Examples
    --------
    >>> import needleplan as npl
    >>> str(npl.models.LumpedLuGre.channel), npl.models.SpatialBicycle.channel.columns
    ('force_n', ('x_mm', 'y_mm', 'z_mm'))
    """

    FORCE = "force_n"
    """Axial force on the base of the needle, N; positive if it resists insertion."""

    LATERAL = "y_mm"
    """Lateral position of the tip, or of the tracked point, in the plane of bending, mm."""

    VELOCITY = "velocity_mm_s"
    """Velocity, mm/s."""

    TIP = "tip_mm"
    """Position of the tip in 3D, mm: the columns x_mm, y_mm and z_mm. The output has the shape (3, ...)."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of a record that hold the channel."""
        return ("x_mm", "y_mm", "z_mm") if self is Channel.TIP else (str(self),)


@dataclass(frozen=True)
class Model(CallRepr, ABC):
    """Abstract base class of all mechanical models.

    A state has the shape (n, ...), and every field of a motion has the shape (...). One call therefore serves a single
    instant or all samples at once. Units are mm, N, s and rad. The constructor raises ModelError, with all mistakes, if
    a parameter is not a number or is outside of its range.

    Examples
    --------
    >>> import needleplan as npl
    >>> npl.models.Bicycle(curvature_per_mm=0.01).values()
    {'curvature_per_mm': 0.01, 'heading_rad': 0.0, 'offset_mm': 0.0}
    """

    name: ClassVar[str]
    """Name of the model in model files and on the command line."""

    channel: ClassVar[Channel]
    """Quantity that the model predicts."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Insert the list of parameters into the docstring of a subclass, unless the docstring already has one."""
        super().__init_subclass__(**options)
        section = parameter_section(cls)
        if cls.__doc__ and section and "Parameters\n" not in cls.__doc__:
            words, examples, code = inspect.cleandoc(cls.__doc__).partition("\nExamples\n")
            cls.__doc__ = f"{words.rstrip()}\n\n{section}\n{examples}{code}"

    def __post_init__(self) -> None:
        mistakes = []
        for name, parameter in parameters_of(self).items():
            value = getattr(self, name)
            if not isinstance(value, (int, float, np.number)) or isinstance(value, bool):
                mistakes.append(Mistake(name, repr(value), f"must be a number in {parameter.unit or '1'}"))
            elif (near := parameter.in_range(float(value))) is None:  # also for NaN
                mistakes.append(Mistake(name, f"{value:.10g}", parameter.range_rule()))
            else:
                object.__setattr__(self, name, near)
        if mistakes:
            raise ModelError(mistakes, type(self).__name__)

    @abstractmethod
    def initial_state(self, motion: Motion) -> Array:
        """Return the state at the first sample of `motion`, shape (n,), for a start from rest."""

    @abstractmethod
    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rate of change of the state.

        Parameters
        ----------
        state : numpy.ndarray
            State, shape (n, ...).
        motion : Motion
            Motion or instant; its arrays have the trailing shape (...) of the state.

        Returns
        -------
        numpy.ndarray
            Rate of change per second, shape (n, ...).
        """

    @abstractmethod
    def output(self, state: Array, motion: Motion) -> Array:
        """Return the predicted measurement.

        Parameters
        ----------
        state : numpy.ndarray
            State, shape (n, ...).
        motion : Motion
            Motion or instant; its arrays have the trailing shape (...) of the state.

        Returns
        -------
        numpy.ndarray
            Measurement in the unit of the channel, shape (...), or (3, ...) for the channel TIP.
        """

    @classmethod
    def parameters(cls) -> dict[str, Parameter]:
        """Return the declaration of every parameter, by name."""
        return parameters_of(cls)

    def values(self) -> dict[str, float]:
        """Return the value of every parameter, by name."""
        return {name: getattr(self, name) for name in parameters_of(self)}

    def with_values(self, **values: float) -> Self:
        """Return a copy of the model with some fields changed.

        Parameters
        ----------
        **values : float
            New values by field name, in the units of the parameters.

        Returns
        -------
        Self
            The changed copy.

        Raises
        ------
        ModelError
            If the model has no field of that name, or a value is outside of its range.
        """
        known = {field.name for field in fields(self)}
        unknown = [Mistake(name, "", f"is not a parameter of {self.name}") for name in values if name not in known]
        if unknown:
            raise ModelError(unknown, type(self).__name__)
        changed: Any = values
        return replace(self, **changed)


@dataclass(frozen=True)
class LinearStateModel(Model):
    """Abstract base class of models with one state z that obeys z' = forcing - rate z.

    `simulate` integrates these models exactly if forcing and rate are constant during each step.

    Examples
    --------
    >>> import needleplan as npl
    >>> issubclass(npl.models.LumpedLuGre, npl.models.LinearStateModel)
    True
    """

    @abstractmethod
    def coefficients(self, motion: Motion) -> tuple[Array, Array]:
        """Return the forcing (unit of z per second) and the rate (1/s), each of the shape of the motion's fields."""

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return z = 0, shape (1,)."""
        return np.zeros(1)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return z', shape (1, ...)."""
        forcing, rate = self.coefficients(motion)
        return np.asarray(forcing - rate * state)


@dataclass(frozen=True)
class SelfIntegratingModel(Model):
    """Abstract base class of models that integrate their own equations.

    `derivative` still defines the equations, for filters and for tests of `integrate`.

    Examples
    --------
    >>> import needleplan as npl
    >>> issubclass(npl.models.Bicycle, npl.models.SelfIntegratingModel)
    True
    """

    @abstractmethod
    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states at all samples of a motion.

        Parameters
        ----------
        motion : Motion
            Sampled motion of the needle.
        start : numpy.ndarray
            State at the first sample, shape (n,).

        Returns
        -------
        numpy.ndarray
            States, shape (n, samples).
        """

    def step(self, state: Array, before: Motion, after: Motion) -> Array:
        """Return the states after one step, for several states and parameters at once.

        A model may implement this method to make filters faster; the result must be that of `integrate`.

        Parameters
        ----------
        state : numpy.ndarray
            States, shape (n, m). Parameters of the model may be arrays of shape (m,).
        before : Motion
            Instant at which the step begins.
        after : Motion
            Instant at which the step ends.

        Returns
        -------
        numpy.ndarray
            States, shape (n, m).

        Raises
        ------
        NotImplementedError
            The step has to be integrated for each state alone.
        """
        raise NotImplementedError


class WrappingModel(SelfIntegratingModel):
    """Abstract base class of models around another model, `base`, with the channel of that model."""

    base: Model

    @property
    def channel(self) -> Channel:  # type: ignore[override]
        """The channel of the base model."""
        return self.base.channel
