"""Curvature sensors in the tip filter: differences of the mean direction over windows of the path.

A grating averages the curvature over its gauge g. While the sensor moves along the path by g, the integral of its
readings is therefore the difference of the mean directions over two adjacent windows of the length g, equations (1) and
(2) of docs/explanation/tip-fibre.md. The windows divide the path from the surface on. The state holds the mean
directions of the last windows (stochastic cloning, Roumeliotis and Burdick, ICRA 2002), the running integral of the
direction over the present window, and the constant errors of the sensors. The roll belongs to the direction, because it
changes along a path out of the plane.

Columns after those of the path: integrals of heading, elevation and roll, errors y and z of each sensor, then mean
heading, elevation and roll of the last windows, the newest first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from needleplan import _ppvi
from needleplan.devices import FibreSample, Health
from needleplan.errors import DataError, Mistake
from needleplan.estimation.tip._estimate import TipSettings
from needleplan.estimation.tip._path import INTEGRATED, SIZE
from needleplan.models.deflection import FibreSensors
from needleplan.signals import Array

__all__ = ["FibreWindows"]

# Number of angles of a window, and columns of their integrals over the present window (rad mm).
_ANGLES = len(INTEGRATED)
_INTEGRALS = slice(SIZE, SIZE + _ANGLES)

# Length of path (mm) that the stored windows cover, and their largest number.
_COVERED_MM = 40.0
_MOST = 12

# Largest plausible curvature (1/mm), as in files of data, and number of samples in a row beyond it that are an error.
_LARGEST_PER_MM, _MANY_SAMPLES = 0.1, 10

# Longest path (mm) between two readings over which a sensor is interpolated; a longer gap spoils the window.
_GAP_MM = 1.0


@dataclass
class _Passage:
    """Readings of one sensor while it moves from the middle of a window to the middle of the next one.

    `left` and `up` are the integrals of the curvature in the axes of the base at roll 0 (rad), `cos` and `sin` those of
    the roll (mm). `squares` is the sum of the squared weights of the readings (mm2).
    """

    left: float = 0.0
    up: float = 0.0
    cos: float = 0.0
    sin: float = 0.0
    squares: float = 0.0
    read_mm: float = 0.0


@dataclass(frozen=True)
class _Reading:
    place_mm: float
    left: float
    up: float
    roll_rad: float


class FibreWindows:
    """Readings of all sensors by window, and their measurement equations.

    Parameters
    ----------
    sensors
        Places and gauge of the sensors.
    settings
        Standard deviations of a curvature and of the constant error of a sensor.
    """

    def __init__(self, sensors: FibreSensors, settings: TipSettings) -> None:
        self._settings = settings
        self._behind = sensors.from_tip_mm
        self.gauge_mm: float = sensors.gauge_mm
        self._kept = min(max(math.ceil(_COVERED_MM / sensors.gauge_mm), 2), _MOST)
        self._biases = SIZE + _ANGLES
        self._means = self._biases + 2 * len(sensors.from_tip_mm)
        self._last: list[_Reading | None] = [None] * len(sensors.from_tip_mm)
        self._passages: dict[tuple[int, int], _Passage] = {}
        self._too_large = 0
        # Columns from which those at the end of a window come, and their factors, shape (1, columns).
        rows = [*range(self._means), *range(self.size)[_INTEGRALS], *range(self._means, self.size - _ANGLES)]
        scale = np.ones((1, self.size))
        scale[:, _INTEGRALS], scale[:, self._means : self._means + _ANGLES] = 0.0, 1 / self.gauge_mm
        self._shift = np.array(rows), scale

    @property
    def size(self) -> int:
        """Number of columns of the state."""
        return self._means + _ANGLES * self._kept

    def newest(self, at_mm: float) -> int:
        """Return the number of the newest window that ends at or before a path length; -1 if there is none."""
        return math.floor(at_mm / self.gauge_mm + 1e-9) - 1

    def require(self, sample: FibreSample) -> None:
        """Raise DataError if a sample has another number of sensors, or curvatures too large for 1/mm persist."""
        if len(sample.curvatures_per_mm) != len(self._behind):
            rule = f"must be {len(self._behind)}, the sensors in from_tip_mm"
            raise DataError(Mistake("sensors of a sample", f"{len(sample.curvatures_per_mm)}", rule))
        if sample.health is not Health.GOOD:
            return
        sizes = (abs(each) for pair in sample.curvatures_per_mm for each in pair)
        largest = max(filter(math.isfinite, sizes), default=0.0)
        self._too_large = self._too_large + 1 if largest > _LARGEST_PER_MM else 0
        if self._too_large >= _MANY_SAMPLES:
            rule = f"is questionably large, in {_MANY_SAMPLES} samples in a row; in 1/m? Convert it"
            raise DataError(Mistake("curvatures_per_mm", f"{largest:.3g} 1/mm", rule))

    def start(self, state: Array, covariance: Array) -> tuple[Array, Array]:
        """Return state and covariance before the surface, with the columns of windows and sensors."""
        rows = [*range(SIZE), *[0] * (self._means - SIZE), *INTEGRATED * self._kept]
        state, covariance = state[rows], covariance[np.ix_(rows, rows)]
        new = np.arange(SIZE, self._means)
        state[new], covariance[new, :], covariance[:, new] = 0.0, 0.0, 0.0
        biases = new[_ANGLES:]
        covariance[biases, biases] = self._settings.fibre_bias_sd_per_mm**2
        return state, covariance

    def ended(self, state: Array, covariance: Array) -> tuple[Array, Array]:
        """Return state and covariance at the end of a window.

        The mean angles of the window are stored as the newest ones, and its running integrals become 0.
        """
        rows, scale = self._shift
        return scale[0] * state[rows], covariance.take(rows, axis=0).take(rows, axis=1) * (scale * scale.T)

    def forget_beyond(self, length_mm: float) -> None:
        """Discard readings beyond a path length, at which the tip has left its channel for a new one."""
        last = length_mm / self.gauge_mm - 1
        self._passages = {key: passage for key, passage in self._passages.items() if key[1] <= last}
        self._last = [None] * len(self._last)

    def read(self, sample: FibreSample, tip_mm: float, roll_rad: float) -> list[tuple[int, int]]:
        """Take a sample at a path length and a roll of the base; return the keys (sensor, window) that it completes."""
        complete: list[tuple[int, int]] = []
        if sample.health is not Health.GOOD:
            return complete
        cos, sin = math.cos(roll_rad), math.sin(roll_rad)
        for sensor, (behind, (y, z)) in enumerate(zip(self._behind, sample.curvatures_per_mm, strict=True)):
            place, last = tip_mm - behind, self._last[sensor]
            if not math.isfinite(y + z) or (last is not None and place <= last.place_mm):
                continue
            now = _Reading(place, cos * y - sin * z, sin * y + cos * z, roll_rad)
            self._last[sensor] = now
            if last is not None and now.place_mm - last.place_mm <= _GAP_MM:
                complete += self._between(sensor, last, now)
        return complete

    def _between(self, sensor: int, last: _Reading, now: _Reading) -> list[tuple[int, int]]:
        complete, at = [], last.place_mm
        roll = (last.roll_rad + now.roll_rad) / 2
        while at < now.place_mm:
            # The passage to window n begins at the middle of window n - 1.
            number = math.floor(at / self.gauge_mm + 0.5 + 1e-9)
            end = min(now.place_mm, (number + 0.5) * self.gauge_mm)
            if number >= 1:
                passage, length = self._passages.setdefault((sensor, number), _Passage()), end - at
                passage.left += length * (last.left + now.left) / 2
                passage.up += length * (last.up + now.up) / 2
                passage.cos, passage.sin = passage.cos + length * math.cos(roll), passage.sin + length * math.sin(roll)
                passage.squares += length**2
                passage.read_mm += length
                if self._is_complete(passage):
                    complete.append((sensor, number))
            at = end
        return complete

    def _is_complete(self, passage: _Passage) -> bool:
        return math.isclose(passage.read_mm, self.gauge_mm, rel_tol=1e-6)

    def complete(self, number: int) -> list[tuple[int, int]]:
        """Return the keys (sensor, window) of the sensors with readings on the whole passage to a window."""
        return [key for key, passage in self._passages.items() if key[1] == number and self._is_complete(passage)]

    def corrected(
        self, key: tuple[int, int], newest: int, state: Array, covariance: Array, gate: float
    ) -> tuple[Array, Array]:
        """Return state and covariance, corrected by the readings of one sensor, equations (1) and (2).

        `key` holds the numbers of a sensor and of a window. The measurement is the integral of the readings from the
        middle of the window before to the middle of this window. Nothing changes if one of these windows is not in the
        state, or if the normalised squared innovation is above `gate`. `newest` is the number of the newest window
        in the state.
        """
        sensor, number = key
        after = newest - number
        if not 0 <= after < self._kept - 1:
            return state, covariance
        passage, bias = self._passages[key], self._biases + 2 * sensor
        late = self._means + _ANGLES * after
        early = late + _ANGLES
        roll = float(state[late + 2] + state[early + 2]) / 2
        cos_r, sin_r = math.cos(roll), math.sin(roll)
        cos, sin = cos_r * passage.cos - sin_r * passage.sin, sin_r * passage.cos + cos_r * passage.sin
        y, z = state[bias], state[bias + 1]
        measured = np.array([
            cos_r * passage.left - sin_r * passage.up - (cos * y - sin * z),
            sin_r * passage.left + cos_r * passage.up - (sin * y + cos * z),
        ])  # fmt: skip
        level = math.cos((state[late + 1] + state[early + 1]) / 2)
        innovation = measured - (level * (state[late] - state[early]), state[late + 1] - state[early + 1])
        columns = (late, early, late + 1, early + 1, late + 2, early + 2, bias, bias + 1)
        by_roll = (measured[1] / 2, -measured[0] / 2)
        model = (
            (level, 0.0), (-level, 0.0), (0.0, 1.0), (0.0, -1.0), by_roll, by_roll, (cos, sin), (-sin, cos),
        )  # fmt: skip
        return _ppvi.path_corrected(
            state, covariance, columns, model, innovation, gate=gate,
            variance=self._settings.fibre_sd_per_mm**2 * passage.squares,
        )[1]  # fmt: skip
