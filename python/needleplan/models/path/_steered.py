"""The path of a bevel tip in 3D, as a tracker measures it: the bicycle model with the roll of the needle.

With the length l of the path, its tangent t, the rotation-minimising normals n and b (see `TipFrame`) and the curvature
(kn, kb)::

    dp/dl = t,    dt/dl = kn n + kb b,    dn/dl = -kn t,    db/dl = -kb t

For the plain bicycle, (kn, kb) = k (cos phi, sin phi), where the roll phi of the tip is the angle of the base. The
needle enters along the x axis. At angle 0 it bends toward +y; a positive angle rotates this direction toward +z. The
state holds position, tangent and n (three numbers each) and the roll of the tip.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models._base import Channel, SelfIntegratingModel
from needleplan.models._parameter import parameter
from needleplan.models.path._frame import axes_of, quaternion_of, quaternions_along
from needleplan.signals import Array, Motion

__all__ = ["SpatialBicycle", "SteeredModel"]

# Time constant with which the roll of the tip follows the base in `derivative`, s.
_FOLLOWING_S = 1e-3


@dataclass(frozen=True)
class SteeredModel(SelfIntegratingModel):
    """Abstract base class of models of the path of a tip in 3D; the output is the position, shape (3, ...).

    A subclass defines the curvature of the path, its entry, and how the roll of the tip follows the base.

    Examples
    --------
    >>> import needleplan as npl
    >>> issubclass(npl.models.SpatialBicycle, npl.models.SteeredModel)
    True
    """

    channel: ClassVar[Channel] = Channel.TIP

    @abstractmethod
    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:
        """Return the curvature of the path along the normal n and the binormal b.

        Parameters
        ----------
        motion : Motion
            Motion or instant.
        roll_rad : numpy.ndarray
            Roll angles of the tip (rad), shape (...).

        Returns
        -------
        numpy.ndarray
            Curvature (1/mm), shape (2, ...).
        """

    @abstractmethod
    def entry(self, motion: Motion) -> tuple[Array, Array]:
        """Return the entry point (mm), shape (3,), and the slopes of the path along y and z there (rad), shape (2,)."""

    def following(self, roll_rad: Array, motion: Motion) -> Array:
        """Return the roll that the base imposes on the tip. Default: the angle of the base.

        Parameters
        ----------
        roll_rad : numpy.ndarray
            Roll of the tip (rad), shape (...).
        motion : Motion
            Motion or instant.

        Returns
        -------
        numpy.ndarray
            Roll (rad), shape (...).
        """
        return np.asarray(motion.angle_rad + 0 * roll_rad)

    def rolls(self, motion: Motion, start_rad: float) -> Array:  # noqa: ARG002
        """Return the roll of the tip at every sample. Default: the angle of the base.

        Parameters
        ----------
        motion : Motion
            Sampled motion of the needle base.
        start_rad : float
            Roll of the tip at the first sample (rad).

        Returns
        -------
        numpy.ndarray
            Roll (rad), shape (samples,).
        """
        return motion.angle_rad

    def initial_state(self, motion: Motion) -> Array:
        """Return the state at the first sample, shape (10,).

        The needle was inserted to this depth with the angle and the velocity of this sample.
        """
        first = motion[:1]
        place, slopes = self.entry(first)
        tangent = np.array([1.0, *slopes]) / np.sqrt(1 + slopes @ slopes)
        normal = np.array([-tangent[1], tangent[0], 0.0]) / np.hypot(tangent[0], tangent[1])
        start = np.concatenate([place, tangent, normal, first.angle_rad])
        depth = max(float(first.depth_mm[0]), 0.0)
        if depth == 0:
            return start
        return self._arcs(start, self.bend_per_mm(first, first.angle_rad), np.array([depth]), start[9:])[:, -1]

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of change of the state, shape (10, ...)."""
        tangent, normal, roll = state[3:6], state[6:9], state[9]
        speed = np.where(np.asarray(motion.depth_mm) > 0, motion.velocity_mm_s, 0.0)
        kn, kb = self.bend_per_mm(motion, roll)
        binormal = np.cross(tangent, normal, axis=0)
        turning = (self.following(roll, motion) - roll) / _FOLLOWING_S
        return np.concatenate(
            [speed * tangent, speed * (kn * normal + kb * binormal), -speed * kn * tangent, np.asarray(turning)[None]]
        )

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the state at every sample, shape (10, samples); the path between two samples is an exact arc."""
        roll = self.rolls(motion, float(start[9]))
        bend = self.bend_per_mm(motion.between(0.5), (roll[1:] + roll[:-1]) / 2)
        return self._arcs(start, bend, np.diff(np.maximum(motion.depth_mm, 0.0)), roll)

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the measured position (mm), shape (3, ...)."""
        return self.shown(state, motion, self)

    def shown(self, state: Array, motion: Motion, whole: SteeredModel) -> Array:  # noqa: ARG002
        """Return the measured position for a state. Default: the position in the state.

        Parameters
        ----------
        state : numpy.ndarray
            State of the model `whole`, shape (n, ...).
        motion : Motion
            Motion or instant.
        whole : SteeredModel
            Model with all effects, which gives curvature and entry.

        Returns
        -------
        numpy.ndarray
            Position (mm), shape (3, ...).
        """
        return np.asarray(state[:3])

    @staticmethod
    def _arcs(start: Array, bend: Array, length: Array, roll: Array) -> Array:
        kn, kb = bend
        along = quaternions_along(
            np.stack([np.zeros_like(kn), -kb * length, kn * length]), quaternion_of(start[3:6], start[6:9])
        )
        tangent, normal, binormal = axes_of(along)
        half = np.hypot(kn, kb) * length / 2
        # The chord is l sinc(half) cos(half) along the tangent at its begin, and k l^2/2 sinc(half)^2 across it.
        sinc = np.sinc(half / np.pi)
        across = sinc**2 * length**2 / 2
        step = sinc * np.cos(half) * length * tangent[:, :-1]
        step = step + across * (kn * normal[:, :-1] + kb * binormal[:, :-1])
        place = start[:3, None] + np.concatenate([np.zeros((3, 1)), np.cumsum(step, axis=1)], axis=1)
        rolls = roll if len(roll) == place.shape[1] else np.full(place.shape[1], roll[-1])
        return np.concatenate([place, tangent, normal, rolls[None]])


@dataclass(frozen=True)
class SpatialBicycle(SteeredModel):
    """A bevel tip on arcs whose plane rotates with the base. The depth is the length of the path in the tissue.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> motion = insertion_cycles(50.0, 5.0)
    >>> run = npl.models.simulate(npl.models.SpatialBicycle(curvature_per_mm=0.01), motion)
    >>> print(f"x {run.output[0].max():.1f} mm, y {run.output[1].max():.1f} mm")
    x 47.9 mm, y 12.2 mm
    """

    name: ClassVar[str] = "spatial_bicycle"

    curvature_per_mm: float = parameter("1/mm", 1e-6, 1.0, "curvature of the path, toward the bevel")
    heading_y_rad: float = parameter("rad", -1.0, 1.0, "slope of the path along y at entry", default=0.0, typical=1e-3)
    heading_z_rad: float = parameter("rad", -1.0, 1.0, "slope of the path along z at entry", default=0.0, typical=1e-3)
    entry_x_mm: float = parameter("mm", -1e4, 1e4, "entry point, x", default=0.0, typical=0.03)
    entry_y_mm: float = parameter("mm", -1e4, 1e4, "entry point, y", default=0.0, typical=0.03)
    entry_z_mm: float = parameter("mm", -1e4, 1e4, "entry point, z", default=0.0, typical=0.03)

    def bend_per_mm(self, motion: Motion, roll_rad: Array) -> Array:  # noqa: ARG002
        """Return the curvature (1/mm) along n and b, shape (2, ...), which is directed toward the bevel."""
        return self.curvature_per_mm * np.array([np.cos(roll_rad), np.sin(roll_rad)])

    def entry(self, motion: Motion) -> tuple[Array, Array]:  # noqa: ARG002
        """Return the entry point (mm) and the slopes (rad) at the entry from the parameters."""
        place = np.array([self.entry_x_mm, self.entry_y_mm, self.entry_z_mm])
        return place, np.array([self.heading_y_rad, self.heading_z_rad])
