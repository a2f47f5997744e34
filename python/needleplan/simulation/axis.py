"""An axis of the robot: a profile, a PID servo at a fixed rate, and an encoder.

The axis is a double integrator with feed-forward of the profile's acceleration. The gains place three poles at the
bandwidth w: a = a_ref + 3 w (v_ref - v) + 3 w^2 (x_ref - x) + w^3 int (x_ref - x). Between ticks the acceleration is
held, which is integrated exactly. The servo sees the encoder only; its velocity is a filtered difference.
"""

from __future__ import annotations

import math

from needleplan.simulation.profile import Trapezoid

__all__ = ["Axis"]

_FILTER_S = 0.001
_HEADROOM = 20.0
"""The drive can give this many times the acceleration of the profile."""


class Axis:
    """One axis, in mm or rad, at rest at first."""

    def __init__(
        self, position: float, *, interval_s: float, bandwidth_hz: float, acceleration: float, resolution: float
    ) -> None:
        self.position = position
        self.velocity = 0.0
        self.acceleration_limit = acceleration
        self._resolution = resolution
        self._interval_s = interval_s
        w = 2 * math.pi * bandwidth_hz
        self._gains = (3 * w, 3 * w * w, w * w * w)
        self._share = 1 - math.exp(-interval_s / _FILTER_S)
        self._profile = Trapezoid.rest(0.0, position)
        self._reference = (position, 0.0)
        self.measured = self._encoder()
        self.measured_velocity = 0.0
        self._integral = 0.0

    def go(self, goal: float, velocity: float, now_s: float) -> None:
        """Begin to move to a goal at a speed (positive)."""
        x, v, _ = self._profile.at(now_s)
        self._profile = Trapezoid.to(goal, velocity, self.acceleration_limit, begin_s=now_s, position=x, velocity=v)

    def halt(self, now_s: float) -> None:
        """Begin to stop as fast as the profile may."""
        x, v, _ = self._profile.at(now_s)
        self._profile = Trapezoid.stop(self.acceleration_limit, begin_s=now_s, position=x, velocity=v)

    def moving(self, now_s: float) -> bool:
        """Whether the profile has not come to its end."""
        return now_s < self._profile.end_s

    @property
    def end_s(self) -> float:
        """When the profile comes to its end."""
        return self._profile.end_s

    @property
    def reference(self) -> float:
        """Where the profile is."""
        return self._reference[0]

    def step(self, now_s: float, disturbance: float = 0.0) -> None:
        """Go on by one tick, which begins at `now_s`; `disturbance` is an acceleration from outside."""
        dt = self._interval_s
        wanted, wanted_velocity, forward = self._profile.at(now_s)
        error = wanted - self.measured
        kd, kp, ki = self._gains
        limit = _HEADROOM * self.acceleration_limit
        tried = (
            forward + kd * (wanted_velocity - self.measured_velocity) + kp * error
            + ki * (self._integral + error * dt)
        )  # fmt: skip
        given = min(max(tried, -limit), limit)
        if given == tried:
            self._integral += error * dt
        acceleration = given + disturbance
        self.position += dt * (self.velocity + acceleration * dt / 2)
        self.velocity += acceleration * dt
        last, self.measured = self.measured, self._encoder()
        self.measured_velocity += self._share * ((self.measured - last) / dt - self.measured_velocity)
        self._reference = (wanted, wanted_velocity)

    def _encoder(self) -> float:
        if self._resolution:
            return round(self.position / self._resolution) * self._resolution
        return self.position
