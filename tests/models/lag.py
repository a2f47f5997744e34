"""The smallest member of the family: a first-order lag with an offset."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models import Channel, LinearStateModel, Model, constant, parameter
from needleplan.signals import Array, Motion


@dataclass(frozen=True)
class Lag(LinearStateModel):
    name: ClassVar[str] = "lag"
    channel: ClassVar[Channel] = Channel.FORCE
    gain: float = parameter("N s/mm", 1e-3, 1e3, "force at a steady velocity of 1 mm/s")
    time_constant: float = parameter("s", 1e-3, 1e3, "of the lag")
    offset: float = parameter("N", -10, 10, "force at rest", default=0.0, typical=0.1)
    known: float = constant("mm", 0, 100, "not used", default=1.0)

    def coefficients(self, motion: Motion) -> tuple[Array, Array]:
        rate = np.full_like(np.asarray(motion.velocity_mm_s, float), 1 / self.time_constant)
        return self.gain * motion.velocity_mm_s * rate, rate

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        return state[0] + self.offset


@dataclass(frozen=True)
class SteppedLag(Model):
    """The same equation for the general integrator."""

    name: ClassVar[str] = "stepped_lag"
    channel: ClassVar[Channel] = Channel.FORCE
    gain: float = parameter("N s/mm", 1e-3, 1e3, "force at a steady velocity of 1 mm/s")
    time_constant: float = parameter("s", 1e-3, 1e3, "of the lag")

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        return np.zeros(1)

    def derivative(self, state: Array, motion: Motion) -> Array:
        return (self.gain * motion.velocity_mm_s - state) / self.time_constant

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        return state[0]
