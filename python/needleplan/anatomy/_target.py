"""The target as the user gave it, in the frame of a lattice: a ball, or voxels of the file.

Executions end in it, and not in voxels of the lattice: those lie in the target only in part at its rim, and may be
blocked where an obstacle is beside it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from needleplan.anatomy._file import Region, Sphere
from needleplan.artifacts import ShortRepr

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.anatomy._anatomy import Anatomy
    from needleplan.anatomy._frame import SpaceFrame

__all__ = ["TargetBody"]


@dataclass(frozen=True, eq=False)
class TargetBody(ShortRepr):
    """The volume of a target in a frame.

    `ball`: centre and radius (mm), shape (4,); None if the target is a label. For a label, `inside`, shape (a, b, c),
    is 1 in the voxels of the target, and `rows`, shape (3, 4), leads from a point p (mm) to the indices floor(`rows`
    (p, 1)) of its voxel.
    """

    ball: tuple[float, float, float, float] | None
    rows: NDArray[np.float64]
    inside: NDArray[np.uint8]

    @classmethod
    def of_ball(cls, frame: SpaceFrame, ball: Sphere) -> TargetBody:
        """Return the target that is a ball.

        Parameters
        ----------
        frame : SpaceFrame
            Frame of the result.
        ball : Sphere
            Ball in the coordinates of the volume (mm).

        Returns
        -------
        TargetBody
        """
        x, y, z = frame.local(ball.center_mm).tolist()
        return cls((x, y, z, ball.radius_mm), np.zeros((3, 4)), np.zeros((0, 0, 0), np.uint8))

    @classmethod
    def of_anatomy(cls, anatomy: Anatomy, frame: SpaceFrame, region: Region) -> TargetBody:
        """Return a target of an anatomy.

        Parameters
        ----------
        anatomy : Anatomy
            The anatomy.
        frame : SpaceFrame
            Frame of the result.
        region : str, int or Sphere
            The target: a label or a ball.

        Returns
        -------
        TargetBody
        """
        volume = anatomy.volume
        if isinstance(region, Sphere):
            return cls.of_ball(frame, region)
        inside = anatomy.inside(region)
        places = np.argwhere(inside)
        first, last = places.min(0), places.max(0) + 1
        # Place in the volume of a point p of the frame: inverse of (affine), applied to o + p E; the centre of voxel
        # (0, 0, 0) has the place 0, so that 1/2 is added.
        linear = np.linalg.inv(volume.affine[:3, :3]) @ frame.axes.T
        offset = volume.voxels(frame.origin_mm) + 0.5 - first
        cropped = inside[tuple(slice(a, b) for a, b in zip(first, last, strict=True))]
        return cls(None, np.column_stack([linear, offset]), np.ascontiguousarray(cropped, np.uint8))

    def moved(self, corner_mm: NDArray[np.float64]) -> TargetBody:
        """Return the target in a frame with its origin at the point `corner_mm` of this frame."""
        if self.ball is not None:
            x, y, z = (np.array(self.ball[:3]) - corner_mm).tolist()
            return replace(self, ball=(x, y, z, self.ball[3]))
        rows = self.rows.copy()
        rows[:, 3] += rows[:, :3] @ corner_mm
        return replace(self, rows=rows)

    def contains(self, points_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which points of the frame (mm), shape (..., 3), lie in the target."""
        if self.ball is not None:
            return np.asarray(((points_mm - self.ball[:3]) ** 2).sum(-1) <= self.ball[3] ** 2)
        return self._is_inside(np.floor(self._places(points_mm)).astype(np.int64))

    def _places(self, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(points_mm @ self.rows[:, :3].T + self.rows[:, 3])

    def _is_inside(self, voxels: NDArray[np.int64]) -> NDArray[np.bool_]:
        shape = np.array(self.inside.shape)
        within = ((voxels >= 0) & (voxels < shape)).all(-1)
        at = tuple(np.moveaxis(np.clip(voxels, 0, shape - 1), -1, 0))
        return np.asarray(within & (self.inside[at] > 0))
