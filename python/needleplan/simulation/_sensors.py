"""Simulated measurements with the errors of the sensors: noise, offset, drift, distortion and dropouts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from needleplan.devices import FibreSample, ForceSample, Health, ImageSample, PoseSample, Stamp
from needleplan.models import TipFrame
from needleplan.models.effects import Bias, Drift, GainError
from needleplan.signals import Motion, MovingAverage
from needleplan.simulation._effects import Draws, Effects, Stream, random_for
from needleplan.simulation._setup import AVERAGED, TRACKER_HZ

__all__ = ["FibreReading", "ForceReading", "ImageReading", "TrackerReading", "from_z_to"]

_NAN = float("nan")


class ForceReading:
    """Measurements of the force sensor at 200 Hz, averaged over five samples. A positive z force resists insertion."""

    def __init__(self, effects: Effects, seed: int) -> None:
        self._effects = effects
        errors = (
            GainError(size=effects.force_gain_error), Bias(size=effects.force_offset_n),
            Drift(size=effects.force_drift_n_s),
        )  # fmt: skip
        self._errors = [error for error in errors if error.size]
        self._draws = Draws(random_for(seed, Stream.FORCE_NOISE), 3)
        self._averages = [MovingAverage(AVERAGED).stream() for _ in range(4)]
        self._zero = (0.0, 0.0, 0.0, 0.0)
        self._last = self._zero
        self.measured: bool = False
        """Whether a sample has been taken."""

    def sample(self, stamp: Stamp, force_n: float, torque_n_mm: float, time_s: float) -> ForceSample:
        """Return the sample that the sensor shows for the true axial force (N) and torque (N mm)."""
        effects = self._effects
        self.measured = True
        noise = [effects.force_noise_n * each for each in self._draws.next()]
        now, nothing = Motion(*np.array([time_s, 0.0, 0.0, 0.0, 0.0])), np.zeros(0)
        wrong = sum(float(error.size * error.shape(nothing, now, np.asarray(force_n))) for error in self._errors)
        raw = (noise[0], noise[1], force_n + wrong + noise[2], torque_n_mm)
        x, y, z, torque = self._last = tuple(
            average.push(each) for average, each in zip(self._averages, raw, strict=True)
        )  # type: ignore[assignment]
        zero = self._zero
        return ForceSample(stamp, (x - zero[0], y - zero[1], z - zero[2]), (0.0, 0.0, torque - zero[3]))

    def bias(self) -> None:
        """Set the zero to the last measured force and torque."""
        self._zero = self._last


class TrackerReading:
    """Measurements of the tracker at 40 Hz: a coil with five degrees of freedom, whose z axis is along the needle."""

    def __init__(self, effects: Effects, seed: int) -> None:
        self._effects = effects
        self._noise = Draws(random_for(seed, Stream.TRACKER_NOISE), 3)
        self._drift_draws = Draws(random_for(seed, Stream.TRACKER_WANDER), 3)
        self._angles = Draws(random_for(seed, Stream.TRACKER_ANGLE), 2)
        self._chance = random_for(seed, Stream.TRACKER_DROPOUT)
        self._phases = (2 * math.pi * random_for(seed, Stream.TRACKER_FIELD).random(3)).tolist()
        self._drift = self._drift_draws.next()
        self._keep = math.exp(-1 / (TRACKER_HZ * effects.tracker_wander_s))
        self._missing = 0

    def sample(self, stamp: Stamp, coil: TipFrame) -> PoseSample:
        """Return the sample that the tracker shows for the true frame of the coil; MISSING during a dropout."""
        effects, keep = self._effects, self._keep
        fresh = math.sqrt(1 - keep * keep)
        self._drift = [keep * old + fresh * new for old, new in zip(self._drift, self._drift_draws.next(), strict=True)]
        noise, (turn_n, turn_b) = self._noise.next(), self._angles.next()
        if self._lost():
            return PoseSample(stamp, (_NAN,) * 3, (_NAN,) * 4, _NAN, Health.MISSING, ("the coil is not seen",))
        field = self._distortion(coil.position_mm)
        x, y, z = (
            true + bent + effects.tracker_noise_mm * white + effects.tracker_wander_mm * slow
            for true, bent, white, slow in zip(coil.position_mm, field, noise, self._drift, strict=True)
        )
        sd = effects.tracker_angle_noise_rad
        t, n, b = coil.tangent, coil.normal, coil.binormal
        direction = [t[axis] + sd * (turn_n * n[axis] + turn_b * b[axis]) for axis in range(3)]
        error = math.hypot(effects.tracker_noise_mm, effects.tracker_wander_mm)
        return PoseSample(stamp, (x, y, z), from_z_to(*direction), error)

    def _lost(self) -> bool:
        # Two numbers are drawn for each frame, so that the duration of a dropout does not change later dropouts.
        begins, length = self._chance.random(2).tolist()
        if begins < self._effects.tracker_dropout:
            frames = -math.log(1 - length) * self._effects.tracker_dropout_s * TRACKER_HZ
            self._missing = max(self._missing, 1 + int(frames))
        self._missing -= self._missing > 0
        return self._missing > 0 or begins < self._effects.tracker_dropout

    def _distortion(self, position_mm: tuple[float, float, float]) -> list[float]:
        """Return the displacement (mm) by the field distortion at a position; it is smooth along all three axes."""
        size, wave = self._effects.tracker_distortion_mm, 2 * math.pi / self._effects.tracker_distortion_length_mm
        return [
            size * math.sin(wave * position_mm[(axis + 1) % 3] + wave * position_mm[axis] / 2 + self._phases[axis])
            for axis in range(3)
        ]


class FibreReading:
    """Measurements of curvature sensors along the needle at 100 Hz, with a constant error of each sensor."""

    def __init__(self, effects: Effects, sensors: int, seed: int) -> None:
        self._sd = effects.fibre_noise_per_mm
        self._noise = Draws(random_for(seed, Stream.FIBRE_NOISE), 2 * sensors)
        drawn = random_for(seed, Stream.FIBRE_BIAS).standard_normal(2 * sensors)
        self._bias = (effects.fibre_bias_per_mm * drawn).tolist()

    def sample(self, stamp: Stamp, curvatures: Sequence[tuple[float, float]]) -> FibreSample:
        """Return the sample that the sensors show for the true curvatures (1/mm) in the axes of the needle."""
        errors = [bias + self._sd * white for bias, white in zip(self._bias, self._noise.next(), strict=True)]
        shown = [(y + errors[2 * k], z + errors[2 * k + 1]) for k, (y, z) in enumerate(curvatures)]
        return FibreSample(stamp, tuple(shown))


class ImageReading:
    """Detections of the tip in ultrasound images at 20 Hz; a tip outside of the slice is not detected."""

    def __init__(self, effects: Effects, thickness_mm: float, seed: int) -> None:
        self._effects, self._half_mm = effects, thickness_mm / 2
        self._noise = Draws(random_for(seed, Stream.ULTRASOUND_NOISE), 4)
        self._chance = random_for(seed, Stream.ULTRASOUND_CHANCE)

    def sample(self, stamp: Stamp, place_mm: tuple[float, float, float]) -> ImageSample:
        """Return the sample for the coordinates of the tip in the image and its distance from the plane (mm)."""
        effects, (white_u, white_v, far_u, far_v) = self._effects, self._noise.next()
        missed, outlying = self._chance.random(2).tolist()
        u, v, off = place_mm
        if abs(off) > self._half_mm or missed < effects.ultrasound_missed:
            return ImageSample(stamp, _NAN, _NAN, Health.MISSING, ("the tip is not detected",))
        if outlying < effects.ultrasound_outliers:
            return ImageSample(
                stamp, u + effects.ultrasound_outlier_mm * far_u, v + effects.ultrasound_outlier_mm * far_v
            )
        return ImageSample(stamp, u + effects.ultrasound_noise_mm * white_u, v + effects.ultrasound_noise_mm * white_v)


def from_z_to(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the shortest rotation, as a quaternion (w, x, y, z), from the z axis to a vector of any length above 0."""
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    if z < -1 + 1e-12:
        return (0.0, 1.0, 0.0, 0.0)
    w = math.sqrt((1 + z) / 2)
    return (w, -y / (2 * w), x / (2 * w), 0.0)
