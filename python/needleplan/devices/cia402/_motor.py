"""A simulated motor that moves to a target with limited speed and acceleration; positions are in encoder counts."""

from __future__ import annotations

import math

from needleplan.devices.cia402.setup import AxisSetup

__all__ = ["Motor"]

_STEP_NS = 1_000_000  # time step of the simulation (ns)


class Motor:
    """A simulated motor. It moves to a target with a trapezoidal speed profile, in time steps of 1 ms.

    `counts` is the present position (encoder counts).
    """

    counts: float
    speed: float

    def __init__(self, setup: AxisSetup, counts: float, now_ns: int) -> None:
        self.counts, self.speed = float(counts), 0.0
        self._target = self._start = float(counts)
        self._fastest = 0.0
        self._stuck = False
        unit = abs(setup.counts_per_unit)
        self._ramp, self._quick = setup.limits.acceleration * unit, setup.limits.stop * unit
        self._braking: float | None = None
        self._now_ns = now_ns

    @property
    def arrived(self) -> bool:
        """Whether the motor is at its target, or at rest after a stop."""
        return self.speed == 0 and (self._braking is not None or self.counts == self._target)

    def shown(self, backwards: bool) -> float:
        """Return the position (counts) that the encoder reports; if `backwards`, the encoder counts in reverse."""
        return 2 * self._start - self.counts if backwards else self.counts

    def begin(self, now_ns: int, target: float, fastest: float, stuck: bool = False) -> None:
        """Begin a motion to `target` at a speed of at most `fastest` counts/s; if `stuck`, the motor does not move."""
        self.advance(now_ns)
        self._target, self._start, self._stuck, self._braking = float(target), self.counts, stuck, None
        self._fastest = fastest

    def halt(self, now_ns: int, quick: bool) -> None:
        """Decelerate to rest, with the quick-stop deceleration if `quick`, else with the normal one."""
        self.advance(now_ns)
        self._braking = self._quick if quick else self._ramp

    def advance(self, now_ns: int) -> None:
        """Advance the simulation to the time `now_ns`."""
        while self._now_ns + _STEP_NS <= now_ns:
            if self.arrived or self._stuck:
                self._now_ns += (now_ns - self._now_ns) // _STEP_NS * _STEP_NS
                return
            self._now_ns += _STEP_NS
            self._step(_STEP_NS / 1e9)

    def _step(self, seconds: float) -> None:
        if self._braking is not None:
            change = self._braking * seconds
            self.speed = math.copysign(max(abs(self.speed) - change, 0.0), self.speed)
            self.counts += self.speed * seconds
            return
        left = self._target - self.counts
        change = self._ramp * seconds
        # The highest speed from which the motor can still stop at the target, including the present step.
        most = max((math.sqrt(change * change + 8 * self._ramp * abs(left)) - change) / 2, 0.0)
        wanted = math.copysign(min(self._fastest, most), left)
        self.speed += min(max(wanted - self.speed, -change), change)
        if abs(left) <= abs(self.speed * seconds) or abs(left) < 1:
            self.counts, self.speed = self._target, 0.0
            return
        self.counts += self.speed * seconds
