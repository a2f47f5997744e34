"""One identified combination of needle, tissue and speed, and the axial force that it predicts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from needleplan.artifacts import ShortRepr
from needleplan.config import (
    Choice,
    Commented,
    ConfigTable,
    Given,
    Keyed,
    Maybe,
    Number,
    Pair,
    Rule,
    Text,
    Texts,
    Violation,
    build,
    ruled,
)
from needleplan.errors import Mistake, ModelError
from needleplan.models import simulate
from needleplan.models.force import DepthForce, ForceModel1, ForceModel2
from needleplan.signals import Array, Motion

__all__ = ["Combination", "CombinationTable", "ForcePrediction"]

# Relative excess over the identified speed above which a prediction counts as outside of the identification.
_SPEED_TOLERANCE = 0.1

_MODELS: dict[str, type[DepthForce]] = {each.name: each for each in (ForceModel1, ForceModel2)}


@dataclass(frozen=True)
class ForcePrediction(ShortRepr):
    """The axial force along a motion, computed without a force sensor; arrays have the shape (samples,).

    `outside` marks samples deeper than the identification, or faster than its speed by more than 10 %.
    """

    motion: Motion
    force_n: Array
    outside: NDArray[np.bool_]


def _parameters_of(model: type[DepthForce]) -> Rule:
    known = model.parameters()
    rules = {
        name: Number(parameter.unit, at_least=parameter.lower, at_most=parameter.upper)
        for name, parameter in known.items()
    }
    return Keyed(rules, {name: parameter.about for name, parameter in known.items()})


def _bounded(model: type[DepthForce], parameters: dict[str, float]) -> Iterator[Mistake]:
    if not model(**parameters).proper:
        rule = "f1 and f1 + f2 must be positive, or the force grows without bound"
        yield Mistake("parameters.f1", f"{parameters['f1']:g}", rule)


def _around_values(
    model: type[DepthForce], parameters: dict[str, float], intervals: dict[str, tuple[float, float]]
) -> Iterator[Mistake]:
    for name, (low, high) in intervals.items():
        if name not in parameters:
            rule = f"is not a parameter of {model.name}; its parameters are {', '.join(parameters)}"
            yield Mistake(f"intervals.{name}", "", rule)
        elif not low <= parameters[name] <= high:
            rule = f"must be [low, high] around the value, {parameters[name]:g}"
            yield Mistake(f"intervals.{name}", f"[{low:g}, {high:g}]", rule)


@dataclass(frozen=True, kw_only=True)
class CombinationTable(ConfigTable, key="combination", error=ModelError, between=(_bounded, _around_values)):
    """One `[[combination]]` of a library file."""

    needle: str = ruled(Text(filled=True))
    tissue: str = ruled(Text(filled=True))
    velocity_mm_s: float = ruled(Number("mm/s", above=0))
    depth_mm: float = ruled(Number("mm", above=0))
    model: type[DepthForce] = ruled(Choice(_MODELS))
    mae_n: float | None = ruled(Maybe(Number("N", at_least=0)), None)
    source: str = ruled(Text(filled=True))
    digests: tuple[str, ...] = ruled(Texts("sha256:"), ())
    parameters: dict[str, float] = ruled(Given("model", _parameters_of))
    intervals: dict[str, tuple[float, float]] = ruled(Keyed({}, others=Pair(Number())), factory=dict)


@dataclass(frozen=True)
class Combination(ShortRepr):
    """A needle in a tissue at a speed, with the identified model of the axial force.

    - `velocity_mm_s`: speed of the identification; the model holds for this speed only.
    - `depth_mm`: largest depth of the identification.
    - `source`: text on the origin of the numbers.
    - `intervals`: 95 % intervals of parameters by name, as far as known.
    - `mae_n`: mean absolute error (N) of the simulated force on the data, or None if unknown.
    - `digests`: digests of the data files.

    Raises ModelError with all mistakes if a value violates a rule.
    """

    needle: str
    tissue: str
    velocity_mm_s: float
    depth_mm: float
    model: DepthForce
    source: str
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    mae_n: float | None = None
    digests: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        try:
            read = build(CombinationTable, self.raw())
        except Violation as broken:
            raise ModelError(broken.mistakes, self.title) from None
        for name in ("velocity_mm_s", "depth_mm", "mae_n", "intervals"):
            object.__setattr__(self, name, getattr(read, name))

    @classmethod
    def of(cls, read: CombinationTable) -> Self:
        """Return the combination that a table of a library file describes."""
        return cls(
            read.needle, read.tissue, read.velocity_mm_s, read.depth_mm, read.model(**read.parameters), read.source,
            read.intervals, read.mae_n, read.digests,
        )  # fmt: skip

    def raw(self, *, commented: bool = False) -> dict[str, Any]:
        """Return the contents of the table in a library file. Keys without a value are left out.

        If `commented`, each parameter has its unit as a comment.
        """
        known = self.model.parameters()
        values = self.model.values()
        raw = {
            "needle": self.needle,
            "tissue": self.tissue,
            "velocity_mm_s": self.velocity_mm_s,
            "depth_mm": self.depth_mm,
            "model": self.model.name,
            "mae_n": self.mae_n,
            "source": self.source,
            "digests": self.digests,
            "parameters": {
                name: Commented(value, known[name].unit) if commented else value for name, value in values.items()
            },
            "intervals": self.intervals,
        }
        return {key: value for key, value in raw.items() if value is not None and value not in ((), {})}

    @property
    def title(self) -> str:
        """Short name, such as `A in B at 10 mm/s`."""
        return f"{self.needle} in {self.tissue} at {self.velocity_mm_s:g} mm/s"

    def predict(self, motion: Motion) -> ForcePrediction:
        """Return the force along `motion`. The tissue is assumed to be undisturbed at the start of the motion."""
        fast = np.abs(motion.velocity_mm_s) > (1 + _SPEED_TOLERANCE) * self.velocity_mm_s
        deep = motion.depth_mm > self.depth_mm * (1 + 1e-9)
        return ForcePrediction(motion, simulate(self.model, motion).output, np.asarray(fast | deep))
