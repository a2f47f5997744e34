"""What curvature sensors and an ultrasound probe measure during an insertion, for the page."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.models import TipFrame
from needleplan.models.deflection import FibreSensors
from needleplan.models.path import ImagePlane
from needleplan.signals import IMAGE_COLUMNS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.recording import Recording

__all__ = ["Sensed"]

# Largest number of samples of the sensors that the page draws, and of arcs of a shape.
_MOST_SAMPLES, _ARCS = 400, 24
# Columns of the tip in `Sensed.tip` after the time.
_TIP = ("x_mm", "y_mm", "z_mm", "heading_rad", "elevation_rad", "roll_rad")


@dataclass(frozen=True)
class Sensed:
    """Samples of the curvature sensors and of the images of an insertion. Times are in s from the first message.

    - `tip`: time (s), x, y, z (mm), heading, elevation and roll (rad) of the estimated tip, shape (n, 7)
    - `fibre`, `curvatures`: sensors of the needle, or None; their samples as time (s) and curvatures y and z (1/mm) of
      each sensor, shape (m, 1 + 2 sensors)
    - `plane`, `images`: image plane, or None; time (s) and position u and v (mm), NaN if missed, shape (k, 3)
    """

    tip: NDArray[np.float64]
    fibre: FibreSensors | None
    curvatures: NDArray[np.float64]
    plane: ImagePlane | None
    images: NDArray[np.float64]

    @classmethod
    def of(cls, recording: Recording) -> Sensed:
        """Return the samples of a recorded insertion; the session's texts name sensors and plane."""
        texts, begin_s = recording.session.texts, recording.start_ns * 1e-9

        def rows(topic: str, *names: str) -> NDArray[np.float64]:
            if not recording.counts.get(topic):
                return np.empty((0, 1 + len(names)))
            columns = recording.columns(topic)
            return np.stack([columns["time_s"] - begin_s, *(columns[name] for name in names)], axis=1)

        fibre = FibreSensors(**json.loads(texts["fibre.json"])) if "fibre.json" in texts else None
        plane = ImagePlane(**json.loads(texts["ultrasound.json"])) if "ultrasound.json" in texts else None
        curvatures = rows("/fibre", *fibre.columns) if fibre else np.empty((0, 1))
        return cls(rows("/tip", *_TIP), fibre, curvatures, plane, rows("/image", *IMAGE_COLUMNS))

    def packed(self, *, in_space: bool) -> tuple[dict[str, Any], dict[str, NDArray[np.float32]]]:
        """Return what the message of an insertion has of the sensors: entries of the header, and arrays.

        Parameters
        ----------
        in_space
            Whether the plan is in 3D: curvatures are then sizes, and positions have z. In the plane, a positive
            curvature bends to the left.

        Returns
        -------
        tuple
            `sensors_mm` in the header. Arrays: `sensed_time_s` (m), `sensed_per_m` (m, sensors), `shape_mm` (m, points,
            2 or 3) from the tip to the last sensor; `image_time_s` (k), `image_mm` (k, 2 or 3), NaN if missed.
        """
        header: dict[str, Any] = {}
        arrays: dict[str, NDArray[np.float32]] = {}
        axes = 3 if in_space else 2
        if self.fibre and len(self.curvatures) and len(self.tip):
            kept = self.curvatures[:: -(-len(self.curvatures) // _MOST_SAMPLES)]
            places = [self._at(time_s) for time_s in kept[:, 0].tolist()]
            bends = [self._bends(row, roll) for row, (*_, roll) in zip(kept[:, 1:], places, strict=True)]
            shapes = [self._shape(bend, place) for bend, place in zip(bends, places, strict=True)]
            shown = np.abs(bends) if in_space else np.real(bends)
            header["sensors_mm"] = list(self.fibre.from_tip_mm)
            arrays["sensed_time_s"] = kept[:, 0].astype(np.float32)
            arrays["sensed_per_m"] = (1e3 * shown).astype(np.float32)
            arrays["shape_mm"] = np.array(shapes)[:, :, :axes].astype(np.float32)
        if self.plane and len(self.images):
            places_mm = self.images[:, 1:] @ self.plane.axes[:2] + self.plane.origin_mm
            arrays["image_time_s"] = self.images[:, 0].astype(np.float32)
            arrays["image_mm"] = places_mm[:, :axes].astype(np.float32)
        return header, arrays

    def _at(self, time_s: float) -> tuple[float, ...]:
        """Return x, y, z (mm), heading, elevation and roll (rad) of the last estimate before a time, or of the first."""
        row = max(int(np.searchsorted(self.tip[:, 0], time_s, side="right")) - 1, 0)
        return tuple(self.tip[row, 1:].tolist())

    def _bends(self, curvatures: NDArray[np.float64], roll_rad: float) -> NDArray[np.complex128]:
        """Return the curvatures (1/mm) of the sensors to the left (real part) and upwards (imaginary part)."""
        return (curvatures[::2] + 1j * curvatures[1::2]) * np.exp(1j * roll_rad)

    def _shape(self, bends: NDArray[np.complex128], place: tuple[float, ...]) -> list[tuple[float, float, float]]:
        """Return points (mm) of the needle from the tip back to the last sensor; NaN without a reading."""
        assert self.fibre
        x, y, z, heading, elevation, _ = place
        at, known = np.array(self.fibre.from_tip_mm), np.isfinite(bends)
        if not known.any():
            return [(math.nan, math.nan, math.nan)] * (_ARCS + 1)
        step = (at[-1] + self.fibre.gauge_mm / 2) / _ARCS
        bend = np.interp((np.arange(_ARCS) + 0.5) * step, at[known], bends[known])
        frame = TipFrame.planar(x, y, heading).raised(elevation).moved((0.0, 0.0, z))
        points = [frame.position_mm]
        for left, up in zip(bend.real.tolist(), bend.imag.tolist(), strict=True):
            frame = frame.arc(left, up, -step)
            points.append(frame.position_mm)
        return points
