"""Motions of the third generator: what the stage does, on a fine and even grid of times.

A motion is a list of legs. `go(depth, speed)` moves with a trapezoidal speed, `stay(seconds)` rests, `chain`
changes the speed without a stop, and `wave` adds an oscillation to a slow advance. The whole speed is then
averaged over 40 ms, so that the acceleration changes gradually as that of a real drive does.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Array = NDArray[np.float64]

FINE_HZ = 2000  # rate of the integration
SMOOTHED_S = 0.04  # time over which the drive averages its speed
ABOVE_MM = 3.0  # height above the tissue from which every motion starts
MOTIONS = ("rich", "one_speed", "cycles")
FAMILIES = ("steps", "strokes", "dither", "pecking", "chained")


@dataclass(frozen=True)
class StagePath:
    """Motion of the stage on the fine grid: time (s), depth (mm), velocity (mm/s) and acceleration (mm/s2)."""

    time_s: Array
    depth_mm: Array
    velocity_mm_s: Array
    acceleration_mm_s2: Array


class Legs:
    """Speeds of consecutive legs on the fine grid; `at` is the depth that the last leg has reached (mm)."""

    def __init__(self, acceleration: float) -> None:
        self.at = -ABOVE_MM
        self.acceleration = acceleration
        self.speeds: list[Array] = []

    def stay(self, seconds: float) -> None:
        """Rest."""
        self.speeds.append(np.zeros(round(seconds * FINE_HZ)))

    def go(self, depth: float, speed: float) -> None:
        """Move to a depth (mm) with a speed (mm/s)."""
        self.chain([(depth, speed)])

    def chain(self, parts: list[tuple[float, float]]) -> None:
        """Move through the depths of `parts`, each at its own speed, without a stop between parts in one direction."""
        way = parts[-1][0] - self.at
        knots_t, knots_v, at = [0.0], [0.0], self.at
        for depth, speed in parts:
            ramp = abs(speed - knots_v[-1]) / self.acceleration
            knots_t += [knots_t[-1] + ramp, knots_t[-1] + ramp + abs(depth - at) / speed]
            knots_v += [speed, speed]
            at = depth
        knots_t.append(knots_t[-1] + knots_v[-1] / self.acceleration)
        knots_v.append(0.0)
        times = np.arange(int(knots_t[-1] * FINE_HZ) + 2) / FINE_HZ
        speeds = np.interp(times, knots_t, knots_v, right=0.0)
        self._add(speeds, way)

    def wave(self, way: float, speed: float, amplitude: float, hz: float) -> None:
        """Advance about `way` mm with an oscillation of whole cycles."""
        cycles = max(2, round(way / speed * hz))
        times = np.arange(round(cycles / hz * FINE_HZ)) / FINE_HZ
        window = np.minimum(1.0, np.minimum(times, times[-1] - times) * hz * 2)
        swing = amplitude * np.sin(np.pi / 2 * window) ** 2 * np.sin(2 * np.pi * hz * times)
        self.speeds.append(speed + np.gradient(swing, 1 / FINE_HZ))
        self.at += float(self.speeds[-1].sum()) / FINE_HZ

    def _add(self, speeds: Array, way: float) -> None:
        total = speeds.sum() / FINE_HZ
        self.speeds.append(speeds * way / total if total > 0 else speeds)
        self.at += way

    def path(self, rate_hz: int) -> StagePath:
        """Give the motion, extended to a whole number of samples at `rate_hz`."""
        every = FINE_HZ // rate_hz
        wide = round(SMOOTHED_S * FINE_HZ)
        speeds = np.concatenate([*self.speeds, np.zeros(wide)])
        speeds = np.convolve(speeds, np.full(wide, 1 / wide))
        samples = -(-speeds.size // every)
        velocity = np.zeros(samples * every + 1)
        velocity[: speeds.size] = speeds
        depth = np.concatenate([[0.0], np.cumsum(velocity[1:] + velocity[:-1])]) / (2 * FINE_HZ) - ABOVE_MM
        return StagePath(np.arange(velocity.size) / FINE_HZ, depth, velocity, np.gradient(velocity, 1 / FINE_HZ))


def speed_of(rng: Generator) -> float:
    return float(np.exp(rng.uniform(np.log(2.2), np.log(14.0))))


def steps(legs: Legs, depth: float, rng: Generator) -> None:
    """Advance in parts of different speed, with rests and short retractions."""
    parts = int(rng.integers(3, 6))
    for to in depth * np.sort(np.append(rng.uniform(0.15, 0.9, parts - 1), 1.0)):
        legs.go(float(to), speed_of(rng))
        if rng.random() < 0.6:
            legs.stay(rng.uniform(0.5, 2.5))
        if rng.random() < 0.5:
            legs.go(legs.at - min(rng.uniform(3, 12), 0.8 * float(to)), speed_of(rng))
    legs.stay(rng.uniform(1.0, 2.0))
    legs.go(-ABOVE_MM if rng.random() < 0.6 else 0.2 * depth, speed_of(rng))


def strokes(legs: Legs, depth: float, rng: Generator) -> None:
    """Insert two or three times, some of them from the air, each at a speed of its own."""
    for k in range(int(rng.integers(2, 4))):
        legs.go(depth if k == 1 else depth * rng.uniform(0.5, 0.95), speed_of(rng))
        legs.stay(rng.uniform(0.3, 2.0))
        legs.go(-ABOVE_MM if rng.random() < 0.5 else depth * rng.uniform(0.1, 0.4), rng.uniform(4.0, 14.0))
        legs.stay(rng.uniform(0.2, 1.0))


def dither(legs: Legs, depth: float, rng: Generator) -> None:
    """Advance slowly with an oscillation, then plainly, rest, and retract."""
    legs.go(depth * rng.uniform(0.2, 0.4), speed_of(rng))
    legs.wave(depth * rng.uniform(0.3, 0.45), rng.uniform(1.8, 3.5), rng.uniform(0.5, 1.2), rng.uniform(0.5, 1.1))
    legs.stay(rng.uniform(0.5, 2.5))
    legs.go(depth, speed_of(rng))
    legs.stay(rng.uniform(0.5, 1.5))
    legs.go(depth * rng.uniform(0.0, 0.5), speed_of(rng))


def pecking(legs: Legs, depth: float, rng: Generator) -> None:
    """Advance 6 to 11 mm, retract 2 to 5 mm, and so on, at two speeds, with one rest on the way."""
    fast, slow, rested = rng.uniform(6, 13), rng.uniform(2, 5), False
    while legs.at < depth - 6:
        legs.go(min(legs.at + rng.uniform(6, 11), depth), fast if rng.random() < 0.5 else slow)
        if legs.at > 0.5 * depth and not rested:
            legs.stay(rng.uniform(1.0, 3.0))
            rested = True
        legs.go(legs.at - rng.uniform(2, 5), fast)
    legs.go(depth, slow)
    legs.stay(rng.uniform(0.5, 1.5))
    legs.go(-ABOVE_MM, fast)


def chained(legs: Legs, depth: float, rng: Generator) -> None:
    """Change the speed several times without a stop, in both directions, and insert again."""
    for low, high in ((-ABOVE_MM, depth), (depth * rng.uniform(0.1, 0.4), depth * rng.uniform(0.7, 1.0))):
        if legs.at > low:
            legs.go(low, speed_of(rng))
        ends = low + (high - low) * np.array([0.3, 0.5, 0.75, 1.0])
        legs.chain([(float(end), speed_of(rng)) for end in ends])
        legs.stay(rng.uniform(0.5, 2.0))
    legs.chain([(0.4 * depth, speed_of(rng)), (-ABOVE_MM, speed_of(rng))])


RICH: dict[str, Callable[[Legs, float, Generator], None]] = {
    "steps": steps, "strokes": strokes, "dither": dither, "pecking": pecking, "chained": chained,
}  # fmt: skip


def paths(rng: Generator, motion: str, depth: float, rate_hz: int, train: int) -> list[tuple[str, StagePath]]:
    """Draw `train` motions and a held-out one of another kind; give the family and the path of each."""
    speed, out = (
        float(rng.uniform(4.0, 10.0) if motion == "cycles" else rng.uniform(2.5, 10.0)),
        bool(rng.random() < 0.5),
    )
    retract = bool(rng.random() < 0.5)
    other = speed * float(rng.choice([0.6, 1.6]))
    family, held = rng.permutation(FAMILIES)[:2]
    made = []
    for number in range(train + 1):
        last = number == train
        legs = Legs(float(np.exp(rng.uniform(np.log(60.0), np.log(400.0)))))
        legs.stay(rng.uniform(0.3, 1.0))
        to = depth * (0.9 if last else float(rng.uniform(0.85, 1.0)))
        if motion == "rich":
            name = str(held if last else family)
            RICH[name](legs, to, rng)
        elif motion == "one_speed":
            name = "insertion and retraction" if retract else "insertion"
            legs.go(to, other if last else speed)
            legs.stay(rng.uniform(0.3, 1.5))
            if retract:
                legs.go(-ABOVE_MM, other if last else speed)
        else:
            name = "cycles from the air" if out else "cycles inside"
            pace = other if last else speed * float(rng.choice([1.0, 1.3]))
            for _ in range(2 if last else int(rng.integers(2, 4))):
                legs.go(to, pace)
                legs.stay(0.2)
                legs.go(-ABOVE_MM if out else depth * (0.45 if last else 0.3), pace)
                legs.stay(0.2)
        legs.stay(rng.uniform(0.3, 1.0))
        made.append((name, legs.path(rate_hz)))
    return made
