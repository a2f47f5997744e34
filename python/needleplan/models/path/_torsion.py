"""Torsional lag: the tip rotates less than the base, because the tissue resists the rotation of the shaft.

The tissue exerts a Coulomb torque per length, tau (N mm/mm), on the inserted length L2. The needle with the torsional
stiffness GJ (N mm2) twists over L2 and over the length L1 outside. While the whole shaft slips, the tip lags behind the
base by::

    lag = tau L2 (L1 + L2 / 2) / GJ

After a reversal the tip stands still until the base has rotated back by twice the lag: a backlash of half-width `lag`.
To bring tip and base to the same angle, rotate the base beyond this angle by the lag and then back by the lag. The
largest lag of the thesis, 4.22 degrees for an 18 gauge needle, would need about a hundred times the torque that the
axial friction of this needle suggests. The value of the thesis is an upper bound and not a prediction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.errors import Mistake, ModelError
from needleplan.signals import Array

__all__ = ["Torsion", "dragged"]


def dragged(tip_rad: float, base_rad: float, lag_rad: float) -> float:
    """Return the angle of the tip (rad) after the base has moved to `base_rad`.

    The tip stays at `tip_rad` unless it would lag by more than `lag_rad`; then it follows the base at this lag.
    """
    return min(max(tip_rad, base_rad - lag_rad), base_rad + lag_rad)


@dataclass(frozen=True)
class Torsion(CallRepr):
    """Torsional lag between base and tip.

    The constructor raises ModelError unless the stiffness is positive and the torque is not negative.

    Parameters
    ----------
    stiffness_n_mm2 : float
        Torsional stiffness GJ of the needle.
    torque_per_length_n : float
        Torque per inserted length with which the tissue resists rotation (N mm/mm).

    Examples
    --------
    >>> from needleplan.models import Torsion
    >>> torsion = Torsion(stiffness_n_mm2=4000.0, torque_per_length_n=0.01)
    >>> round(torsion.lag_rad(outside_mm=100.0, inserted_mm=50.0), 6)
    0.015625
    """

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
        """Return the angle by which the tip lags behind the rotating base.

        Parameters
        ----------
        outside_mm, inserted_mm : float
            Length of the shaft outside of and inside the tissue.

        Returns
        -------
        float
            The lag.

        Raises
        ------
        ModelError
            If a length is negative.
        """
        if not (outside_mm >= 0 and inserted_mm >= 0):
            rule = "must be lengths, at least 0"
            raise ModelError(Mistake("outside_mm, inserted_mm", f"{outside_mm:g}, {inserted_mm:g}", rule), "Torsion")
        return self.torque_per_length_n * inserted_mm * (outside_mm + inserted_mm / 2) / self.stiffness_n_mm2

    def release_mm(self, radius_mm: float, outside_mm: float, inserted_mm: float) -> float:
        """Return the length of insertion over which an existing twist falls to 1/e if the friction is isotropic.

        While the needle slides along its axis, friction hardly resists a rotation: GJ d2phi/ds2 = tau r dphi/dx, with
        the insertion x, the angle phi at the distance s from the tip and the radius r of the shaft. The result is the
        decay length of the slowest mode, cos(k s) with k tan(k L2) = 1 / L1. That friction in tissue is isotropic is an
        assumption.

        Parameters
        ----------
        radius_mm : float
            Outer radius of the shaft.
        outside_mm, inserted_mm : float
            Length of the shaft outside of and inside the tissue.

        Returns
        -------
        float
            The length, about the radius times the lag.

        Raises
        ------
        ModelError
            If the radius or the inserted length is not positive, or the outer length is negative.

        Examples
        --------
        >>> from needleplan.models import Torsion
        >>> round(Torsion(15000.0, 0.05).release_mm(0.6, outside_mm=140.0, inserted_mm=60.0), 4)
        0.0193
        """
        from scipy.optimize import brentq

        if not (radius_mm > 0 and inserted_mm > 0 and outside_mm >= 0):
            value = f"{radius_mm:g}, {outside_mm:g}, {inserted_mm:g}"
            raise ModelError(
                Mistake("radius_mm, outside_mm, inserted_mm", value, "must be above 0, at least 0, above 0"), "Torsion"
            )
        angle = float(
            brentq(
                lambda each: outside_mm * each * np.sin(each) - inserted_mm * np.cos(each), 0.0, np.pi / 2, xtol=1e-14
            )
        )
        return self.torque_per_length_n * radius_mm / self.stiffness_n_mm2 * (inserted_mm / angle) ** 2

    def compensated_rad(self, start_rad: float, target_rad: float, outside_mm: float, inserted_mm: float) -> Array:
        """Return the angles of the base that bring tip and base to a target angle.

        Parameters
        ----------
        start_rad : float
            Angle of base and tip at the start.
        target_rad : float
            Target angle.
        outside_mm, inserted_mm : float
            Length of the shaft outside of and inside the tissue.

        Returns
        -------
        Array
            Start, overshoot by the lag, and target, shape (3,).
        """
        lag = self.lag_rad(outside_mm, inserted_mm)
        beyond = target_rad + np.copysign(lag, target_rad - start_rad) if target_rad != start_rad else target_rad
        return np.array([start_rad, beyond, target_rad])
