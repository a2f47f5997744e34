"""The bicycle model in the plane: the tip of a bevel needle follows arcs.

With the length l of the path, the heading theta from the x axis (counter-clockwise positive) and the curvature k::

    dx/dl = cos theta,    dy/dl = sin theta,    dtheta/dl = k cos phi

phi is the rotation of the needle. At phi = 0 (bevel +1) the path bends to the left, at phi = pi (bevel -1) to the
right. At other angles only the component in the plane counts. At constant phi the path is an arc of a circle, which
`arc_step` computes exactly (Webster et al., Int. J. Robotics Research 25 (2006) 509, the unicycle limit: no side slip).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from needleplan.models._base import Channel, SelfIntegratingModel
from needleplan.models._parameter import parameter
from needleplan.signals import Array, Motion

__all__ = ["Bicycle", "arc_step"]


def arc_step(x_mm: Any, y_mm: Any, heading_rad: Any, curvature_per_mm: Any, length_mm: Any) -> tuple[Any, Any, Any]:
    """Return the pose after an exact arc of any curvature, including zero.

    Parameters
    ----------
    x_mm, y_mm, heading_rad : float or Array
        Pose before the arc.
    curvature_per_mm : float or Array
        Curvature, positive to the left.
    length_mm : float or Array
        Length of the arc.

    Returns
    -------
    tuple
        x (mm), y (mm) and heading (rad) after the arc.

    Examples
    --------
    A quarter of a circle of 10 mm radius:

    >>> import math
    >>> from needleplan.models import arc_step
    >>> [round(float(value), 6) for value in arc_step(0.0, 0.0, 0.0, 0.1, 5 * math.pi)]
    [10.0, 10.0, 1.570796]
    """
    half = np.asarray(curvature_per_mm) * length_mm / 2
    chord = length_mm * np.sinc(half / np.pi)
    return x_mm + chord * np.cos(heading_rad + half), y_mm + chord * np.sin(heading_rad + half), heading_rad + 2 * half


@dataclass(frozen=True)
class Bicycle(SelfIntegratingModel):
    """Lateral position of a tip that follows arcs in the plane.

    The state is the lateral position (mm) and the heading (rad). The depth is the length of the path in the tissue; at
    negative depths the position does not change. A needle that is retracted without rotation returns along its path.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> motion = insertion_cycles(50.0, 5.0)
    >>> run = npl.models.simulate(npl.models.Bicycle(curvature_per_mm=0.01), motion)
    >>> print(f"{run.output.max():.2f} mm")
    12.24 mm
    """

    name: ClassVar[str] = "bicycle"
    channel: ClassVar[Channel] = Channel.LATERAL

    curvature_per_mm: float = parameter("1/mm", -1.0, 1.0, "curvature of the path, to the left", typical=1e-3)
    heading_rad: float = parameter("rad", -1.6, 1.6, "heading at entry", default=0.0, typical=0.01)
    offset_mm: float = parameter("mm", -1e4, 1e4, "lateral position at entry", default=0.0, typical=1.0)

    def initial_state(self, motion: Motion) -> Array:
        """Return lateral position and heading at the first sample, shape (2,), after an insertion without rotation."""
        depth, angle = (float(np.ravel(values)[0]) for values in (motion.depth_mm, motion.angle_rad))
        bend = self.curvature_per_mm * np.cos(angle)
        _, y, heading = arc_step(0.0, self.offset_mm, self.heading_rad, bend, max(depth, 0.0))
        return np.array([float(y), float(heading)])

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates (y', theta') per second, shape (2, ...)."""
        speed = np.where(motion.depth_mm > 0, motion.velocity_mm_s, 0.0)
        return np.array([speed * np.sin(state[1]), speed * self.curvature_per_mm * np.cos(motion.angle_rad)])

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return lateral position and heading at every sample, shape (2, samples)."""
        steps = np.diff(np.maximum(motion.depth_mm, 0.0))
        bend = self.curvature_per_mm * np.cos((motion.angle_rad[1:] + motion.angle_rad[:-1]) / 2)
        heading = start[1] + np.concatenate([[0.0], np.cumsum(bend * steps)])
        half = bend * steps / 2
        sideways = steps * np.sinc(half / np.pi) * np.sin(heading[:-1] + half)
        return np.array([start[0] + np.concatenate([[0.0], np.cumsum(sideways)]), heading])

    def step(self, state: Array, before: Motion, after: Motion) -> Array:
        """Return lateral positions and headings after one step, shape (2, m)."""
        length = max(float(after.depth_mm), 0.0) - max(float(before.depth_mm), 0.0)
        bend = self.curvature_per_mm * np.cos((before.angle_rad + after.angle_rad) / 2)
        return np.array(arc_step(0.0, state[0], state[1], bend, length)[1:])

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the lateral position (mm), shape (...)."""
        return np.asarray(state[0])
