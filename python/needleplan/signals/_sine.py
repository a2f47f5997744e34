"""Frequency, amplitude and phase of the sine in a periodic signal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.signals._record import Array

__all__ = ["Sine", "dominant_frequency_hz", "lag_rad", "sine_at"]


@dataclass(frozen=True)
class Sine:
    """The signal offset + amplitude cos(2 pi frequency t + phase)."""

    frequency_hz: float
    amplitude: float
    phase_rad: float
    offset: float


def sine_at(frequency_hz: float, time_s: Array, values: Array) -> Sine:
    """Fit a sine of known frequency and an offset to a signal, by linear least squares.

    Parameters
    ----------
    frequency_hz : float
        Frequency (Hz).
    time_s : numpy.ndarray
        Times (s), shape (samples,).
    values : numpy.ndarray
        Signal, shape (samples,), in any unit.

    Returns
    -------
    Sine
        Amplitude and offset in the unit of the signal, and phase (rad).
    """
    angle = 2 * np.pi * frequency_hz * np.asarray(time_s, float)
    columns = np.column_stack([np.cos(angle), np.sin(angle), np.ones_like(angle)])
    (a, b, offset), *_ = np.linalg.lstsq(columns, np.asarray(values, float), rcond=None)
    return Sine(frequency_hz, float(np.hypot(a, b)), float(np.arctan2(-b, a)), float(offset))


def dominant_frequency_hz(time_s: Array, values: Array) -> float:
    """Return the frequency of the sine that explains most of the variance of a signal.

    Least squares refine the frequency of the largest spectral line, between its two neighbours.

    Parameters
    ----------
    time_s : numpy.ndarray
        Times (s), shape (samples,), at nearly even intervals.
    values : numpy.ndarray
        Signal, shape (samples,), in any unit.

    Returns
    -------
    float
        Frequency (Hz).

    Raises
    ------
    DataError
        There are fewer than eight samples, or the signal is constant.
    """
    from scipy.optimize import minimize_scalar

    time, values = np.asarray(time_s, float), np.asarray(values, float)
    if time.size < 8 or np.ptp(values) == 0:
        raise DataError(
            Mistake("values", f"{time.size} samples", "must be at least eight samples that are not all equal")
        )
    duration = float(time[-1] - time[0]) * time.size / (time.size - 1)
    grid = np.linspace(time[0], time[-1], time.size)
    spectrum = np.abs(np.fft.rfft(np.interp(grid, time, values - values.mean())))
    line = int(np.argmax(spectrum[1:])) + 1

    def unexplained(frequency: float) -> float:
        sine = sine_at(frequency, time, values)
        model = sine.offset + sine.amplitude * np.cos(2 * np.pi * frequency * time + sine.phase_rad)
        return float(np.sum((values - model) ** 2))

    bounds = (max(line - 0.9, 0.3) / duration, (line + 0.9) / duration)
    return float(minimize_scalar(unexplained, bounds=bounds, method="bounded", options={"xatol": 1e-6 / duration}).x)


def lag_rad(frequency_hz: float, time_s: Array, values: Array, reference: Array) -> float:
    """Return the phase lag of the sine in one signal behind the sine in another.

    Parameters
    ----------
    frequency_hz : float
        Frequency of both sines (Hz).
    time_s : numpy.ndarray
        Times (s), shape (samples,).
    values : numpy.ndarray
        Signal, shape (samples,), in any unit.
    reference : numpy.ndarray
        Signal with the earlier sine, shape (samples,), in any unit.

    Returns
    -------
    float
        Lag in [-pi, pi) rad.
    """
    late = sine_at(frequency_hz, time_s, reference).phase_rad - sine_at(frequency_hz, time_s, values).phase_rad
    return float((late + np.pi) % (2 * np.pi) - np.pi)
