"""Torsional lag: the tip turns less than the base, because the tissue holds the shaft.

The tissue resists rotation with a Coulomb torque per length, tau (N mm/mm), over the inserted length L2; the needle, of
torsional stiffness GJ (N mm^2), twists over that and over the length L1 outside. While all of the shaft slips, the tip
is behind the base by::

    lag = tau L2 (L1 + L2 / 2) / GJ

and after a reversal it stands still until the base has gone back by twice that: a play of half-width `lag`. So the tip
reaches an angle, and the base stands at the same angle, if the base goes beyond it by the lag and then back by the lag.
The thesis' largest lag, 4.22 degrees for an 18 gauge needle, would need a torque some hundred times what its axial
friction suggests; it is a bound, not a prediction.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.signals import Array

__all__ = ["Torsion", "dragged"]


def dragged(tip_rad: float, base_rad: float, lag_rad: float) -> float:
    """Return where the tip goes from `tip_rad` when the base is at `base_rad`: a play of half-width `lag_rad`."""
    return min(max(tip_rad, base_rad - lag_rad), base_rad + lag_rad)


@dataclass(frozen=True)
class Torsion:
    """Torsional stiffness GJ of a needle (N mm^2) and the torque per length that tissue resists with (N mm/mm)."""

    stiffness_n_mm2: float
    torque_per_length_n: float

    def __post_init__(self) -> None:
        mistakes = []
        if not 0 < self.stiffness_n_mm2 < np.inf:
            mistakes.append(Mistake("stiffness_n_mm2", f"{self.stiffness_n_mm2:g}", "must be a number above 0"))
        if not 0 <= self.torque_per_length_n < np.inf:
            mistakes.append(Mistake("torque_per_length_n", f"{self.torque_per_length_n:g}", "must be at least 0"))
        if mistakes:
            raise ModelError(mistakes, "Torsion")

    def lag_rad(self, outside_mm: float, inserted_mm: float) -> float:
        """Return how far the tip is behind the base while the base turns. Raises ModelError for negative lengths."""
        if not (outside_mm >= 0 and inserted_mm >= 0):
            rule = "must be lengths, at least 0"
            raise ModelError(Mistake("outside_mm, inserted_mm", f"{outside_mm:g}, {inserted_mm:g}", rule), "Torsion")
        return self.torque_per_length_n * inserted_mm * (outside_mm + inserted_mm / 2) / self.stiffness_n_mm2

    def dead_zone_rad(self, outside_mm: float, inserted_mm: float) -> float:
        """Return how far the base turns back before the tip does: twice the lag."""
        return 2 * self.lag_rad(outside_mm, inserted_mm)

    def tip_angle_rad(
        self, base_rad: Array, outside_mm: float, inserted_mm: float, start_rad: float | None = None
    ) -> Array:
        """Return the angle of the tip for a history of the base, shape (samples,), at a fixed depth.

        `start_rad` is the angle of the tip before the first sample; by default that of the base there: untwisted.
        """
        lag = self.lag_rad(outside_mm, inserted_mm)
        base = np.asarray(base_rad, float)
        first = float(base[0]) if start_rad is None else start_rad
        behind = accumulate(base.tolist(), lambda tip, angle: dragged(tip, angle, lag), initial=first)
        return np.array(list(behind)[1:])

    def compensated_rad(self, start_rad: float, target_rad: float, outside_mm: float, inserted_mm: float) -> Array:
        """Return the turning points of the base that bring the tip to the target and the base there too, shape (3,).

        From the angle at which both stand, beyond the target by the lag, and back to the target.
        """
        lag = self.lag_rad(outside_mm, inserted_mm)
        beyond = target_rad + np.copysign(lag, target_rad - start_rad) if target_rad != start_rad else target_rad
        return np.array([start_rad, beyond, target_rad])
