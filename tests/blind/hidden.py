"""What hidden effects of both channels have in common: a name, a size, parameters; axes of those without a name."""

from abc import ABC
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from typing import Any, ClassVar, Self

import numpy as np


class Axis(StrEnum):
    """Along which a gap outside of the library lies: what an honest UNKNOWN can still say."""

    TIME = "time"
    DEPTH = "depth"
    SPEED = "speed"
    HOLD = "hold"
    FORCE = "force"
    PERIODIC = "position_periodic"
    ROTATION = "rotation"


# The scale of a parameter that is a share of what the training motions reach.
REACH = 0.0


def within(low: float, high: float, of: float = 1.0) -> Any:
    """A parameter that is drawn between two shares of a scale."""
    return field(metadata={"within": (low, high, of)})


@dataclass(frozen=True)
class Hidden(ABC):
    """One hidden effect. size carries its strength, in UNIT; 0 is the base to the last bit.

    LARGEST bounds the size to what a person would still believe; LINEAR says that the data are linear in the size.
    SIGNED effects may be negative.
    """

    NAME: ClassVar[StrEnum]
    UNIT: ClassVar[str]
    LARGEST: ClassVar[float]
    FIRST: ClassVar[float]  # a size to begin the search with
    LINEAR: ClassVar[bool]
    SIGNED: ClassVar[bool]
    AXIS: ClassVar[Axis | None]

    size: float

    def __init_subclass__(
        cls, name: StrEnum | None = None, unit: str = "", largest: float = 0.0, first: float = 0.0,
        linear: bool = True, signed: bool = False, axis: Axis | None = None,
    ) -> None:  # fmt: skip
        if name is not None:
            cls.NAME, cls.UNIT, cls.LARGEST, cls.FIRST = name, unit, largest, first
            cls.LINEAR, cls.SIGNED, cls.AXIS = linear, signed, axis

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        """The effect with size 0 and its other parameters at random, placed within what the training motions reach."""
        ranges = [each.metadata["within"] for each in fields(cls) if each.metadata]
        return cls(0.0, *((of or reach_mm) * rng.uniform(low, high) for low, high, of in ranges))

    def with_size(self, size: float) -> Self:
        return replace(self, size=size)

    def parameters(self) -> dict[str, Any]:
        """The truth as plain values; units stand in the names, that of size in UNIT."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return {"size_unit": self.UNIT, **{k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}}
