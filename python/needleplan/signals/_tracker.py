"""Velocity from an electromagnetic tracker by a Kalman filter (thesis, appendix A and section 4.3).

The thesis mentions a Kalman filter but not its model or noise; both are arguments here. The position is the output of a
chain of integrators. White noise enters as the acceleration (model of constant velocity) or as the jerk (model of
constant acceleration).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from needleplan.artifacts import ShortRepr
from needleplan.errors import DataError, Mistake, ModelError
from needleplan.signals._record import Array

__all__ = ["TrackerEstimate", "TrackerFilter", "TrackerModel", "TrackerStream"]

# Standard deviations of the unknown initial velocity (mm/s) and acceleration (mm/s^2).
_UNKNOWN_VELOCITY_MM_S = 100.0
_UNKNOWN_ACCELERATION_MM_S2 = 1000.0


class TrackerModel(StrEnum):
    """Motion model of the Kalman filter."""

    CONSTANT_VELOCITY = "constant_velocity"
    CONSTANT_ACCELERATION = "constant_acceleration"

    @property
    def integrators(self) -> int:
        """Number of integrators between the white noise and the position."""
        return 2 if self is TrackerModel.CONSTANT_VELOCITY else 3


@dataclass(frozen=True)
class TrackerEstimate(ShortRepr):
    """Estimates at every sample, shape (samples,) each; NaN before the first measured position.

    `missed` is the number of samples without a measurement.
    """

    position_mm: Array
    velocity_mm_s: Array
    velocity_sd_mm_s: Array
    missed: int


@dataclass(frozen=True)
class TrackerFilter:
    """A Kalman filter for one coordinate.

    `position_sd_mm` is the standard deviation of the tracker's noise. `density` is the spectral density of the process
    noise, mm^2/s^3 for constant velocity and mm^2/s^5 for constant acceleration. The constructor raises ModelError
    unless both are positive.
    """

    position_sd_mm: float
    density: float
    model: TrackerModel = TrackerModel.CONSTANT_ACCELERATION

    def __post_init__(self) -> None:
        mistakes = [
            Mistake(name, f"{getattr(self, name):g}", "must be a number greater than 0")
            for name in ("position_sd_mm", "density")
            if not 0 < getattr(self, name) < np.inf
        ]
        if mistakes:
            raise ModelError(mistakes, "tracker filter")

    def apply(self, time_s: Array, position_mm: Array) -> TrackerEstimate:
        """Filter a record causally.

        The estimates equal those of `stream` bit by bit.

        Parameters
        ----------
        time_s : numpy.ndarray
            Increasing times (s), shape (samples,).
        position_mm : numpy.ndarray
            Positions (mm), shape (samples,). NaN marks a sample without a measurement.

        Returns
        -------
        TrackerEstimate
            Position (mm), velocity (mm/s) and its standard deviation at each sample; NaN before the first measurement.

        Raises
        ------
        DataError
            The shapes differ, the times do not increase, or no position is finite.
        """
        time, position = self._checked(time_s, position_mm)
        stream = self.stream()
        rows = [stream.push(*each) for each in zip(time.tolist(), position.tolist(), strict=True)]
        estimates = np.array(rows).T
        return TrackerEstimate(estimates[0], estimates[1], estimates[2], int(np.isnan(position).sum()))

    def smooth(self, time_s: Array, position_mm: Array) -> TrackerEstimate:
        """Estimate every sample from the whole record, without delay (smoother of Rauch, Tung and Striebel).

        Parameters
        ----------
        time_s : numpy.ndarray
            Increasing times (s), shape (samples,).
        position_mm : numpy.ndarray
            Positions (mm), shape (samples,). NaN marks a sample without a measurement.

        Returns
        -------
        TrackerEstimate
            Position (mm), velocity (mm/s) and its standard deviation at each sample; NaN before the first measurement.

        Raises
        ------
        DataError
            The shapes differ, the times do not increase, or no position is finite.
        """
        time, position = self._checked(time_s, position_mm)
        unseen = int(np.flatnonzero(np.isfinite(position))[0])
        stream = self.stream()
        states, covariances = [], []
        for each in zip(time[unseen:].tolist(), position[unseen:].tolist(), strict=True):
            stream.push(*each)
            states.append(stream.state)
            covariances.append(stream.covariance)
        steps = [self.step(interval) for interval in np.diff(time[unseen:], prepend=time[unseen]).tolist()]
        x, p, _, _ = stream.kalman.rts_smoother(
            np.array(states)[..., None],
            np.array(covariances),
            Fs=np.array([each[0] for each in steps]),
            Qs=np.array([each[1] for each in steps]),
        )
        rows = np.full((3, time.size), np.nan)
        rows[:, unseen:] = x[:, 0, 0], x[:, 1, 0], np.sqrt(p[:, 1, 1])
        return TrackerEstimate(rows[0], rows[1], rows[2], int(np.isnan(position).sum()))

    def stream(self) -> TrackerStream:
        """Return a running filter that processes one position at a time."""
        return TrackerStream(self)

    def step(self, interval_s: float) -> tuple[Array, Array]:
        """Return the transition matrix and the covariance of the process noise over an interval, shape (n, n) each.

        n = `model.integrators` is the number of integrators.
        """
        from filterpy.common import Q_continuous_white_noise

        n = self.model.integrators
        transition = np.eye(n)
        transition[0, 1] = interval_s
        if self.model is TrackerModel.CONSTANT_ACCELERATION:
            transition[1, 2], transition[0, 2] = interval_s, interval_s**2 / 2
        return transition, np.asarray(Q_continuous_white_noise(n, interval_s, self.density), float)

    def _checked(self, time_s: Array, position_mm: Array) -> tuple[Array, Array]:
        time, position = np.asarray(time_s, float), np.asarray(position_mm, float)
        if time.ndim != 1 or time.shape != position.shape:
            raise DataError(
                Mistake("position_mm", f"shape {position.shape}", f"must be as long as time_s {time.shape}")
            )
        if not np.isfinite(position).any():
            raise DataError(Mistake("position_mm", "", "contains only NaN: the tracker measured nothing"))
        if not np.isfinite(time).all() or not (np.diff(time) > 0).all():
            raise DataError(Mistake("time_s", "", "must increase from sample to sample"))
        return time, position


class TrackerStream:
    """A running Kalman filter; `push` returns NaN until the first measured position."""

    def __init__(self, what: TrackerFilter) -> None:
        from filterpy.kalman import KalmanFilter

        n = what.model.integrators
        self._what = what
        self._time: float | None = None
        self._started = False
        self._step: tuple[float, tuple[Array, Array]] | None = None
        self.kalman: Any = KalmanFilter(dim_x=n, dim_z=1)
        self.kalman.H = np.eye(1, n)
        self.kalman.R = np.array([[what.position_sd_mm**2]])
        sd = np.array([what.position_sd_mm, _UNKNOWN_VELOCITY_MM_S, _UNKNOWN_ACCELERATION_MM_S2])[:n]
        self.kalman.P = np.diag(sd**2)

    @property
    def state(self) -> Array:
        """Position, velocity and, for constant acceleration, acceleration; shape (n,)."""
        return np.array(self.kalman.x, float).ravel()

    @property
    def covariance(self) -> Array:
        """Covariance of the state, shape (n, n)."""
        return np.array(self.kalman.P, float)

    def push(self, time_s: float, position_mm: float) -> tuple[float, float, float]:
        """Process one position and return the estimates at its time.

        Parameters
        ----------
        time_s : float
            Time (s), greater than that of the previous call.
        position_mm : float
            Position (mm); NaN if it was not measured.

        Returns
        -------
        tuple of float
            Position (mm), velocity (mm/s) and standard deviation of the velocity (mm/s). NaN until a position is
            measured.

        Raises
        ------
        DataError
            The time does not increase.
        """
        last, self._time = self._time, time_s
        if last is not None and not time_s > last:
            raise DataError(Mistake("time_s", f"{time_s:g}", "must be greater than the time before it"))
        seen = position_mm == position_mm
        if not self._started:
            if not seen:
                return (np.nan, np.nan, np.nan)
            self._started = True
            self.kalman.x[0, 0] = position_mm
        else:
            assert last is not None
            transition, noise = self._over(time_s - last)
            self.kalman.predict(F=transition, Q=noise)
            if seen:
                self.kalman.update(position_mm)
        position, velocity = self.state[:2].tolist()
        return position, velocity, float(np.sqrt(self.kalman.P[1, 1]))

    def _over(self, interval_s: float) -> tuple[Array, Array]:
        if self._step is None or self._step[0] != interval_s:
            self._step = (interval_s, self._what.step(interval_s))
        return self._step[1]
