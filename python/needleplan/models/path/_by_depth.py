"""The bicycle model in the plane with a curvature that changes with the depth.

The equations are those of `Bicycle`, with the curvature k(d) at the depth d. k has the value `curvature_per_mm` at the
entry and `curvature_1_per_mm`, ... at the depths `depth_1_mm`, .... Between these depths it is constant (a step at
each depth: layers) or linear. A straight part has the curvature 0.

The bicycle model in the plane: the tip of a bevel needle follows arcs.

With the length l of the path, the heading theta from the x axis (counter-clockwise positive) and the curvature k::

    dx/dl = cos theta,    dy/dl = sin theta,    dtheta/dl = k cos phi

phi is the rotation of the needle. At phi = 0 (bevel +1) the path bends to the left, at phi = pi (bevel -1) to the
right. At other angles only the component in the plane counts. At constant phi the path is an arc of a circle, which
`arc_step` computes exactly (Webster et al., Int. J. Robotics Research 25 (2006) 509, the unicycle limit: no side slip).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from needleplan.models._base import Channel, SelfIntegratingModel
from needleplan.models._parameter import constant, parameter
from needleplan.signals import Array, Motion

__all__ = ["BetweenDepths", "Bicycle", "BicycleByDepth", "arc_step"]


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


# Depth (mm) that marks an unused change of the curvature.
_UNUSED_MM = 1e4

# Number of arcs with which the path from the entry to the first sample is computed.
_ARCS = 64


class BetweenDepths(StrEnum):
    """Curvature between the depths at which it is given.

    Examples
    --------
    >>> import needleplan as npl
    >>> str(npl.models.BetweenDepths.CONSTANT)
    'constant'
    """

    CONSTANT = "constant"
    """Constant up to the next depth."""

    LINEAR = "linear"
    """Linear up to the next depth, and constant beyond the last one."""


@dataclass(frozen=True)
class BicycleByDepth(SelfIntegratingModel):
    """Lateral position of a tip in the plane whose curvature changes with the depth.

    The state is the lateral position (mm) and the heading (rad), as for `Bicycle`. The depth is the length of the path
    in the tissue. A change of the curvature at a depth of 10,000 mm, the default, is not used.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> model = npl.models.BicycleByDepth(curvature_per_mm=0.01, depth_1_mm=25.0, curvature_1_per_mm=0.0)
    >>> print(f"{npl.models.simulate(model, insertion_cycles(50.0, 5.0)).output.max():.2f} mm")
    9.29 mm
    """

    name: ClassVar[str] = "bicycle_by_depth"
    channel: ClassVar[Channel] = Channel.LATERAL

    curvature_per_mm: float = parameter("1/mm", -1.0, 1.0, "curvature at the entry, to the left", typical=1e-3)
    heading_rad: float = parameter("rad", -1.6, 1.6, "heading at entry", default=0.0, typical=0.01)
    offset_mm: float = parameter("mm", -1e4, 1e4, "lateral position at entry", default=0.0, typical=1.0)
    curvature_1_per_mm: float = parameter(
        "1/mm", -1.0, 1.0, "curvature from the first depth on", default=0.0, typical=1e-3
    )
    curvature_2_per_mm: float = parameter(
        "1/mm", -1.0, 1.0, "curvature from the second depth on", default=0.0, typical=1e-3, free=False
    )
    curvature_3_per_mm: float = parameter(
        "1/mm", -1.0, 1.0, "curvature from the third depth on", default=0.0, typical=1e-3, free=False
    )
    depth_1_mm: float = constant("mm", 0.0, _UNUSED_MM, "first depth", default=_UNUSED_MM, typical=10.0)
    depth_2_mm: float = constant("mm", 0.0, _UNUSED_MM, "second depth", default=_UNUSED_MM, typical=10.0)
    depth_3_mm: float = constant("mm", 0.0, _UNUSED_MM, "third depth", default=_UNUSED_MM, typical=10.0)
    between: BetweenDepths = BetweenDepths.CONSTANT

    @property
    def knots(self) -> tuple[Array, Array]:
        """Depths (mm) from 0 on at which the curvature is given, and these curvatures (1/mm), shape (n,) each."""
        pairs = [(0.0, self.curvature_per_mm)]
        pairs += [
            (depth, bend)
            for depth, bend in (
                (self.depth_1_mm, self.curvature_1_per_mm),
                (self.depth_2_mm, self.curvature_2_per_mm),
                (self.depth_3_mm, self.curvature_3_per_mm),
            )
            if depth < _UNUSED_MM
        ]
        depth, bend = np.array(sorted(pairs, key=lambda pair: pair[0])).T
        return depth, bend

    def curvature_at(self, depth_mm: Array | float) -> Array:
        """Return the curvature (1/mm) at depths, shape of `depth_mm`, for a bevel to the left."""
        depth, bend = self.knots
        if self.between is BetweenDepths.LINEAR:
            return np.asarray(np.interp(depth_mm, depth, bend))
        return np.asarray(bend[np.maximum(np.searchsorted(depth, depth_mm, side="right") - 1, 0)])

    def initial_state(self, motion: Motion) -> Array:
        """Return lateral position and heading at the first sample, shape (2,), after an insertion without rotation."""
        depth, angle = (float(np.ravel(values)[0]) for values in (motion.depth_mm, motion.angle_rad))
        edges = np.unique(np.concatenate([np.linspace(0.0, max(depth, 0.0), _ARCS), self.knots[0]]))
        edges = edges[edges <= max(depth, 0.0)]
        pose = (0.0, self.offset_mm, self.heading_rad)
        for first, last in pairwise(edges):
            pose = arc_step(*pose, float(self.curvature_at((first + last) / 2)) * np.cos(angle), last - first)
        return np.array([float(pose[1]), float(pose[2])])

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates (y', theta') per second, shape (2, ...)."""
        speed = np.where(motion.depth_mm > 0, motion.velocity_mm_s, 0.0)
        return np.array([
            speed * np.sin(state[1]), speed * self.curvature_at(motion.depth_mm) * np.cos(motion.angle_rad)
        ])  # fmt: skip

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return lateral position and heading at every sample, shape (2, samples)."""
        depth = np.maximum(motion.depth_mm, 0.0)
        steps = np.diff(depth)
        bend = self.curvature_at((depth[1:] + depth[:-1]) / 2) * np.cos(
            (motion.angle_rad[1:] + motion.angle_rad[:-1]) / 2
        )
        heading = start[1] + np.concatenate([[0.0], np.cumsum(bend * steps)])
        half = bend * steps / 2
        sideways = steps * np.sinc(half / np.pi) * np.sin(heading[:-1] + half)
        return np.array([start[0] + np.concatenate([[0.0], np.cumsum(sideways)]), heading])

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the lateral position (mm), shape (...)."""
        return np.asarray(state[0])
