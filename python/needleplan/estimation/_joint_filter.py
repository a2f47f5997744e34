"""The joint extended Kalman filter: state and free parameters of a model, sample by sample."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from needleplan.artifacts import CallRepr
from needleplan.errors import DataError, Mistake
from needleplan.estimation._joint_system import JointSystem
from needleplan.models import Channel, Model
from needleplan.signals import Array, Motion

__all__ = ["FilterSample", "FilterStep", "JointFilter", "SampleUse", "ScalarKalmanFilter"]


@dataclass(frozen=True, slots=True)
class FilterSample:
    """One measurement: time (s), depth (mm), value (unit of the channel), velocity (mm/s), roll angle (rad).

    A missing `value` is NaN. If the velocity is None, it is computed from the difference to the previous sample; it is
    0 for the first sample.
    """

    time_s: float
    depth_mm: float
    value: float
    velocity_mm_s: float | None = None
    angle_rad: float = 0.0


class SampleUse(StrEnum):
    """How the filter used a sample."""

    USED = "used"
    MASKED = "masked"
    """Not used: shortly after a reversal, at rest after a motion, or masked by the caller.

    After a reversal, the average of the sensor mixes both directions.
    """

    MISSING = "missing"
    """Not used: the value is not finite."""

    DIVERGED = "diverged"
    """Not used: the estimate is not finite, since this sample or an earlier one."""


@dataclass(frozen=True, slots=True)
class FilterStep(CallRepr):
    """Result of one sample.

    `predicted` is the output before the correction, `innovation` is the value minus `predicted` (NaN without a value),
    and `sd` is the predicted standard deviation of the innovation, all in the unit of the channel. `x` is the estimate
    after the correction and `x_sd` its standard deviations, both of shape (n,), in the coordinates of the joint system.
    """

    use: SampleUse
    predicted: float
    innovation: float
    sd: float
    x: Array
    x_sd: Array


class ScalarKalmanFilter(ExtendedKalmanFilter):  # type: ignore[misc]
    """Extended Kalman filter with a scalar measurement; the caller evaluates the nonlinear functions.

    filterpy predicts linearly, F x; this class replaces the prediction by a given state. The update of filterpy is in
    Joseph form, which keeps P symmetric and positive.
    """

    x: Array
    P: Array
    Q: Array
    R: Array
    F: Array

    def __init__(self, x: Array, covariance: Array, walk: Array, variance: float) -> None:
        """Start at `x`, shape (n,), with `covariance` and `walk` (Q), shape (n, n); `variance` is R."""
        super().__init__(dim_x=x.size, dim_z=1)
        self.x, self.P, self.Q = x.copy(), covariance.copy(), walk
        self.R = np.array([[variance]])

    def predict_x(self, u: Any = 0) -> None:
        """Set x to `u`, the predicted state. filterpy calls this within `predict`."""
        self.x = u

    def advance(self, x: Array, change: Array) -> None:
        """Predict: replace the state by a state that the caller has computed.

        Parameters
        ----------
        x : numpy.ndarray
            Predicted state, shape (n,).
        change : numpy.ndarray
            Jacobian of the prediction, shape (n, n).
        """
        self.F = change
        self.predict(x)

    def correct(self, measured: float, expected: float, change: Array) -> None:
        """Correct the state with a measured number.

        Parameters
        ----------
        measured : float
            Measurement.
        expected : float
            Measurement that the state predicts, in the same unit.
        change : numpy.ndarray
            Gradient of `expected` with respect to the state, shape (n,).
        """
        self.update(np.array([measured]), lambda _: change[np.newaxis], lambda _: np.array([expected]))

    @property
    def lost(self) -> bool:
        """Whether x or P is not finite."""
        return not (np.isfinite(self.x).all() and np.isfinite(self.P).all())


class JointFilter:
    """Extended Kalman filter of the state and the free parameters of a model. It takes one sample at a time.

    `counts` holds the number of samples for each `SampleUse`.

    Parameters
    ----------
    joint
        Joint system of the model.
    model
        Model with the initial values of the parameters.
    variance
        Measurement variance R, in the squared unit of the channel.
    sd
        Initial standard deviation of the coordinates: one number, or one for each free parameter.
    walk
        Variance that each coordinate gains per sample.
    state_sd
        Standard deviation of the initial state.
    settle
        Number of samples after a reversal that are masked, because the average of the sensor contains samples from
        before the reversal. If it is above 0, samples at rest after a motion are masked too.
    reach
        Largest distance of a coordinate from its value at the first sample of the first pass.
    limit
        Largest change of a coordinate in one sample: R is raised for a sample that would exceed this change. Without
        `reach` and `limit`, a coordinate may reach values at which the output does not depend on the coordinate, and
        stay there.

    Raises
    ------
    DataError
        A variance or a standard deviation is negative or NaN, or `variance` is 0.
    """

    def __init__(
        self,
        joint: JointSystem,
        model: Model,
        *,
        variance: float,
        sd: float | Sequence[float],
        walk: float = 1e-8,
        state_sd: float = 0.0,
        settle: int = 0,
        reach: float = math.inf,
        limit: float = math.inf,
    ) -> None:

        for name, value in (("variance", variance), ("sd", np.min(sd)), ("walk", walk), ("state_sd", state_sd)):
            if not value >= 0 or (name == "variance" and value == 0):
                raise DataError(Mistake(name, f"{value}", "must be positive" if name == "variance" else "must be >= 0"))
        self._joint = joint
        self._settle = settle
        self._reach, self._limit = reach, limit
        self._anchor: Array | None = None
        self._walk = walk
        self._variance = variance
        self._state_sd = state_sd
        self._sd = np.broadcast_to(np.asarray(sd, float), (len(joint.free),))
        self._start: Model | None = model
        self._kalman: ScalarKalmanFilter | None = None
        self._last: Motion | None = None
        self._to_settle = 0
        self._kept: Array | None = None
        self.counts: dict[SampleUse, int] = dict.fromkeys(SampleUse, 0)

    @property
    def channel(self) -> Channel:
        """Channel that the model predicts: the column of a record with the measured values."""
        return self._joint.start.channel

    @property
    def diverged(self) -> bool:
        """Whether the estimate or its covariance is no longer finite."""
        return self.counts[SampleUse.DIVERGED] > 0

    @property
    def x(self) -> Array:
        """The joint vector (state, coordinates), shape (n,). Raises DataError before the first sample."""
        return self._filter().x

    @property
    def covariance(self) -> Array:
        """Covariance of the joint vector, shape (n, n). Raises DataError before the first sample."""
        return self._filter().P

    @property
    def model(self) -> Model:
        """The model with the current estimates of its parameters. Raises DataError before the first sample."""
        return self._joint.model(self.x)

    def update(self, sample: FilterSample, *, masked: bool = False) -> FilterStep:
        """Process a sample: predict to its time, and correct with its value.

        After a divergence nothing is predicted.

        Parameters
        ----------
        sample : FilterSample
            Time, motion and measured value. A missing value does not correct the estimate.
        masked : bool, default False
            Whether to predict only, and to ignore the value.

        Returns
        -------
        FilterStep

        Raises
        ------
        DataError
            The time does not increase, or time, depth or velocity is not finite. The filter is then unchanged.
        """
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return self._take(sample, masked)

    def _take(self, sample: FilterSample, masked: bool) -> FilterStep:
        now = self._instant(sample)
        turned = self._last is not None and now.direction * self._last.direction < 0
        if self._kalman is None:
            self._kalman = self._begin(now)
        elif not self.diverged:
            assert self._last is not None
            self._kalman.advance(*self._joint.predict(self._kalman.x, self._last, now))
        self._to_settle = self._settle if turned else max(self._to_settle - 1, 0)
        at_rest = self._settle > 0 and now.velocity_mm_s == 0 and now.direction != 0
        self._last = now
        return self._correct(sample.value, now, masked or self._to_settle > 0 or at_rest)

    def restart(self, *, variance: float, sd: float | Sequence[float]) -> None:
        """Begin a new pass from the estimated parameters.

        Parameters
        ----------
        variance : float
            Measurement variance R, in the squared unit of the channel.
        sd : float or sequence of float
            Initial standard deviation of the coordinates: one number, or one for each free parameter.

        Raises
        ------
        DataError
            The filter has not had a sample yet.
        """
        self._start = self.model
        self._variance = variance
        self._sd = np.broadcast_to(np.asarray(sd, float), self._sd.shape)
        self._forget()

    def next_record(self) -> None:
        """Begin a new record: parameters and their covariance continue, the state returns to its initial value.

        Raises DataError before the first sample.
        """
        n = self._joint.states
        self._start, covariance = self.model, self.covariance[n:, n:]
        self._forget()
        self._kept = covariance

    def _forget(self) -> None:
        self._kalman, self._last, self._to_settle, self._kept = None, None, 0, None

    def _filter(self) -> ScalarKalmanFilter:
        if self._kalman is None:
            raise DataError("the filter has not had a sample yet")
        return self._kalman

    def _begin(self, now: Motion) -> ScalarKalmanFilter:
        assert self._start is not None
        x = self._joint.initial(self._start, now)
        n = self._joint.states
        if self._anchor is None:
            self._anchor = x[n:]
        covariance = np.zeros((x.size, x.size))
        covariance[:n, :n] = np.eye(n) * self._state_sd**2
        covariance[n:, n:] = np.diag(self._sd**2) if self._kept is None else self._kept
        walk = np.diag([0.0] * n + [self._walk] * (x.size - n))
        return ScalarKalmanFilter(x, covariance, walk, self._variance)

    def _correct(self, value: float, now: Motion, masked: bool) -> FilterStep:
        kalman = self._filter()
        expected, change = self._joint.measure(kalman.x, now)
        spread = float(change @ kalman.P @ change) + self._variance
        use = (
            SampleUse.DIVERGED if kalman.lost or not math.isfinite(expected) or not math.isfinite(spread)
            else SampleUse.MISSING if not math.isfinite(value)
            else SampleUse.MASKED if masked
            else SampleUse.USED
        )  # fmt: skip
        if use is SampleUse.USED:
            self._update(kalman, value, expected, change)
        self.counts[use] += 1
        sd = np.sqrt(np.maximum(np.diagonal(kalman.P), 0.0))
        return FilterStep(use, expected, value - expected, math.sqrt(max(spread, 0.0)), kalman.x, sd)

    def _update(self, kalman: ScalarKalmanFilter, value: float, expected: float, change: Array) -> None:
        n = self._joint.states
        variance = self._variance
        if self._limit < math.inf:
            cross = kalman.P @ change
            moved = float(np.abs(cross[n:] * (value - expected)).max())
            variance = max(variance, moved / self._limit - float(change @ cross))
        kalman.R[0, 0] = variance
        kalman.correct(value, expected, change)
        if self._reach < math.inf and self._anchor is not None:
            kalman.x[n:] = np.clip(kalman.x[n:], self._anchor - self._reach, self._anchor + self._reach)

    def _instant(self, sample: FilterSample) -> Motion:
        last = self._last
        if last is not None and not sample.time_s > float(last.time_s):
            rule = f"must be greater than the time of the previous sample, {float(last.time_s):g}"
            raise DataError(Mistake("time_s", f"{sample.time_s:g}", rule))
        velocity = sample.velocity_mm_s
        if velocity is None:
            velocity = 0.0
            if last is not None:
                velocity = (sample.depth_mm - float(last.depth_mm)) / (sample.time_s - float(last.time_s))
        for name, number in (("time_s", sample.time_s), ("depth_mm", sample.depth_mm), ("velocity_mm_s", velocity)):
            if not math.isfinite(number):
                raise DataError(Mistake(name, str(number), "must be a finite number"))
        before = 0.0 if last is None else float(last.direction)
        direction = math.copysign(1.0, velocity) if velocity != 0 else before
        # One instant: numbers instead of arrays, which `Motion` accepts.
        return Motion(sample.time_s, sample.depth_mm, velocity, direction, sample.angle_rad)  # type: ignore[arg-type]
