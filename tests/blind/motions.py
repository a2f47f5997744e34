"""Motions of the needle's base along its axis: 31 s each, smooth in speed, beginning and ending in the air."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_S = 0.01  # of the generator; every second step is recorded
SECONDS = 31.0
AIR_MM = -2.0
_BLEND = 8  # steps of each of the two averages that round the corners of the speed


class MotionKind(StrEnum):
    RICH_A = "rich_a"
    RICH_B = "rich_b"
    RICH_C = "rich_c"
    CONSTANT_SLOW = "constant_2.5"
    CONSTANT = "constant_5"
    CONSTANT_FAST = "constant_8"
    MULTISPEED = "multispeed"
    HOLDS = "holds"
    REVERSAL = "reversal"
    DITHER = "dither"
    AIR = "air"


POOR = (MotionKind.CONSTANT,) * 3
POOR_HELD_OUT = (MotionKind.CONSTANT_FAST, MotionKind.MULTISPEED)
RICH = (MotionKind.RICH_A, MotionKind.RICH_B, MotionKind.RICH_C)
RICH_HELD_OUT = (MotionKind.MULTISPEED, MotionKind.DITHER)

# (depth to go to in mm, speed in mm/s); a depth of None is a hold of so many seconds.
_Legs = tuple[tuple[float | None, float], ...]
_LEGS: dict[MotionKind, _Legs] = {
    MotionKind.RICH_A: ((20, 8), (None, 2), (14, 5), (45, 4), (None, 1.5), (60, 10), (50, 5), (66, 6), (None, 1),
                        (-2, 14)),
    MotionKind.RICH_B: ((15, 3), (30, 10), (None, 1.5), (22, 8), (48, 6), (None, 2), (42, 2.5), (66, 9), (-2, 15)),
    MotionKind.RICH_C: ((28, 12), (None, 1), (18, 6), (52, 6), (None, 2), (6, 14), (40, 12), (None, 1), (64, 8),
                        (-2, 14)),
    MotionKind.CONSTANT_SLOW: ((35, 2.5), (None, 0.5), (-2, 2.5)),
    MotionKind.CONSTANT: ((70, 5), (None, 0.5), (-2, 5)),
    MotionKind.CONSTANT_FAST: ((70, 8), (None, 0.5), (-2, 8)),
    MotionKind.MULTISPEED: ((15, 2.5), (35, 10), (50, 4), (68, 12), (45, 6), (20, 12), (-2, 5)),
    MotionKind.HOLDS: ((15, 5), (None, 3), (35, 8), (None, 3), (60, 8), (None, 4), (-2, 10)),
    MotionKind.REVERSAL: ((20, 8), (8, 6), (40, 8), (25, 8), (65, 10), (45, 8), (-2, 12)),
}  # fmt: skip


@dataclass(frozen=True)
class Trajectory:
    """What the base does, every STEP_S; depth of the tip below the entry of the tissue at rest."""

    kind: str
    depth_mm: Array
    velocity_mm_s: Array
    acceleration_mm_s2: Array

    @property
    def time_s(self) -> Array:
        return STEP_S * np.arange(len(self.depth_mm))

    @property
    def phase(self) -> NDArray[np.str_]:
        """air, insertion, hold or retraction, at each step."""
        moving = np.where(self.velocity_mm_s > 0, "insertion", "retraction")
        inside = np.where(np.abs(self.velocity_mm_s) < 0.02, "hold", moving)
        return np.where(self.depth_mm < 0, "air", inside)


def _averaged(velocity: Array) -> Array:
    box = np.ones(_BLEND) / _BLEND
    return np.convolve(np.convolve(velocity, box), box)[: len(velocity)]


def from_velocity(kind: str, velocity_mm_s: Array, start_mm: float = AIR_MM) -> Trajectory:
    """The trajectory with this speed at each step; depth by the trapezoidal rule."""
    middle = 0.5 * (velocity_mm_s[1:] + velocity_mm_s[:-1])
    depth = start_mm + np.concatenate([[0.0], np.cumsum(middle) * STEP_S])
    return Trajectory(kind, depth, velocity_mm_s, np.gradient(velocity_mm_s, STEP_S))


def from_depths(kind: str, time_s: Array, depth_mm: Array) -> Trajectory:
    """A motion that somebody else designed, of any rate and length, on the steps of the generator.

    The first depth must be in the air; the motion is held at its end until SECONDS if it is shorter.
    """
    if depth_mm[0] > 0:
        raise ValueError(f"depth_mm: a motion begins in the air, not at {depth_mm[0]:.2f} mm")
    span = max(SECONDS, float(time_s[-1] - time_s[0]))
    steps = round(span / STEP_S)
    wanted = np.interp(np.arange(steps) * STEP_S, time_s - time_s[0], depth_mm)
    return from_velocity(kind, _averaged(np.diff(wanted, prepend=wanted[0]) / STEP_S), float(depth_mm[0]))


def trajectory(kind: MotionKind, seconds: float = SECONDS) -> Trajectory:
    """The motion by its name; what remains of the time is a hold in the air."""
    steps = round(seconds / STEP_S)
    velocity = np.zeros(steps)
    at, depth = 50, AIR_MM
    if kind is MotionKind.AIR:
        return from_velocity(kind, velocity, AIR_MM)
    if kind is MotionKind.DITHER:
        time = STEP_S * np.arange(1500)
        velocity[at : at + 1500] = 2.2 + 0.8 * 2 * np.pi * np.cos(2 * np.pi * time)
        at += 1500
        depth += 2.2 * 15.0
        legs: _Legs = ((None, 1.0), (50, 8), (None, 1.0), (AIR_MM, 8))
    else:
        legs = _LEGS[kind]
    for target, value in legs:
        if target is None:
            at += round(value / STEP_S)
            continue
        count = round(abs(target - depth) / value / STEP_S)
        velocity[at : at + count] = (target - depth) / (count * STEP_S)
        at, depth = at + count, target
    if at + 2 * _BLEND > steps:
        raise ValueError(f"{kind} takes {at * STEP_S} s, more than {seconds} s")
    return from_velocity(kind, _averaged(velocity))
