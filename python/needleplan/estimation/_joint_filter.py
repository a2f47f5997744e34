"""The joint extended Kalman filter, sample by sample."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.estimation.extended import Extended
from needleplan.estimation.joint import Joint
from needleplan.estimation.sample import Sample, Step, Use
from needleplan.models import Channel, Model
from needleplan.signals import Array, Motion

__all__ = ["JointFilter"]


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
        joint: Joint,
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
        self._kalman: Extended | None = None
        self._last: Motion | None = None
        self._to_settle = 0
        self._kept: Array | None = None
        self.counts = dict.fromkeys(Use, 0)

    @property
    def channel(self) -> Channel:
        """What the model predicts: the column of a record that it is fed with."""
        return self._joint.start.channel

    @property
    def diverged(self) -> bool:
        """Whether the estimate is lost."""
        return self.counts[Use.DIVERGED] > 0

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

    def update(self, sample: Sample, *, masked: bool = False) -> Step:
        """Take one sample; `masked` ones move the filter on and correct nothing.

        Raises DataError, and leaves the filter as it was, where the time does not increase or time, depth or velocity
        is not a finite number.
        """
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return self._take(sample, masked)

    def _take(self, sample: Sample, masked: bool) -> Step:
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

    def _filter(self) -> Extended:
        if self._kalman is None:
            raise DataError("the filter has not had a sample yet")
        return self._kalman

    def _begin(self, now: Motion) -> Extended:
        assert self._start is not None
        x = self._joint.initial(self._start, now)
        n = self._joint.states
        if self._anchor is None:
            self._anchor = x[n:]
        covariance = np.zeros((x.size, x.size))
        covariance[:n, :n] = np.eye(n) * self._state_sd**2
        covariance[n:, n:] = np.diag(self._sd**2) if self._kept is None else self._kept
        walk = np.diag([0.0] * n + [self._walk] * (x.size - n))
        return Extended(x, covariance, walk, self._variance)

    def _correct(self, value: float, now: Motion, masked: bool) -> Step:
        kalman = self._filter()
        expected, change = self._joint.measure(kalman.x, now)
        spread = float(change @ kalman.P @ change) + self._variance
        use = (
            Use.DIVERGED if kalman.lost or not math.isfinite(expected) or not math.isfinite(spread)
            else Use.MISSING if not math.isfinite(value)
            else Use.MASKED if masked
            else Use.USED
        )  # fmt: skip
        if use is Use.USED:
            self._update(kalman, value, expected, change)
        self.counts[use] += 1
        sd = np.sqrt(np.maximum(np.diagonal(kalman.P), 0.0))
        return Step(use, expected, value - expected, math.sqrt(max(spread, 0.0)), kalman.x, sd)

    def _update(self, kalman: Extended, value: float, expected: float, change: Array) -> None:
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

    def _instant(self, sample: Sample) -> Motion:
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
