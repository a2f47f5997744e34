"""Trapezoidal velocity profiles from any state of motion: what a drive makes of a command while it moves.

From rest this is `signals.lspb` with a blend of velocity / acceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["Trapezoid"]

_INSTANT_S = 1e-12


@dataclass(frozen=True)
class _Piece:
    """Constant acceleration from `begin_s` on."""

    begin_s: float
    position: float
    velocity: float
    acceleration: float


class Trapezoid:
    """A motion of pieces of constant acceleration that ends at rest; lengths in any one unit."""

    def __init__(self, begin_s: float, position: float, velocity: float = 0.0) -> None:
        self._pieces = [_Piece(begin_s, position, velocity, 0.0)]
        self._end_s = begin_s
        self._at = 0

    @classmethod
    def rest(cls, begin_s: float, position: float) -> Trapezoid:
        """Return no motion at all."""
        return cls(begin_s, position)

    @classmethod
    def to(
        cls, goal: float, top_velocity: float, acceleration: float, *, begin_s: float, position: float, velocity: float
    ) -> Trapezoid:
        """Go to `goal` at `top_velocity` (positive), from a position and velocity; turn round where that must be."""
        made = cls(begin_s, position, velocity)
        stops_at = position + velocity * abs(velocity) / (2 * acceleration)
        sign = math.copysign(1.0, goal - stops_at)
        peak = sign * min(top_velocity, math.sqrt(acceleration * abs(goal - position) + velocity**2 / 2))
        if velocity * sign < 0:
            # It first runs on against its way; what it then has to go is counted from where it stops.
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
        """Come to rest as fast as can be."""
        made = cls(begin_s, position, velocity)
        made._pieces = []
        made._add(abs(velocity) / acceleration, position, velocity, -math.copysign(acceleration, velocity))
        stops_at = position + velocity * abs(velocity) / (2 * acceleration)
        made._pieces.append(_Piece(made._end_s, stops_at, 0.0, 0.0))
        return made

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return position, velocity and acceleration; times must not go back."""
        pieces = self._pieces
        while self._at + 1 < len(pieces) and time_s >= pieces[self._at + 1].begin_s - _INSTANT_S:
            self._at += 1
        piece = pieces[self._at]
        since = time_s - piece.begin_s
        velocity = piece.velocity + piece.acceleration * since
        return piece.position + (piece.velocity + velocity) / 2 * since, velocity, piece.acceleration

    @property
    def end_s(self) -> float:
        """When it comes to rest."""
        return self._end_s

    def _add(self, duration_s: float, position: float, velocity: float, acceleration: float) -> None:
        if duration_s > _INSTANT_S:
            self._pieces.append(_Piece(self._end_s, position, velocity, acceleration))
            self._end_s += duration_s
