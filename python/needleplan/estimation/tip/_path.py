"""Which way the bevel looked along the channel that the tip has cut."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator
from typing import NamedTuple

__all__ = ["Channel", "Piece"]

_MERGED_MM = 0.02
"""Rolls that are closer along the path are one."""

_PIECE_MM = 0.5
"""While the bevel turns during the insertion, the direction in which it bends is averaged over so much."""

_SAME_RAD = 1e-3
_REJOIN_MM = 0.05
_REJOIN_RAD = 0.5
"""A needle drawn back by more than the one follows its channel again, unless it is turned by more than the other."""


class Piece(NamedTuple):
    """A part of the path: its length, the mean of (cos, sin) of the roll, how far it was turned where it begins.

    On the straight line before the surface `fresh` is false, and nothing bends.
    """

    length_mm: float
    cos: float
    sin: float
    turned_rad: float
    fresh: bool


class Channel:
    """The rolls at which the tip has cut its way, by the length of the path from the surface on."""

    def __init__(self, length_mm: float, roll_rad: float) -> None:
        self.length_mm = length_mm
        self.cut_mm = max(length_mm, 0.0)
        self._from = [0.0]
        self._rolls = [roll_rad]

    @property
    def last_roll_rad(self) -> float:
        """The roll at which the end of the channel was cut."""
        return self._rolls[-1]

    def move(self, length_mm: float, roll_rad: float) -> float | None:
        """Move the tip to a length, its bevel at a roll; return where it left the channel for a new one, if it did."""
        begin = self.length_mm
        left_at = None
        if length_mm > begin and 0 < begin < self.cut_mm - _REJOIN_MM:
            old = self._rolls[bisect_right(self._from, begin) - 1]
            if abs(math.remainder(roll_rad - old, 2 * math.pi)) > _REJOIN_RAD:
                keep = bisect_right(self._from, begin)
                del self._from[keep:], self._rolls[keep:]
                self.cut_mm = begin
                left_at = begin
        self.length_mm = length_mm
        if length_mm > self.cut_mm:
            if abs(roll_rad - self._rolls[-1]) > _SAME_RAD:
                self._turn(self.cut_mm, roll_rad)
            self.cut_mm = length_mm
        return left_at

    def pieces(self, begin_mm: float, end_mm: float) -> Iterator[Piece]:
        """Yield the path from one length to another, in its order; beyond its end as if it went on."""
        if begin_mm < 0:
            before = min(end_mm, 0.0) - begin_mm
            yield Piece(before, 0.0, 0.0, 0.0, fresh=False)
            begin_mm = 0.0
        if end_mm <= begin_mm:
            return
        number = bisect_right(self._from, begin_mm) - 1
        length = along = aside = turned = 0.0
        while begin_mm < end_mm:
            following = self._from[number + 1] if number + 1 < len(self._from) else math.inf
            part = min(following, end_mm) - begin_mm
            if length and length + part > _PIECE_MM:
                yield Piece(length, along / length, aside / length, turned, fresh=True)
                length = along = aside = turned = 0.0
            roll = self._rolls[number]
            length, along, aside = length + part, along + part * math.cos(roll), aside + part * math.sin(roll)
            if number and begin_mm == self._from[number]:
                turned += abs(roll - self._rolls[number - 1])
            begin_mm += part
            if following <= begin_mm:
                begin_mm = following
                number += 1
        yield Piece(length, along / length, aside / length, turned, fresh=True)

    def _turn(self, length_mm: float, roll_rad: float) -> None:
        if length_mm - self._from[-1] < _MERGED_MM:
            self._rolls[-1] = roll_rad
        else:
            self._from.append(length_mm)
            self._rolls.append(roll_rad)
