"""Declaration of model parameters: dataclass fields with unit, range, scale and meaning."""

from __future__ import annotations

import dataclasses
import inspect
import math
from dataclasses import MISSING, dataclass
from enum import StrEnum
from functools import cache
from typing import Any

from needleplan.artifacts import CallRepr

__all__ = ["Parameter", "Scale", "constant", "parameter", "parameter_section", "parameters_of"]


# Relative distance from a bound below which a value lies beyond it by rounding errors only.
_ROUNDING = 1e-12


class Scale(StrEnum):
    """The coordinate in which a parameter is estimated.

    Examples
    --------
    >>> import needleplan as npl
    >>> npl.models.Bicycle.parameters()["curvature_per_mm"].scale is npl.models.Scale.LINEAR
    True
    """

    LOG = "log"
    """u = ln(p), for positive parameters."""

    LINEAR = "linear"
    """u = p / typical, for parameters that may be zero or negative."""


@dataclass(frozen=True)
class Parameter(CallRepr):
    """Declaration of a model parameter: unit, range, scale and meaning.

    Parameters
    ----------
    unit : str
        Unit, empty for dimensionless parameters.
    lower, upper : float
        Closed range of the physically sensible values.
    about : str
        Meaning, in a few words.
    scale : Scale
        Coordinate in which the parameter is estimated.
    typical : float
        Typical magnitude of a parameter with the scale LINEAR; 1 for LOG.
    free : bool
        Whether `fit` estimates the parameter by default. Constants of the experiment are not free.

    Examples
    --------
    >>> import needleplan as npl
    >>> stiffness = npl.models.LumpedLuGre.parameters()["sigma0"]
    >>> stiffness.unit, stiffness.lower, stiffness.upper, stiffness.free
    ('1/mm', 0.0001, 10000.0, True)
    """

    unit: str
    lower: float
    upper: float
    about: str
    scale: Scale
    typical: float
    free: bool

    def in_range(self, value: float) -> float | None:
        """Return a value within the range, the bound for a value beyond it by rounding errors, or None.

        A fit ends at the coordinate of a bound, whose value may lie beyond the bound in the last digits.
        """
        nearest = min(max(value, self.lower), self.upper)
        return nearest if math.isclose(value, nearest, rel_tol=_ROUNDING) else None

    def coordinate(self, value: float) -> float:
        """Return the coordinate u of a value. With the scale LOG the value must be positive."""
        return math.log(value) if self.scale is Scale.LOG else value / self.typical

    def value(self, coordinate: float) -> float:
        """Return the value of a parameter, in its unit, at the fit coordinate u; the inverse of `coordinate`.

        A value that equals a bound up to rounding is returned as this bound.
        """
        value = math.exp(coordinate) if self.scale is Scale.LOG else coordinate * self.typical
        near_bounds = (bound for bound in (self.lower, self.upper) if math.isclose(value, bound, rel_tol=_ROUNDING))
        return next(near_bounds, value)

    def range_rule(self) -> str:
        """Return the rule for values of the parameter, such as `must be from 0 to 1 N`."""
        return f"must be from {self.lower:g} to {self.upper:g} {self.unit}".rstrip()

    def slope(self, value: float) -> float:
        """Return the derivative d(value)/du at a value."""
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
    """Declare a dataclass field of a model as a parameter that can be identified.

    Parameters
    ----------
    unit : str
        Unit, empty for dimensionless parameters.
    lower, upper : float
        Closed range of the physically sensible values.
    about : str
        Meaning, in a few words.
    default : Any
        Default value; without one, the caller must give the value.
    typical : float, optional
        Typical magnitude. With it, the scale is LINEAR; without it, LOG.
    free : bool
        Whether `fit` estimates the parameter by default.

    Returns
    -------
    Any
        A dataclass field that carries the `Parameter`.

    Examples
    --------
    >>> from needleplan.models import parameter
    >>> declared = parameter("N/mm", 1e-3, 1e3, "stiffness of a spring")
    >>> str(declared.metadata["parameter"].scale)
    'log'
    """
    scale = Scale.LOG if typical is None else Scale.LINEAR
    declared = Parameter(unit, lower, upper, about, scale, 1.0 if typical is None else typical, free)
    return dataclasses.field(default=default, metadata={"parameter": declared})


def constant(
    unit: str, lower: float, upper: float, about: str, *, default: Any = MISSING, typical: float | None = None
) -> Any:
    """Declare a dataclass field of a model as a known constant of the experiment, such as a length.

    Parameters
    ----------
    unit : str
        Unit, empty for dimensionless constants.
    lower, upper : float
        Closed range of the physically sensible values.
    about : str
        Meaning, in a few words.
    default : Any
        Default value; without one, the caller must give the value.
    typical : float, optional
        Typical magnitude, which scales the constant if a fit estimates it after all. Default: the magnitude of the
        default value, or 1 in its unit.

    Returns
    -------
    Any
        A dataclass field that carries a `Parameter` with `free` False.

    Examples
    --------
    >>> from needleplan.models import constant
    >>> constant("mm", 0, 1e3, "length of the needle").metadata["parameter"].free
    False
    """
    if typical is None:
        typical = abs(float(default)) if default is not MISSING and default else 1.0
    return parameter(unit, lower, upper, about, default=default, typical=typical, free=False)


def parameters_of(model: object) -> dict[str, Parameter]:
    """Return the parameters of a model, or of a model class, by name in the order of its fields."""
    return dict(_parameters_of(model if isinstance(model, type) else type(model)))


@cache
def _parameters_of(kind: type) -> dict[str, Parameter]:
    fields = dataclasses.fields(kind)
    return {field.name: field.metadata["parameter"] for field in fields if "parameter" in field.metadata}


def parameter_section(kind: type) -> str:
    """Return the numpydoc section `Parameters` of a class to which `dataclass` has not been applied yet.

    The section is empty if the class has no fields to list.
    """
    declared: dict[str, Any] = {}
    for base in reversed(kind.__mro__[1:]):
        if dataclasses.is_dataclass(base):
            declared |= {inherited.name: inherited for inherited in dataclasses.fields(base)}
    annotations = inspect.get_annotations(kind)
    declared |= {
        name: kind.__dict__.get(name) for name, text in annotations.items() if not str(text).startswith("ClassVar")
    }
    rows = []
    for name, field in declared.items():
        default = getattr(field, "default", field)
        given = "" if default is MISSING else f", default {default}"
        if isinstance(field, dataclasses.Field) and "parameter" in field.metadata:
            declared_parameter: Parameter = field.metadata["parameter"]
            unit = f", {declared_parameter.unit}" if declared_parameter.unit else ""
            rows.append(f"{name} : float{given}\n    {declared_parameter.about}{unit}")
        elif isinstance(field, dataclasses.Field) and "about" in field.metadata:
            kind_of = str(annotations.get(name, field.type)).removesuffix(" | None")
            rows.append(f"{name} : {kind_of}{given}\n    {field.metadata['about']}")
        elif isinstance(default, StrEnum):
            summary = (type(default).__doc__ or "").splitlines()[0]
            rows.append(f"{name} : {type(default).__name__}{given}\n    {summary}")
    return "\n".join(["Parameters", "----------", *rows]) if rows else ""
