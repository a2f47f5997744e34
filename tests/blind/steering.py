"""Motions of a steered needle's base: inserted at several speeds, turned about its axis at rest, held; 24 s each."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from tests.blind.motions import Array

STEP_S = 0.0125  # every second step is recorded: 40 Hz
SECONDS = 24.0
TURN_RAD_S = np.pi
_BLEND = 8


class SteeringKind(StrEnum):
    ONE_SPEED = "one_speed"
    SLOW_TURN_FAST = "slow_turn_fast"
    FAST_TURN_SLOW = "fast_turn_slow"
    REVERSED = "reversed"
    LATE_TURN = "late_turn"
    TWO_TURNS = "two_turns"
    STILL = "still"


TWO_SPEED = (SteeringKind.SLOW_TURN_FAST, SteeringKind.FAST_TURN_SLOW, SteeringKind.REVERSED)
TWO_SPEED_HELD_OUT = (SteeringKind.LATE_TURN, SteeringKind.TWO_TURNS)

# (depth to go to in mm, speed in mm/s); a depth of None is a turn of so many rad.
_Legs = tuple[tuple[float | None, float], ...]
_LEGS: dict[SteeringKind, tuple[float, _Legs]] = {
    SteeringKind.ONE_SPEED: (0.0, ((80, 5),)),
    SteeringKind.SLOW_TURN_FAST: (0.0, ((40, 4), (None, np.pi), (80, 10))),
    SteeringKind.FAST_TURN_SLOW: (0.0, ((30, 10), (None, np.pi), (80, 4))),
    SteeringKind.REVERSED: (np.pi, ((25, 4), (50, 10), (None, -np.pi), (80, 4))),
    SteeringKind.LATE_TURN: (0.0, ((55, 8), (None, np.pi), (80, 3))),
    SteeringKind.TWO_TURNS: (np.pi, ((25, 6), (None, -np.pi), (60, 6), (None, np.pi), (80, 6))),
    SteeringKind.STILL: (0.0, ()),
}


@dataclass(frozen=True)
class Steering:
    """What the base does, every STEP_S: inserted length in mm, its speed, angle about the axis in rad."""

    kind: str
    depth_mm: Array
    velocity_mm_s: Array
    angle_rad: Array

    @property
    def time_s(self) -> Array:
        return STEP_S * np.arange(len(self.depth_mm))

    @property
    def phase(self) -> np.ndarray:
        """insertion, rotation or hold, at each step."""
        turning = np.abs(np.gradient(self.angle_rad)) > 1e-6
        return np.where(self.velocity_mm_s > 0.02, "insertion", np.where(turning, "rotation", "hold"))


def from_rates(kind: str, velocity_mm_s: Array, turning_rad_s: Array, start_rad: float = 0.0) -> Steering:
    """A motion by its rates at each step, each rounded over 0.2 s. The needle is never drawn back.

    Raises ValueError for a negative velocity: the channel has no path for a tip that goes back.
    """
    if velocity_mm_s.min() < 0:
        raise ValueError("velocity_mm_s: the needle is not drawn back in this channel")
    box = np.ones(_BLEND) / _BLEND
    rates = (velocity_mm_s, turning_rad_s)
    velocity, turning = (np.convolve(np.convolve(each, box), box)[: len(each)] for each in rates)
    depth, angle = (
        np.concatenate([[0.0], np.cumsum(0.5 * (each[1:] + each[:-1])) * STEP_S]) for each in (velocity, turning)
    )
    return Steering(kind, depth, velocity, start_rad + angle)


def steering(kind: SteeringKind, seconds: float = SECONDS) -> Steering:
    """The motion by its name; what remains of the time is a hold."""
    steps = round(seconds / STEP_S)
    velocity, turning = np.zeros(steps), np.zeros(steps)
    start, legs = _LEGS[kind]
    at, depth = 40, 0.0
    for target, value in legs:
        if target is None:
            at += 24
            count = round(abs(value) / TURN_RAD_S / STEP_S)
            turning[at : at + count] = value / (count * STEP_S)
            at += count + 24
            continue
        count = round((target - depth) / value / STEP_S)
        velocity[at : at + count] = (target - depth) / (count * STEP_S)
        at, depth = at + count, target
    if at + 2 * _BLEND > steps:
        raise ValueError(f"{kind} takes {at * STEP_S} s, more than {seconds} s")
    return from_rates(kind, velocity, turning, start)
