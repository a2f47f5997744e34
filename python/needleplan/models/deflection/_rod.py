"""Shape of a needle in layered tissue: an inextensible Cosserat rod with an intrinsic curvature.

The tissue bends the needle as if it had been made with an intrinsic curvature k0(s) toward the bevel, s from the entry
(0) to the tip (L). With one constant kappa_c for each layer, equations (1) and (2) of
docs/explanation/needle-shape.md::

    k0'' = 2 kappa_c / L^2,   k0(L) = k0'(L) = 0,   one layer: k0 = kappa_c (1 - s/L)^2
    kappa_c(L) = kappa_c (reference / L)^power

The curvatures kn and kb along the axes n (toward the bevel) and b of the needle, and its twist tau, are omega = (kn,
kb, tau), with the value omega_init at the entry. They obey the Euler-Poincare equation (3) of
docs/explanation/needle-shape.md; the frame (t, n, b) and the position follow from them by equation (4) of
docs/explanation/needle-shape.md. The crate `needle` integrates all four.

Sources: Kim, Guo, Chatrasingh, Kim and Iordachita, "Shape determination during needle insertion with curvature
measurements", IROS 2017, for one layer; Lezcano, Iordachita and Kim, IEEE Sensors Journal 22 (2022), for two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from needleplan import _ppvi
from needleplan.artifacts import ShortRepr
from needleplan.errors import Mistake, ModelError
from needleplan.models._base import Channel, Model
from needleplan.models._parameter import constant, parameter
from needleplan.signals import Array, Motion

__all__ = ["LayeredShape", "NeedleShape"]

# Depth (mm) below which the needle counts as straight: its shape is not defined for a length of zero.
_SHORTEST_MM = 1e-3


@dataclass(frozen=True)
class NeedleShape(ShortRepr):
    """Shape of a needle at some places along its length.

    Parameters
    ----------
    place_mm : numpy.ndarray
        Distances from the entry along the needle, shape (k,).
    position_mm : numpy.ndarray
        Positions x, y, z, shape (k, 3).
    tangent, normal : numpy.ndarray
        Unit vectors along the needle, and across it toward the bevel, shape (k, 3).
    curvature_per_mm : numpy.ndarray
        Curvatures kn and kb along the normal and the binormal, and the twist, shape (k, 3).

    Examples
    --------
    >>> from needleplan.models import LayeredShape
    >>> shape = LayeredShape(intrinsic_per_mm=0.004, start_n_per_mm=0.004).shape(100.0, [0.0, 100.0])
    >>> shape.position_mm.round(2)
    array([[ 0.  ,  0.  ,  0.  ],
           [99.43,  9.98,  0.  ]])
    """

    place_mm: Array
    position_mm: Array
    tangent: Array
    normal: Array
    curvature_per_mm: Array


@dataclass(frozen=True)
class LayeredShape(Model):
    """Tip of a needle whose shape is a Cosserat rod with an intrinsic curvature, in one or two layers of tissue.

    The position of the tip depends on the depth only. The base does not turn during the insertion: `angle_rad` is the
    direction of the bevel, about the line of the insertion. `shape` returns the whole needle, `curvatures` what sensors
    along the needle measure. With `boundary_mm` at its default, the tissue has one layer.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.models import LayeredShape, simulate
    >>> from needleplan.signals import Motion
    >>> depth = np.linspace(0.0, 100.0, 101)
    >>> model = LayeredShape(0.002, start_n_per_mm=0.003, second_per_mm=0.006, boundary_mm=60.0)
    >>> run = simulate(model, Motion.sampled(depth / 10.0, depth))
    >>> print(f"y = {run.output[1, -1]:.1f} mm")
    y = 4.7 mm
    """

    name: ClassVar[str] = "layered_shape"
    channel: ClassVar[Channel] = Channel.TIP

    intrinsic_per_mm: float = parameter("1/mm", -0.1, 0.1, "kappa_c of the first layer", typical=1e-3)
    start_n_per_mm: float = parameter(
        "1/mm", -0.1, 0.1, "omega_init, curvature toward the bevel at the entry", typical=1e-3
    )
    start_b_per_mm: float = parameter(
        "1/mm", -0.1, 0.1, "omega_init, curvature across the bevel at the entry", default=0.0, typical=1e-3
    )
    start_twist_per_mm: float = parameter(
        "1/mm", -0.02, 0.02, "omega_init, twist at the entry", default=0.0, typical=1e-3, free=False
    )
    second_per_mm: float = parameter(
        "1/mm", -0.1, 0.1, "kappa_c of the second layer", default=0.0, typical=1e-3, free=False
    )
    boundary_mm: float = constant(
        "mm", 0.1, 1e4, "length of the needle up to the second layer", default=1e4, typical=10.0
    )
    heading_y_rad: float = parameter("rad", -1.0, 1.0, "slope along y at the entry", default=0.0, typical=1e-3)
    heading_z_rad: float = parameter("rad", -1.0, 1.0, "slope along z at the entry", default=0.0, typical=1e-3)
    torsion_ratio: float = constant("", 0.1, 10.0, "GJ/EI; 1/(1 + Poisson's ratio) for a round shaft", default=0.775)
    power: float = constant("", 0.0, 3.0, "exponent of kappa_c by depth; 0: kappa_c does not change", default=0.0)
    reference_mm: float = constant("mm", 1.0, 1000.0, "depth at which kappa_c holds", default=100.0)

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return the empty state, shape (0,)."""
        return np.zeros(0)

    def derivative(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the rates of the empty state, shape (0, ...)."""
        return np.zeros_like(state)

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the position of the tip (mm), shape (3, ...)."""
        depth = np.asarray(motion.depth_mm, float)
        length = np.maximum(depth.reshape(-1), _SHORTEST_MM)
        x, y, z = self._stations(length, length[:, None])[0][:, 0].T
        cos, sin = np.cos(motion.angle_rad), np.sin(motion.angle_rad)
        y, z = y.reshape(depth.shape), z.reshape(depth.shape)
        bent = np.array([x.reshape(depth.shape), cos * y - sin * z, sin * y + cos * z])
        return np.where(depth > 0, np.tensordot(self._entry(), bent, axes=1), 0.0)

    def shape(self, depth_mm: float, place_mm: ArrayLike) -> NeedleShape:
        """Return the shape of the needle at a depth, with the base at the angle 0.

        Parameters
        ----------
        depth_mm : float
            Inserted length L, above 0.
        place_mm : array_like
            Distances from the entry (mm), increasing from 0 or more to at most the inserted length.

        Returns
        -------
        NeedleShape

        Raises
        ------
        ModelError
            The depth is not above 0, or the places do not increase along the inserted length.
        """
        place = np.atleast_1d(np.asarray(place_mm, float))
        if not 0 < depth_mm < np.inf:
            raise ModelError(Mistake("depth_mm", f"{depth_mm:g}", "must be above 0 mm"))
        if (
            place.ndim != 1
            or not place.size
            or not 0 <= place[0] <= place[-1] <= depth_mm
            or (place[1:] < place[:-1]).any()
        ):
            rule = f"must increase from 0 or more to at most the inserted length, {depth_mm:g} mm"
            raise ModelError(Mistake("place_mm", f"{place.reshape(-1)[:8].tolist()}", rule))
        position, tangent, normal, curvature = (
            station[0] for station in self._stations(np.array([float(depth_mm)]), place[None])
        )
        entry = self._entry().T
        return NeedleShape(place, position @ entry, tangent @ entry, normal @ entry, curvature)

    def curvatures(self, depth_mm: ArrayLike, from_tip_mm: ArrayLike) -> Array:
        """Return the curvatures that sensors along the needle measure, in the axes of the needle.

        Parameters
        ----------
        depth_mm : array_like
            Inserted lengths (mm), shape (n,).
        from_tip_mm : array_like
            Distances of the sensors from the tip (mm), increasing, shape (k,).

        Returns
        -------
        numpy.ndarray
            Curvatures along n and b (1/mm), shape (n, k, 2); NaN for sensors that are not in the tissue.
        """
        depth, behind = np.atleast_1d(np.asarray(depth_mm, float)), np.atleast_1d(np.asarray(from_tip_mm, float))
        place = depth[:, None] - behind[None, ::-1]
        length = np.maximum(depth, _SHORTEST_MM)
        seen = self._stations(length, np.clip(place, 0.0, length[:, None]))[3][:, ::-1, :2]
        return np.asarray(np.where(place[:, ::-1, None] < 0, np.nan, seen))

    def _stations(self, length_mm: Array, place_mm: Array) -> tuple[Array, Array, Array, Array]:
        """Return positions, tangents, normals and curvatures, shape (n, k, 3), in the frame of the entry."""
        constants = [self.intrinsic_per_mm] + [self.second_per_mm] * (self.boundary_mm < 1e4)
        scale = (self.reference_mm / length_mm) ** self.power if self.power else np.ones_like(length_mm)
        return _ppvi.rod_stations(
            lengths_mm=np.ascontiguousarray(length_mm),
            places_mm=np.ascontiguousarray(place_mm),
            intrinsic_per_mm=np.ascontiguousarray(scale[:, None] * np.array(constants)),
            boundaries_mm=[self.boundary_mm] * (len(constants) - 1),
            start_per_mm=[self.start_n_per_mm, self.start_b_per_mm, self.start_twist_per_mm],
            torsion_ratio=self.torsion_ratio,
        )

    def _entry(self) -> Array:
        """Return the axes t, n and b at the entry as the columns of a rotation matrix."""
        y, z = self.heading_y_rad, self.heading_z_rad
        level, whole = math.hypot(1.0, y), math.sqrt(1.0 + y * y + z * z)
        (a, b, c), (d, e) = (1 / whole, y / whole, z / whole), (-y / level, 1 / level)
        return np.array([[a, d, -c * e], [b, e, c * d], [c, 0.0, a * e - b * d]])
