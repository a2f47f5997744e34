"""The joint extended Kalman filter, sample by sample."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from needleplan.errors import DataError, Mistake
from needleplan.estimation._joint_system import JointSystem
from needleplan.models import Channel, Model
from needleplan.signals import Array, Motion

__all__ = ["FilterSample", "FilterStep", "JointFilter", "SampleUse", "ScalarKalmanFilter"]


class JointFilter:
    """Estimates a model's state and free parameters from samples that come one at a time.

    `variance` is R, in the square of the channel's unit. The standard deviation of every coordinate at the start is
    `sd` (a number, or one for each free parameter), and `walk` is the variance that each gains in a sample. The state
    starts at its initial value, of which `state_sd` is the uncertainty.

    After a change of direction `settle` samples are not used, as the sensor's average still holds samples from before,
    and neither are samples at rest after a movement; with `settle` 0 all are used. A value that is no number moves the
    filter on without correcting it. Both are counted (`counts`).

    Two safeguards for starts that are far off: no coordinate moves by more than `limit` in one sample (R is raised for
    a sample that would), and none leaves its first start by more than `reach`. Without them a coordinate may run off
    to where the output no longer depends on it, and never comes back.
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
        """Start with the parameters of `model`. Raises DataError for numbers that are no variances."""
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
        self.counts = dict.fromkeys(SampleUse, 0)

    @property
    def channel(self) -> Channel:
        """What the model predicts: the column of a record that it is fed with."""
        return self._joint.start.channel

    @property
    def diverged(self) -> bool:
        """Whether the estimate is lost."""
        return self.counts[SampleUse.DIVERGED] > 0

    @property
    def x(self) -> Array:
        """The joint vector. Raises DataError before the first sample."""
        return self._filter().x

    @property
    def covariance(self) -> Array:
        """Covariance of the joint vector, shape (n, n)."""
        return self._filter().P

    @property
    def model(self) -> Model:
        """The model as it is estimated now."""
        return self._joint.model(self.x)

    def update(self, sample: FilterSample, *, masked: bool = False) -> FilterStep:
        """Take one sample; `masked` ones move the filter on and correct nothing.

        Raises DataError, and leaves the filter as it was, where the time does not increase or time, depth or velocity
        is not a finite number.
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
        """Begin a new record with the parameters as they are estimated, and new uncertainties."""
        self._start = self.model
        self._variance = variance
        self._sd = np.broadcast_to(np.asarray(sd, float), self._sd.shape)
        self._forget()

    def next_record(self) -> None:
        """Begin a new record with the parameters and their covariance as they are; only the state starts again."""
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
            rule = f"must be greater than that of the sample before, {float(last.time_s):g}"
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
        # One instant: numbers in the place of arrays, which `Motion` allows.
        return Motion(sample.time_s, sample.depth_mm, velocity, direction, sample.angle_rad)  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class FilterSample:
    """One measurement; `value` is in the unit of the model's channel, NaN where there is none at this time.

    Without a velocity it is the difference of the depths over that of the times.
    """

    time_s: float
    depth_mm: float
    value: float
    velocity_mm_s: float | None = None
    angle_rad: float = 0.0


class SampleUse(StrEnum):
    """What a filter did with a measurement."""

    USED = "used"
    MASKED = "masked"
    """At a reversal, where the sensor's average mixes both directions; or masked by the caller."""

    MISSING = "missing"
    """It is not a number."""

    DIVERGED = "diverged"
    """The filter has lost its estimate and does nothing any more."""


@dataclass(frozen=True, slots=True)
class FilterStep:
    """What a filter says after one sample.

    `predicted` is what it expected before it saw the value, `innovation` the value less that (NaN where there is none),
    `sd` the standard deviation that it gave the innovation. `x` is the estimate and `x_sd` its standard deviations,
    shape (n,), in the coordinates of the joint system.
    """

    use: SampleUse
    predicted: float
    innovation: float
    sd: float
    x: Array
    x_sd: Array


class ScalarKalmanFilter(ExtendedKalmanFilter):  # type: ignore[misc]
    """An extended Kalman filter with one measured number, told what its state becomes and the derivative of that.

    filterpy's own prediction of x is linear, F x; its update has the form of Joseph, which keeps P symmetric and
    positive.
    """

    def __init__(self, x: Array, covariance: Array, walk: Array, variance: float) -> None:
        """Start at `x`, shape (n,), with `covariance` and `walk` (Q), shape (n, n); `variance` is R."""
        super().__init__(dim_x=x.size, dim_z=1)
        self.x, self.P, self.Q = x.copy(), covariance.copy(), walk
        self.R = np.array([[variance]])

    def predict_x(self, u: Any = 0) -> None:
        """Take the prediction as it is given."""
        self.x = u

    def advance(self, x: Array, change: Array) -> None:
        """Predict: the state becomes `x`, whose derivative by the state before is `change`, shape (n, n)."""
        self.F = change
        self.predict(x)

    def correct(self, measured: float, expected: float, change: Array) -> None:
        """Update with a measured number; `change` is the derivative of the expected one, shape (n,)."""
        self.update(np.array([measured]), lambda _: change[np.newaxis], lambda _: np.array([expected]))

    @property
    def lost(self) -> bool:
        """Whether the estimate is no longer a number."""
        return not (np.isfinite(self.x).all() and np.isfinite(self.P).all())
