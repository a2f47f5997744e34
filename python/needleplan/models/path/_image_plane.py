"""Image plane of an ultrasound probe: coordinates of the tip in the image, and the slice in which the tip is seen."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from needleplan.config import ConfigTable, Number, Numbers, ruled
from needleplan.errors import Mistake, ModelError
from needleplan.signals import Array

__all__ = ["ImagePlane"]

# Largest cosine of the angle between the two axes of an image.
_ORTHOGONAL = 1e-6


def _axes_are_orthogonal(u_axis: tuple[float, ...], v_axis: tuple[float, ...]) -> Iterator[Mistake]:
    if abs(float(np.dot(u_axis, v_axis))) > _ORTHOGONAL:
        yield Mistake("v_axis", f"{list(v_axis)}", f"must be at a right angle to u_axis, {list(u_axis)}")


@dataclass(frozen=True)
class ImagePlane(ConfigTable, key="ultrasound", error=ModelError, between=(_axes_are_orthogonal,)):
    """Image plane of an ultrasound probe at rest; the default is the plane of the plan.

    Raises ModelError with every value outside of its rule.

    Examples
    --------
    >>> from needleplan.models.path import ImagePlane
    >>> u, v, off = ImagePlane(origin_mm=(10.0, 0.0, 0.0)).seen((15.0, 2.0, 0.5))
    >>> print(f"u {u:g} mm, v {v:g} mm, {off:g} mm off the plane")
    u 5 mm, v 2 mm, 0.5 mm off the plane
    """

    origin_mm: tuple[float, ...] = ruled(Numbers(3), (0.0, 0.0, 0.0))
    """Point of the image at which both coordinates are 0, in the frame of the plan."""

    u_axis: tuple[float, ...] = ruled(Numbers(3, unit_length=True), (1.0, 0.0, 0.0))
    """Direction of the first coordinate of the image in the frame of the plan, of length 1."""

    v_axis: tuple[float, ...] = ruled(Numbers(3, unit_length=True), (0.0, 1.0, 0.0))
    """Direction of the second coordinate, at a right angle to the first."""

    thickness_mm: float = ruled(Number("mm", above=0, at_most=50), 4.0)
    """Thickness of the slice in which the tip is seen."""

    @property
    def axes(self) -> Array:
        """The two directions of the image and its normal as rows, shape (3, 3)."""
        return np.array([self.u_axis, self.v_axis, np.cross(self.u_axis, self.v_axis)])

    def seen(self, position_mm: tuple[float, ...]) -> tuple[float, float, float]:
        """Return the coordinates u and v of a position (mm), and its signed distance (mm) from the plane.

        Parameters
        ----------
        position_mm : tuple of float
            x, y, z in the frame of the plan.

        Returns
        -------
        tuple of float
            u, v and distance.
        """
        u, v, off = (self.axes @ (np.asarray(position_mm) - self.origin_mm)).tolist()
        return u, v, off

    def apart_mm(self, points_mm: Array) -> float:
        """Return how far the nearest of some points is from the slice.

        Parameters
        ----------
        points_mm : numpy.ndarray
            Points in the frame of the plan, shape (n, 3).

        Returns
        -------
        float
            Distance (mm); 0 if a point is in the slice.
        """
        off = np.abs((np.asarray(points_mm) - self.origin_mm) @ self.axes[2])
        return max(float(off.min()) - self.thickness_mm / 2, 0.0)

    def require_reached(self, entry_mm: tuple[float, float, float], longest_mm: float) -> Iterator[Mistake]:
        """Yield a mistake if no needle of a length can bring its tip from the entry into the slice.

        Parameters
        ----------
        entry_mm : tuple of float
            Position of the entry (mm).
        longest_mm : float
            Longest insertion (mm).

        Yields
        ------
        Mistake
        """
        apart = self.apart_mm(np.array([entry_mm]))
        if apart > longest_mm:
            rule = (
                f"must be crossed by the tip: the slice is {apart:.4g} mm from the entry, the insertion {longest_mm:g}"
            )
            yield Mistake("ultrasound.origin_mm", f"{list(self.origin_mm)}", rule)
