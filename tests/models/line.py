"""The smallest static member of the family: a force that grows with depth and speed."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models import Channel, Model, parameter
from needleplan.signals import Array, Motion, Record


@dataclass(frozen=True)
class Line(Model):
    name: ClassVar[str] = "line"
    channel: ClassVar[Channel] = Channel.FORCE
    slope: float = parameter("N/mm", 1e-4, 1e3, "per depth")
    offset: float = parameter("N", -10, 10, "at the surface", default=0.0, typical=0.1)

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        return np.zeros(0)

    def derivative(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        return np.zeros_like(state)

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        return np.asarray(self.slope * motion.depth_mm + self.offset)


def pushed(random: np.random.Generator, noise: Array | None = None, samples: int = 200) -> Record:
    """A record of Line(0.02, 0.1) along a sine, with noise of 0.05 N where none is given."""
    time = np.arange(samples) / 50
    depth, velocity = 20 - 20 * np.cos(1.7 * time), 34 * np.sin(1.7 * time)
    disturbance = 0.05 * random.standard_normal(samples) if noise is None else noise
    columns = {"time_s": time, "depth_mm": depth, "velocity_mm_s": velocity}
    return Record({**columns, "force_n": 0.02 * depth + 0.1 + disturbance})


def filtered(random: np.random.Generator, samples: int = 200, decay: float = 0.7) -> Array:
    """Noise of 0.05 N of which every sample keeps a share of the last."""
    noise = 0.05 * random.standard_normal(samples)
    for i in range(1, samples):
        noise[i] = decay * noise[i - 1] + np.sqrt(1 - decay**2) * noise[i]
    return noise
