"""Motions of the second generator: piecewise linear speeds, evaluated at any time without integration error.

A motion is a list of speed knots (t_k, v_k). Between two knots the speed is linear and the depth is a parabola, so
that depth, speed and acceleration are exact at 5 kHz and at the sampling times alike. Three families exist: `rich`
(several speeds, holds, retractions, reversals), `one_speed` (in, a short hold, out, at one speed) and `cycles`
(strokes about a depth).
"""

from dataclasses import dataclass

import numpy as np

FINE_HZ = 5000  # rate of the integration; a multiple of each sampling rate
ABOVE_MM = 2.5  # distance of the tip to the tissue at the start of a trial
MOTIONS = ("rich", "one_speed", "cycles")
RATES_HZ = (50, 100, 200, 500)


@dataclass(frozen=True)
class Motion:
    """Depth of the tip over time.

    Attributes
    ----------
    knots_s, speeds_mm_s : arrays of one length
        The speed is linear between the knots.
    start_mm : float
        Depth at the first knot.
    """

    knots_s: np.ndarray
    speeds_mm_s: np.ndarray
    start_mm: float

    @property
    def duration_s(self) -> float:
        """Time of the last knot."""
        return float(self.knots_s[-1])

    def at(self, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Depth (mm), speed (mm/s) and acceleration (mm/s2) at the times; at rest before and after."""
        steps = np.diff(self.knots_s)
        slopes = np.diff(self.speeds_mm_s) / steps
        depths = self.start_mm + np.concatenate(
            [[0.0], np.cumsum(steps * (self.speeds_mm_s[1:] + self.speeds_mm_s[:-1]) / 2)]
        )
        inside = np.clip(time_s, 0.0, self.duration_s)
        piece = np.clip(np.searchsorted(self.knots_s, inside, side="right") - 1, 0, len(steps) - 1)
        since = inside - self.knots_s[piece]
        speed = self.speeds_mm_s[piece] + slopes[piece] * since
        depth = depths[piece] + since * (self.speeds_mm_s[piece] + speed) / 2
        moving = (time_s >= 0) & (time_s < self.duration_s)
        return depth, np.where(moving, speed, 0.0), np.where(moving, slopes[piece], 0.0)


class Path:
    """Collects moves and dwells, and makes a `Motion` of them."""

    def __init__(self, acceleration: float) -> None:
        self.acceleration = acceleration
        self.depth = -ABOVE_MM
        self.knots, self.speeds = [0.0], [0.0]

    def dwell(self, seconds: float) -> None:
        """Stays where it is."""
        self.knots.append(self.knots[-1] + seconds)
        self.speeds.append(0.0)

    def move(self, to_mm: float, speed: float) -> None:
        """A trapezoid of the speed, or a triangle if the distance is too short."""
        distance = abs(to_mm - self.depth)
        if distance < 1e-6:
            return
        speed = min(speed, np.sqrt(distance * self.acceleration) * 0.999)
        blend = speed / self.acceleration
        cruise = distance / speed - blend
        sign = np.sign(to_mm - self.depth)
        for step, value in ((blend, sign * speed), (cruise, sign * speed), (blend, 0.0)):
            self.knots.append(self.knots[-1] + step)
            self.speeds.append(value)
        self.depth = to_mm

    def motion(self) -> Motion:
        """The collected motion."""
        return Motion(np.array(self.knots), np.array(self.speeds), -ABOVE_MM)


def _rich(rng: np.random.Generator, deepest: float) -> Path:
    path = Path(rng.uniform(40, 120))
    speeds = rng.permutation([rng.uniform(1.8, 3.5), rng.uniform(4, 7), rng.uniform(8, 13)])
    path.dwell(0.5)
    reached = -ABOVE_MM
    for share, speed in zip((rng.uniform(0.3, 0.45), rng.uniform(0.6, 0.78), 1.0), speeds, strict=True):
        reached = share * deepest
        path.move(reached, speed * (1.5 if reached < 0 else 1.0))
        if rng.random() < 0.75:
            path.dwell(rng.uniform(0.6, 2.5))
        if share < 1.0:
            path.move(reached - rng.uniform(3, 12), rng.uniform(3, 10))
            if rng.random() < 0.4:
                path.dwell(rng.uniform(0.4, 1.2))
    path.move(reached - rng.uniform(8, 20), rng.uniform(4, 10))
    path.move(reached - rng.uniform(0, 4), rng.uniform(3, 9))
    path.move(-ABOVE_MM, rng.uniform(8, 14))
    path.dwell(0.5)
    return path


def _one_speed(rng: np.random.Generator, deepest: float, speed: float) -> Path:
    path = Path(rng.uniform(60, 120))
    path.dwell(0.5)
    path.move(deepest, speed)
    path.dwell(rng.uniform(0.5, 1.5))
    path.move(-ABOVE_MM, speed)
    path.dwell(0.5)
    return path


def _cycles(rng: np.random.Generator, deepest: float) -> Path:
    path = Path(rng.uniform(60, 120))
    middle, stroke = rng.uniform(0.55, 0.7) * deepest, rng.uniform(0.12, 0.28) * deepest
    path.dwell(0.5)
    path.move(middle, rng.uniform(4, 8))
    for _ in range(int(rng.integers(3, 6))):
        path.move(middle + stroke, speed := rng.uniform(4, 12))
        path.move(middle - stroke, speed)
    path.dwell(rng.uniform(0.5, 1.5))
    path.move(-ABOVE_MM, rng.uniform(6, 12))
    path.dwell(0.5)
    return path


def draw_motions(rng: np.random.Generator, kind: str, training: int) -> list[Motion]:
    """Motions of the training trials, and of one held-out trial (the last) that differs in depth and speed."""
    deepest = rng.uniform(48, 65)
    if kind == "one_speed":
        speed = rng.uniform(4.0, 7.0)
        trained = [_one_speed(rng, deepest, speed) for _ in range(training)]
        held = _one_speed(rng, deepest * rng.uniform(0.8, 0.95), speed * rng.choice([0.6, 1.6]))
    elif kind == "cycles":
        trained = [_cycles(rng, deepest * rng.uniform(0.9, 1.0)) for _ in range(training)]
        held = _rich(rng, deepest * rng.uniform(0.85, 0.97))
    else:
        trained = [_rich(rng, deepest * rng.uniform(0.9, 1.0)) for _ in range(training)]
        held = _rich(rng, deepest * rng.uniform(0.8, 0.97))
    return [path.motion() for path in [*trained, held]]
