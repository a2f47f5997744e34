"""The path that the tip cuts, which is the channel in which the shaft follows.

Lengths along the path begin at the surface. In fresh tissue the tip follows arcs with the local curvature, in the
direction of its bevel. When the needle is pulled back, the tip returns along its channel. When the needle is inserted
again, the tip follows the channel, unless the bevel has rolled by more than half a radian: then it cuts a new channel.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from typing import Any

import numpy as np

from needleplan.models import TipFrame

__all__ = ["RandomHeading", "TipPath3D"]

# distance (mm) between stored frames of the channel
_SPACING_MM = 0.05
# roll (rad) of the bevel since the channel was cut, above which the tip cuts a new channel
_REJOIN_RAD = 0.5


class RandomHeading:
    """Random curvature that is white noise along the path, so the heading is a random walk.

    The path is divided into cells of 0.25 mm, each with its own curvatures along the normal and the binormal, whose
    headings have the standard deviations `sd_rad_sqrt_mm` after 1 mm. The curvatures depend
    only on the seed and the cell, not on the speed or on the ticks of the servo.
    """

    CELL_MM = 0.25

    def __init__(self, sd_rad_sqrt_mm: tuple[float, float], random: np.random.Generator) -> None:
        self._sd = np.array(sd_rad_sqrt_mm) / math.sqrt(self.CELL_MM)
        self._random = random
        self._cells: list[tuple[float, float]] = []

    def at(self, length_mm: float) -> tuple[float, float, float]:
        """Return the two curvatures (1/mm) at a path length, and the path length (mm) up to which they are constant."""
        if not self._sd.any():
            return 0.0, 0.0, math.inf
        cell = int(length_mm / self.CELL_MM)
        while cell >= len(self._cells):
            self._cells += (self._sd * self._random.standard_normal((64, 2))).tolist()
        n, b = self._cells[cell]
        return n, b, (cell + 1) * self.CELL_MM


class TipPath3D:
    """Path of the tip in tissue at rest, from the surface on.

    `bend` returns the curvature (1/mm) that the bevel causes at a frame. `aside` returns, for a frame and a roll, the
    additional curvatures along the normal n and the binormal b of the frame that do not depend on the bevel. `guide`
    is the frame of the guide on the surface, from which the path may start at an angle; None: that of the start.
    """

    def __init__(
        self,
        start: TipFrame,
        bend: Callable[[TipFrame], float],
        noise: RandomHeading,
        aside: Callable[[TipFrame, float], tuple[float, float]] | None = None,
        guide: TipFrame | None = None,
    ) -> None:
        self._bend = bend
        self._aside = aside
        self._noise = noise
        self._guide = guide
        self._length_mm = 0.0
        self.begin(start)

    def begin(self, start: TipFrame) -> None:
        """Discard the path, and begin a new path at a frame on the surface."""
        self.start = self._newest = start
        self._lengths, self._frames, self._bends, self._rolls = [0.0], [start], [(0.0, 0.0)], [0.0]
        self._cut_mm = 0.0

    @property
    def cut_mm(self) -> float:
        """Length (mm) of the channel."""
        return self._cut_mm

    def step(self, length_mm: float, roll_rad: float) -> bool:
        """Move the tip to a path length with a roll, and return whether it left its channel to cut a new one."""
        moved = length_mm - self._length_mm
        branched = False
        if moved > 0 and 0 < self._length_mm < self._cut_mm - _SPACING_MM:
            old = self._rolls[bisect_right(self._lengths, self._length_mm) - 1]
            if abs(math.remainder(roll_rad - old, 2 * math.pi)) > _REJOIN_RAD:
                self._forget_beyond(self._length_mm)
                branched = True
        self._length_mm = length_mm
        if length_mm > self._cut_mm:
            self._cut(length_mm, roll_rad)
        return branched

    def tip(self) -> TipFrame:
        """Return the frame of the tip."""
        return self._newest if self._length_mm == self._cut_mm else self.frame_at(self._length_mm)

    def frame_at(self, length_mm: float) -> TipFrame:
        """Return the frame at a path length; for negative lengths, on the line of the guide before the surface."""
        if length_mm < 0:
            return (self._guide or self.start).arc(0.0, 0.0, length_mm)
        if length_mm == 0:
            return self.start
        number = bisect_right(self._lengths, length_mm) - 1
        n, b = self._bends[number]
        return self._frames[number].arc(n, b, length_mm - self._lengths[number])

    def _cut(self, length_mm: float, roll_rad: float) -> None:
        # The step is divided where the random curvature changes, so that the path does not depend on the ticks.
        bend = self._bend(self._newest)
        across_n, across_b = bend * math.cos(roll_rad), bend * math.sin(roll_rad)
        if self._aside:
            aside = self._aside(self._newest, roll_rad)
            across_n, across_b = across_n + aside[0], across_b + aside[1]
        while self._cut_mm < length_mm:
            noise_n, noise_b, until_mm = self._noise.at(self._cut_mm)
            end_mm = min(until_mm, length_mm)
            n, b = across_n + noise_n, across_b + noise_b
            self._newest = self._newest.arc(n, b, end_mm - self._cut_mm)
            last = self._lengths[-1]
            if self._cut_mm == last:
                self._bends[-1] = (n, b)
            self._rolls[-1] = roll_rad
            self._cut_mm = end_mm
            if end_mm - last >= _SPACING_MM or end_mm == until_mm:
                self._lengths.append(end_mm)
                self._frames.append(self._newest)
                self._bends.append((n, b))
                self._rolls.append(roll_rad)

    def _forget_beyond(self, length_mm: float) -> None:
        self._newest = self.frame_at(length_mm)
        keep = bisect_right(self._lengths, length_mm)
        columns: tuple[list[Any], ...] = (self._lengths, self._frames, self._bends, self._rolls)
        for column in columns:
            del column[keep:]
        self._cut_mm = length_mm
        # The new channel begins here, not at the last stored frame.
        if length_mm > self._lengths[-1]:
            for column, value in zip(columns, (length_mm, self._newest, (0.0, 0.0), self._rolls[-1]), strict=True):
                column.append(value)
