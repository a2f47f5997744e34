"""What curvature sensors and an ultrasound probe measure during an insertion, for the page."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from needleplan.signals import IMAGE_COLUMNS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.models.deflection import FibreSensors
    from needleplan.models.path import ImagePlane
    from needleplan.recording import Recording

__all__ = ["Sensed"]

# Largest number of samples of the sensors that the page draws.
_MOST_SAMPLES = 300
# Length (mm) of path over which the readings of all sensors are averaged for the shape: one arc.
_ARC_MM = 1.0
# Columns of the tip in `Sensed.tip` after the time.
_TIP = ("x_mm", "y_mm", "z_mm", "heading_rad", "elevation_rad", "roll_rad", "depth_mm")


@dataclass(frozen=True)
class Sensed:
    """Samples of the curvature sensors and of the images of an insertion. Times are in s from the first message.

    - `tip`: time (s), x, y, z (mm), heading, elevation, roll (rad) and depth (mm) of the estimated tip, shape (n, 8)
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
        from needleplan.models.deflection import FibreSensors
        from needleplan.models.path import ImagePlane

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
            2 or 3) from the entry to the first sensor, NaN beyond; `image_time_s` (k), `image_mm` (k, 2 or 3), NaN if
            missed.
        """
        header: dict[str, Any] = {}
        arrays: dict[str, NDArray[np.float32]] = {}
        axes = 3 if in_space else 2
        if self.fibre and len(self.curvatures) and len(self.tip):
            every = -(-len(self.curvatures) // _MOST_SAMPLES)
            time_s, bends = self.curvatures[:, 0], self._bends()
            shown = np.abs(bends) if in_space else bends.real
            header["sensors_mm"] = list(self.fibre.from_tip_mm)
            arrays["sensed_time_s"] = time_s[::every].astype(np.float32)
            arrays["sensed_per_m"] = (1e3 * shown[::every]).astype(np.float32)
            arrays["shape_mm"] = self._shapes(bends, every)[:, :, :axes].astype(np.float32)
        if self.plane and len(self.images):
            places_mm = self.images[:, 1:] @ self.plane.axes[:2] + self.plane.origin_mm
            arrays["image_time_s"] = self.images[:, 0].astype(np.float32)
            arrays["image_mm"] = places_mm[:, :axes].astype(np.float32)
        return header, arrays

    def _bends(self) -> NDArray[np.complex128]:
        """Return the curvatures (1/mm) of each sensor to the left (real part) and upwards (imaginary part)."""
        roll = np.interp(self.curvatures[:, 0], self.tip[:, 0], self.tip[:, 6])
        bends: NDArray[np.complex128] = self.curvatures[:, 1::2] + 1j * self.curvatures[:, 2::2]
        return np.asarray(bends * np.exp(1j * roll)[:, None])

    def _shapes(self, bends: NDArray[np.complex128], every: int) -> NDArray[np.float64]:
        """Return points (mm) of the needle at each `every`-th sample, from the entry to the first sensor; NaN beyond.

        The curvature at a place of the path is the mean of all readings there up to this sample, by the length by which
        the needle has advanced: at rest it turns. Arcs begin with the estimated pose of the tip at the entry.
        """
        from needleplan.models import TipFrame

        assert self.fibre
        depth = np.interp(self.curvatures[:, 0], self.tip[:, 0], self.tip[:, 7])
        places = depth[:, None] - np.array(self.fibre.from_tip_mm)
        arcs = max(math.ceil(places.max() / _ARC_MM), 1)
        fresh = np.diff(np.maximum.accumulate(depth), prepend=depth[0])
        known = np.isfinite(bends) & (places > 0) & (fresh[:, None] > 0)
        lengths = np.broadcast_to(fresh[:, None], known.shape)
        numbers = np.minimum((np.where(known, places, 0.0) / _ARC_MM).astype(int), arcs - 1)
        sums, weights = np.zeros(arcs, complex), np.zeros(arcs)
        _, x, y, z, heading, elevation, *_ = self.tip[min(int(np.searchsorted(self.tip[:, 7], 0.0)), len(self.tip) - 1)]
        entry = TipFrame.planar(x, y, heading).raised(elevation).moved((0.0, 0.0, z))
        points = np.full((-(-len(bends) // every), arcs + 1, 3), np.nan)
        for row, begin in enumerate(range(0, len(bends), every)):
            block = slice(max(begin - every + 1, 0), begin + 1)
            used = known[block]
            here, length = numbers[block][used], lengths[block][used]
            np.add.at(sums, here, length * bends[block][used])
            np.add.at(weights, here, length)
            frame = entry
            if weights[0]:
                points[row, 0] = frame.position_mm
            for arc in range(int(places[begin].max() / _ARC_MM)):
                if not weights[arc]:
                    break
                mean = sums[arc] / weights[arc]
                frame = frame.arc(float(mean.real), float(mean.imag), _ARC_MM)
                points[row, arc + 1] = frame.position_mm
        return points
