"""Velocity of a whole record without delay, for work after the experiment.

An observer or a causal filter delays, and a delay of the velocity is what tissue that gives way looks like: 0.1 s are
3.6 degrees at 0.1 Hz (mechanics of the bristles suffer more: sigma0 and sigma1 come out over twice too large).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals.array import Array
from needleplan.signals.harmonic import dominant_frequency_hz, sine_at
from needleplan.signals.tracker import TrackerFilter

__all__ = ["VelocityMethod", "VelocityRecord", "velocity_without_delay"]

_NOISY_MM = 0.02
"""Noise of the position from which on a tracker is assumed rather than an encoder."""

_WINDOW_S = 0.1
_UNEVEN = 0.02
_THIRD_DIFFERENCE_SD = 20**0.5
_MAD_TO_SD = 1.4826


class VelocityMethod(StrEnum):
    """How a velocity was made."""

    POLYNOMIAL = "polynomial"
    """Derivative of a cubic over 0.1 s about each sample (Savitzky and Golay): for encoders, at even times."""

    SMOOTHER = "smoother"
    """Kalman smoother with constant acceleration: for trackers, or uneven times."""


@dataclass(frozen=True)
class VelocityRecord:
    """Velocity at every sample, shape (samples,), and the noise of the position that it was made from."""

    velocity_mm_s: Array
    noise_mm: float
    method: VelocityMethod


def velocity_without_delay(time_s: Array, position_mm: Array) -> VelocityRecord:
    """Return the velocity of a position, shape (samples,) each, by the method that its noise asks for.

    The density of the smoother's driving noise is that of a jerk as large as the record's own sine has, for as long as
    a radian of it takes. Raises DataError for fewer than 15 samples, a record that does not move, or bad numbers.
    """
    from scipy.signal import savgol_filter

    time, position = np.asarray(time_s, float), np.asarray(position_mm, float)
    if time.ndim != 1 or time.shape != position.shape or time.size < 15:
        raise DataError(
            Mistake("depth_mm", f"shape {position.shape}", "must be as long as time_s, and hold at least 15 samples")
        )
    if not np.isfinite(position).all() or not np.isfinite(time).all() or not (np.diff(time) > 0).all():
        raise DataError(Mistake("depth_mm", "", "must be finite numbers at increasing times"))
    third = np.diff(position, 3)
    noise = _MAD_TO_SD * float(np.median(np.abs(third - np.median(third)))) / _THIRD_DIFFERENCE_SD
    steps = np.diff(time)
    interval = float(np.median(steps))
    even = bool(np.abs(steps - interval).max() <= _UNEVEN * interval)
    if noise < _NOISY_MM and even:
        window = min(max(2 * round(_WINDOW_S / interval / 2) + 1, 5), 2 * ((time.size - 1) // 2) + 1)
        velocity = savgol_filter(position, window, 3, deriv=1, delta=interval)
        return VelocityRecord(np.asarray(velocity), noise, VelocityMethod.POLYNOMIAL)
    frequency = dominant_frequency_hz(time, position)
    omega = 2 * np.pi * frequency
    jerk = sine_at(frequency, time, position).amplitude * omega**3
    smoothed = TrackerFilter(max(noise, 1e-4), max(jerk**2 / (2 * omega), 1e-9)).smooth(time, position)
    return VelocityRecord(smoothed.velocity_mm_s, noise, VelocityMethod.SMOOTHER)
