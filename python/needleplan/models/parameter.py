"""Parameters of models: fields of a frozen dataclass with unit, range, scale and meaning."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import MISSING, dataclass
from enum import StrEnum
from functools import cache
from typing import Any

__all__ = ["Parameter", "Scale", "constant", "parameter", "parameters_of"]


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
