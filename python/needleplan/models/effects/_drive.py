"""Effects of the drive: the depth is measured at the motor, and the needle follows it with play or after sticking.

**Play.** The needle stands while the motor crosses the gap of a gear or a screw. With the motor at x, the needle is at
x - p, where p is 0 while the motor pushes and -size while it pulls (play operator; Nordin and Gutman, Automatica 38
(2002) 1633), equation (2) of docs/explanation/further-effects.md:

    p' = v inside of -size < p < 0, else 0

The needle is taken to rest in the tissue while the motor crosses the gap: the friction of the shaft exceeds the force
of the compressed tissue. At the entry this is not so, but there the force is small.

**Stick.** After a rest the drive needs more force to break away than to move on. An elastic drive of stiffness k is
then wound up further than in motion by size = (static - sliding friction)/k (Armstrong, Dupont and Canudas de Wit,
Automatica 30 (1994) 1083). At first the needle stands, then it falls behind by up to `size`, and catches up; the shape
is ours, equation (3):

    p = s exp(-s/(e size)) sign(v),   s the travel since the last rest

Both wrap a whole model: what happens in the tissue depends on the position of the needle, not on that of the motor.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from needleplan.models._base import Model, WrappingModel
from needleplan.models._parameter import parameter
from needleplan.models._simulate import simulate
from needleplan.signals import Array, Motion

__all__ = ["LooseDrive", "StickingDrive", "WithDrive"]

# Speed (mm/s) below which the motor is at rest.
_REST_MM_S = 1e-2
# Time (s) in which the needle takes up the velocity of the motor after the gap; much shorter than a sample.
_JUMP_S = 1e-9
# Smallest amplitude (mm) that is divided by.
_SMALLEST_MM = 1e-9
# Steps of a drive that sticks, for each step of the motion.
_FINER = 8
# Time (s) of rest within which the drive sticks again, in `derivative`; `needle` forgets at once.
_STICKS_S = 0.05


@dataclass(frozen=True, kw_only=True)
class WithDrive(WrappingModel):
    """Abstract base class of a model whose needle lags behind the motor by p (mm).

    The last number of the state is the memory of the drive.
    """

    base: Model

    @abstractmethod
    def behind(self, memory: Array, motion: Motion) -> Array:
        """Return p (mm) for the memory of the drive, shape (...)."""

    @abstractmethod
    def rate(self, memory: Array, motion: Motion) -> Array:
        """Return the rate of change of the memory per second, shape (...)."""

    @abstractmethod
    def needle(self, motion: Motion, start: float) -> tuple[Motion, NDArray[np.intp], Array]:
        """Return the motion of the needle, the indices of its samples, and the memory at every sample of the motor.

        The motion of the needle may have further samples, at which the needle begins to move.
        """

    @abstractmethod
    def behind_rate(self, memory: Array, motion: Motion) -> Array:
        """Return p' (mm/s), shape (...)."""

    def initial_state(self, motion: Motion) -> Array:
        """Return the state of the base at rest and an empty memory, shape (n + 1,)."""
        return np.append(self.base.initial_state(motion), 0.0)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of change of the state of the base, in the motion of the needle, and of the memory."""
        memory = state[-1]
        needle = self._moved(motion, self.behind(memory, motion), self.behind_rate(memory, motion))
        return np.concatenate([self.base.derivative(state[:-1], needle), np.asarray(self.rate(memory, motion))[None]])

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the output of the base model in the motion of the needle."""
        memory = state[-1]
        behind = self.behind(memory, motion)
        needle = self._moved(motion, behind, self.behind_rate(memory, motion))
        return self.base.output(state[:-1], needle)

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the state of the base (n) and the memory of the drive at every sample, shape (n + 1, samples)."""
        needle, index, memory = self.needle(motion, float(start[-1]))
        return np.vstack([simulate(self.base, needle, start[:-1]).states[:, index], memory])

    @staticmethod
    def _moved(motion: Motion, behind: Array, rate: Array) -> Motion:
        velocity = np.asarray(motion.velocity_mm_s - rate)
        return replace(
            motion, depth_mm=np.asarray(motion.depth_mm - behind), velocity_mm_s=velocity, direction=np.sign(velocity)
        )


@dataclass(frozen=True, kw_only=True)
class LooseDrive(WithDrive):
    """A model that is driven through play (backlash); the memory of the drive is the lag p (mm)."""

    size: float = parameter("mm", 0, 10, "play of the drive", typical=0.1)

    def behind(self, memory: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return p."""
        return memory

    def rate(self, memory: Array, motion: Motion) -> Array:
        """Return p' (mm/s)."""
        velocity = np.asarray(motion.velocity_mm_s, float)
        free = np.where(velocity > 0, memory < 0, memory > -self.size)
        return np.asarray(np.where(free, velocity, 0.0))

    def behind_rate(self, memory: Array, motion: Motion) -> Array:
        """Return p' (mm/s)."""
        return self.rate(memory, motion)

    def needle(self, motion: Motion, start: float) -> tuple[Motion, NDArray[np.intp], Array]:
        """Return motion, indices and p, exact for a velocity that is linear between samples."""
        rows = (np.asarray(row, float).tobytes() for row in (motion.velocity_mm_s, motion.time_s))
        time, velocity, behind, index = _played(*rows, self.size, start)
        depth = np.interp(time, motion.time_s, motion.depth_mm) - behind
        angle = np.interp(time, motion.time_s, motion.angle_rad)
        return Motion(time, depth, velocity, np.sign(velocity), angle), index, behind[index]


@dataclass(frozen=True, kw_only=True)
class StickingDrive(WithDrive):
    """A model behind a drive that sticks after a rest; its memory is the travel s (mm) since the rest or reversal."""

    size: float = parameter("mm", 0, 10, "largest distance by which the needle falls behind", typical=0.1)

    def behind(self, memory: Array, motion: Motion) -> Array:
        """Return p."""
        moves = np.abs(motion.velocity_mm_s) >= _REST_MM_S
        return np.asarray(np.where(moves, memory * self._left(memory) * motion.direction, 0.0))

    def rate(self, memory: Array, motion: Motion) -> Array:
        """Return s' (mm/s)."""
        speed = np.abs(np.asarray(motion.velocity_mm_s, float))
        return np.asarray(np.where(speed < _REST_MM_S, -memory / _STICKS_S, speed))

    def behind_rate(self, memory: Array, motion: Motion) -> Array:
        """Return p' (mm/s)."""
        slope = (1 - memory / (math.e * max(self.size, _SMALLEST_MM))) * self._left(memory)
        return np.asarray(slope * motion.direction * self.rate(memory, motion))

    def _left(self, memory: Array) -> Array:
        """Return p/s."""
        return np.asarray(np.exp(-memory / (math.e * max(self.size, _SMALLEST_MM))))

    def needle(self, motion: Motion, start: float) -> tuple[Motion, NDArray[np.intp], Array]:
        """Return motion, indices and s, with `_FINER` steps for each of the motor; a reversal counts as a rest."""
        index = np.arange(len(motion)) * _FINER
        every = np.arange(index[-1] + 1) / _FINER
        columns = (motion.time_s, motion.depth_mm, motion.velocity_mm_s, motion.angle_rad)
        time, depth, velocity, angle = (np.interp(every, np.arange(len(motion)), column) for column in columns)
        way = np.sign(velocity)
        before = np.repeat(motion.direction[:-1], _FINER)
        direction = np.where(way == 0, np.append(before, motion.direction[-1]), way)
        finer = Motion(time, depth, velocity, direction, angle)
        travel = _travels(velocity.tobytes(), time.tobytes(), start)
        moved = self._moved(finer, self.behind(travel, finer), self.behind_rate(travel, finer))
        return moved, index, travel[index]


@lru_cache(maxsize=64)
def _played(
    velocity_mm_s: bytes, time_s: bytes, size: float, start: float
) -> tuple[Array, Array, Array, NDArray[np.intp]]:
    """Return times, velocities of the needle, p, and the indices of the given samples, as read-only arrays.

    Added are the times at which the motor reverses, and twice the times at which it has crossed the gap: with velocity
    0 and, `_JUMP_S` later, with that of the motor. Velocities and times are byte strings, for the cache.
    """
    velocity, time = np.frombuffer(velocity_mm_s).tolist(), np.frombuffer(time_s).tolist()
    pulls = start <= -size
    free = not (start >= 0.0 and velocity[0] > 0) and not (pulls and velocity[0] < 0)
    nodes = [(time[0], 0.0 if free else velocity[0], start)]
    index, behind = [0], start
    for first, last, begin, end in zip(velocity[:-1], velocity[1:], time[:-1], time[1:], strict=True):
        turn = begin + (end - begin) * first / (first - last) if first * last < 0 else None
        pieces = [(first, last, begin, end)] if turn is None else [(first, 0.0, begin, turn), (0.0, last, turn, end)]
        for a, b, since, until in pieces:
            way = (a + b) / 2 * (until - since)
            room = -behind if way > 0 else behind + size
            if abs(way) <= room or way == 0:
                behind += way
                nodes.append((until, 0.0, behind))
            elif room <= 0:
                nodes.append((until, b, behind))
            else:
                low, high = abs(a), abs(b)
                rise = (high - low) / (until - since)
                crossed = 2 * room / (low + math.sqrt(max(low * low + 2 * rise * room, 0.0)))
                at, speed = min(since + crossed, until - 2 * _JUMP_S), math.copysign(low + rise * crossed, way)
                behind = 0.0 if way > 0 else -size
                nodes.append((at, 0.0, behind))
                nodes += [(at + _JUMP_S, speed, behind), (until, b, behind)]
        index.append(len(nodes) - 1)
    times, speeds, places = (np.array(array) for array in zip(*nodes, strict=True))
    indices = np.array(index, np.intp)
    for each in (times, speeds, places, indices):
        each.flags.writeable = False
    return times, speeds, places, indices


@lru_cache(maxsize=16)
def _travels(velocity_mm_s: bytes, time_s: bytes, start: float) -> Array:
    """Return the travel since the last rest, shape (samples,), read-only; byte strings, for the cache."""
    velocity, time = np.frombuffer(velocity_mm_s), np.frombuffer(time_s)
    steps = (np.abs(velocity[1:] + velocity[:-1]) / 2 * np.diff(time)).tolist()
    turns = (velocity[1:] * velocity[:-1] < 0).tolist()
    rests = (np.abs(velocity[1:]) < _REST_MM_S).tolist()
    travel, reached = start, [start]
    for step, turn, rest in zip(steps, turns, rests, strict=True):
        travel = 0.0 if rest else step if turn else travel + step
        reached.append(travel)
    travels = np.array(reached)
    travels.flags.writeable = False
    return travels
