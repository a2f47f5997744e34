"""One axis of the robot: a trapezoidal velocity profile, a PID servo at a fixed rate, and an encoder.

The axis is a double integrator with feed-forward of the profile's acceleration. The gains place three poles at the
bandwidth w: a = a_ref + 3 w (v_ref - v) + 3 w^2 (x_ref - x) + w^3 int (x_ref - x). Between ticks the acceleration is
constant and is integrated exactly. The servo measures only the encoder position; the measured velocity is a filtered
difference of positions. A profile that starts at rest is `signals.lspb` with the blend time velocity / acceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["SimulatedAxis", "Trapezoid"]

# time constant (s) of the low-pass filter of the measured velocity
_FILTER_S = 0.001
# time constant (s) with which an axis follows the samples of a robot outside of the simulation
_FOLLOW_S = 0.005
# ratio of the largest acceleration of the drive to the acceleration of the profile
_HEADROOM = 20.0
# duration (s) below which a piece of a profile is omitted
_INSTANT_S = 1e-12


@dataclass(frozen=True)
class _Piece:
    """Piece of a profile with constant acceleration; it begins at `begin_s` with this position and velocity."""

    begin_s: float
    position: float
    velocity: float
    acceleration: float


class Trapezoid:
    """Motion profile in pieces of constant acceleration that ends at rest. All positions are in mm, or all in rad."""

    def __init__(self, begin_s: float, position: float, velocity: float = 0.0) -> None:
        self._pieces = [_Piece(begin_s, position, velocity, 0.0)]
        self._end_s = begin_s
        self._at = 0

    @classmethod
    def rest(cls, begin_s: float, position: float) -> Trapezoid:
        """Return the profile of an axis at rest."""
        return cls(begin_s, position)

    @classmethod
    def to(
        cls, goal: float, top_velocity: float, acceleration: float, *, begin_s: float, position: float, velocity: float
    ) -> Trapezoid:
        """Return the profile from a position and velocity to `goal`, at most at `top_velocity`.

        The profile reverses if the axis moves away from the goal or cannot stop before the goal.
        """
        made = cls(begin_s, position, velocity)
        stops_at = position + velocity * abs(velocity) / (2 * acceleration)
        sign = math.copysign(1.0, goal - stops_at)
        peak = sign * min(top_velocity, math.sqrt(acceleration * abs(goal - position) + velocity**2 / 2))
        if velocity * sign < 0:
            # The axis first stops, so the distance to the goal is measured from the position where it stops.
            peak = sign * min(top_velocity, math.sqrt(acceleration * abs(goal - stops_at)))
        blend = abs(peak - velocity) / acceleration
        travelled = (velocity + peak) / 2 * blend
        rest = goal - position - travelled - peak * abs(peak) / (2 * acceleration)
        made._pieces = []
        made._add(blend, position, velocity, math.copysign(acceleration, peak - velocity))
        made._add(rest / peak if peak else 0.0, position + travelled, peak, 0.0)
        made._add(abs(peak) / acceleration, position + travelled + rest, peak, -sign * acceleration)
        made._pieces.append(_Piece(made._end_s, goal, 0.0, 0.0))
        return made

    @classmethod
    def stop(cls, acceleration: float, *, begin_s: float, position: float, velocity: float) -> Trapezoid:
        """Return the profile that comes to rest with the deceleration `acceleration`."""
        made = cls(begin_s, position, velocity)
        made._pieces = []
        made._add(abs(velocity) / acceleration, position, velocity, -math.copysign(acceleration, velocity))
        stops_at = position + velocity * abs(velocity) / (2 * acceleration)
        made._pieces.append(_Piece(made._end_s, stops_at, 0.0, 0.0))
        return made

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return position, velocity and acceleration at a time (s). Times must not decrease from call to call."""
        pieces = self._pieces
        while self._at + 1 < len(pieces) and time_s >= pieces[self._at + 1].begin_s - _INSTANT_S:
            self._at += 1
        piece = pieces[self._at]
        since = time_s - piece.begin_s
        velocity = piece.velocity + piece.acceleration * since
        return piece.position + (piece.velocity + velocity) / 2 * since, velocity, piece.acceleration

    @property
    def end_s(self) -> float:
        """Time (s) at which the profile comes to rest."""
        return self._end_s

    def _add(self, duration_s: float, position: float, velocity: float, acceleration: float) -> None:
        if duration_s > _INSTANT_S:
            self._pieces.append(_Piece(self._end_s, position, velocity, acceleration))
            self._end_s += duration_s


class SimulatedAxis:
    """One servo axis, in mm or rad, initially at rest."""

    def __init__(
        self, position: float, *, interval_s: float, bandwidth_hz: float, acceleration: float, resolution: float
    ) -> None:
        self.position: float = position
        self.velocity: float = 0.0
        self.acceleration_limit = acceleration
        self._resolution = resolution
        self._interval_s = interval_s
        w = 2 * math.pi * bandwidth_hz
        self._gains = (3 * w, 3 * w * w, w * w * w)
        self._share = 1 - math.exp(-interval_s / _FILTER_S)
        self._profile = Trapezoid.rest(0.0, position)
        self._reference = (position, 0.0)
        self.measured: float = self._encoder()
        self.measured_velocity: float = 0.0
        self._integral = 0.0
        self._followed: tuple[float, float] | None = None

    def go(self, goal: float, velocity: float, now_s: float) -> None:
        """Begin to move to a goal at most at `velocity` (> 0)."""
        x, v, _ = self._profile.at(now_s)
        self._profile = Trapezoid.to(goal, velocity, self.acceleration_limit, begin_s=now_s, position=x, velocity=v)

    def halt(self, now_s: float) -> None:
        """Begin to stop with the deceleration of the profile."""
        x, v, _ = self._profile.at(now_s)
        self._profile = Trapezoid.stop(self.acceleration_limit, begin_s=now_s, position=x, velocity=v)

    def moving(self, now_s: float) -> bool:
        """Return whether the present profile has not ended yet."""
        return now_s < self._profile.end_s

    @property
    def end_s(self) -> float:
        """Time (s) at which the present profile ends."""
        return self._profile.end_s

    @property
    def reference(self) -> float:
        """Position that the profile required in the last tick."""
        return self._reference[0]

    def step(self, now_s: float, disturbance: float = 0.0) -> None:
        """Simulate one tick of the servo that begins at `now_s`. `disturbance` is an external acceleration."""
        if self._followed is not None:
            self._step_behind(*self._followed)
            return
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

    def follow(self, position: float, velocity: float) -> None:
        """From now on, follow an axis outside of the simulation; called with each of its samples.

        The first sample is taken over at once.
        """
        if not (math.isfinite(position) and math.isfinite(velocity)):
            return
        if self._followed is None:
            self.position = self.measured = position
        self._followed = (position + velocity * _FOLLOW_S, velocity)

    def _step_behind(self, goal: float, velocity: float) -> None:
        """Follow the last sample with the time constant `_FOLLOW_S`, which `goal` compensates at constant speed."""
        dt = self._interval_s
        self.velocity = (goal - self.position) * (1 - math.exp(-dt / _FOLLOW_S)) / dt
        self.position += self.velocity * dt
        self.measured, self.measured_velocity = self._encoder(), velocity
        self._reference = (self.position, velocity)

    def _encoder(self) -> float:
        if self._resolution:
            return round(self.position / self._resolution) * self._resolution
        return self.position
