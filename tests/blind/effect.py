"""What a hidden effect may do: move the tissue, change the contact, add friction or force, or spoil the sensor."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, ClassVar, Self

import numpy as np

from tests.blind.base import Scene
from tests.blind.contact import Compliance
from tests.blind.motions import Array


class ForceName(StrEnum):
    """Hidden effects of the axial force; those from SLIP_STEP on are outside of any library."""

    PUNCTURE = "puncture"
    FRICTION_LAYER = "friction_layer"
    CUTTING_LAYER = "cutting_layer"
    FRESH_CUTTING = "fresh_cutting"
    CUTTING_DEPTH = "cutting_depth"
    STRIBECK = "stribeck"
    BRISTLE = "bristle"
    TISSUE_MOTION = "tissue_motion"
    VISCOUS = "viscous"
    BIAS = "bias"
    DRIFT = "drift"
    THERMAL_DRIFT = "thermal_drift"
    GAIN = "gain"
    LATENCY = "latency"
    RELAXATION = "relaxation"
    INERTIA = "inertia"
    RESPIRATION = "respiration"
    PATH_DAMAGE = "path_damage"
    BUMPS = "bumps"
    SLIP_STEP = "slip_step"
    MOTOR_RIPPLE = "motor_ripple"
    BUCKLING = "buckling"
    GAIN_CURVE = "gain_curve"
    ENTRY_SPRING = "entry_spring"
    SPEED_CROSSTALK = "speed_crosstalk"
    AGEING = "ageing"
    VIBRATION = "vibration"


class Axis(StrEnum):
    """Along which a gap outside of the library lies: what an honest UNKNOWN can still say."""

    TIME = "time"
    DEPTH = "depth"
    SPEED = "speed"
    HOLD = "hold"
    FORCE = "force"
    PERIODIC = "position_periodic"


@dataclass(frozen=True)
class Effect(ABC):
    """One hidden effect. size carries its strength, in UNIT; 0 is the base to the last bit.

    LARGEST bounds the size to what a person would still believe; LINEAR says that the force is linear in the size.
    SIGNED effects may be negative.
    """

    NAME: ClassVar[ForceName]
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

    def tissue_mm(self, time_s: Array) -> Array | None:
        """Motion of the tissue along the path (T,), positive inwards."""
        del time_s
        return None

    def compliance(self, usual: Compliance) -> Compliance:
        return usual

    def load_n(self, scene: Scene, friction_n: Array, cutting_n: Array) -> Array | float:
        """Force on the needle beside the friction and the cutting of the base, (T, R)."""
        del scene, friction_n, cutting_n
        return 0.0

    def reading_n(self, scene: Scene, force_n: Array) -> Array | float:
        """What the sensor shows beside the force that acts on it (T, R), before its filter."""
        del scene, force_n
        return 0.0


@dataclass(frozen=True)
class PlainEffect(Effect, ABC):
    """An effect without other parameters than its size."""

    @classmethod
    def drawn(cls, rng: np.random.Generator, reach_mm: float) -> Self:
        del rng, reach_mm
        return cls(0.0)
