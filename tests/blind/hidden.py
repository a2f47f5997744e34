"""What hidden effects of both channels have in common: a name, a size, parameters; axes of those without a name."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
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
    LINEAR: ClassVar[bool] = True
    SIGNED: ClassVar[bool] = False

    size: float

    @classmethod
    @abstractmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        """The effect with size 0 and its other parameters at random, placed within what the training motions reach."""

    def with_size(self, size: float) -> Self:
        return replace(self, size=size)

    def parameters(self) -> dict[str, Any]:
        """The truth as plain values; units stand in the names, that of size in UNIT."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        return {"size_unit": self.UNIT, **{k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}}
