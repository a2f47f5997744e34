"""The bicycle model: a bevel tip follows an arc.

With l the length of the path, heading theta from the x axis (counter-clockwise positive) and curvature k::

    dx/dl = cos theta,    dy/dl = sin theta,    dtheta/dl = k cos phi

phi is the rotation of the needle: 0 bends to the left (bevel +1), pi to the right (bevel -1); in between, only the part
in the plane counts. While phi stands still the path is an arc of a circle, which `arc_step` takes in one exact step
(Webster et al., Int. J. Robotics Research 25 (2006) 509, the unicycle limit; deflection without slip).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from needleplan.models._base import Channel, SelfIntegratingModel, parameter
from needleplan.signals import Array, Motion

__all__ = ["Bicycle", "arc_step"]


def arc_step(x_mm: Any, y_mm: Any, heading_rad: Any, curvature_per_mm: Any, length_mm: Any) -> tuple[Any, Any, Any]:
    """Return x, y and heading after an arc; exact for every curvature, also zero. Numbers, or arrays of one shape."""
    half = np.asarray(curvature_per_mm) * length_mm / 2
    chord = length_mm * np.sinc(half / np.pi)
    return x_mm + chord * np.cos(heading_rad + half), y_mm + chord * np.sin(heading_rad + half), heading_rad + 2 * half


@dataclass(frozen=True)
class Bicycle(SelfIntegratingModel):
    """Lateral position y (mm) of a tip that enters at depth zero and follows arcs; state (y, heading).

    The depth is the length of the path in the tissue; above depth zero nothing bends or drifts. Where the needle is
    drawn back without rotation, it returns along its path.
    """

    name: ClassVar[str] = "bicycle"
    channel: ClassVar[Channel] = Channel.LATERAL

    curvature_per_mm: float = parameter("1/mm", -1.0, 1.0, "curvature of the path, to the left", typical=1e-3)
    heading_rad: float = parameter("rad", -1.6, 1.6, "heading at entry", default=0.0, typical=0.01)
    offset_mm: float = parameter("mm", -1e4, 1e4, "lateral position at entry", default=0.0, typical=1.0)

    def initial_state(self, motion: Motion) -> Array:
        """Return lateral position and heading at the first sample, as if it were reached without rotation."""
        depth, angle = (float(np.ravel(each)[0]) for each in (motion.depth_mm, motion.angle_rad))
        bend = self.curvature_per_mm * np.cos(angle)
        _, y, heading = arc_step(0.0, self.offset_mm, self.heading_rad, bend, max(depth, 0.0))
        return np.array([float(y), float(heading)])

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return (y', theta') per second, shape (2, ...)."""
        speed = np.where(motion.depth_mm > 0, motion.velocity_mm_s, 0.0)
        return np.array([speed * np.sin(state[1]), speed * self.curvature_per_mm * np.cos(motion.angle_rad)])

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return y and heading at every sample, shape (2, samples): an exact arc from each to the next."""
        steps = np.diff(np.maximum(motion.depth_mm, 0.0))
        bend = self.curvature_per_mm * np.cos((motion.angle_rad[1:] + motion.angle_rad[:-1]) / 2)
        heading = start[1] + np.concatenate([[0.0], np.cumsum(bend * steps)])
        half = bend * steps / 2
        sideways = steps * np.sinc(half / np.pi) * np.sin(heading[:-1] + half)
        return np.array([start[0] + np.concatenate([[0.0], np.cumsum(sideways)]), heading])

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the lateral position, mm."""
        return np.asarray(state[0])
