"""Twist of the shaft under Coulomb friction: slipping and stuck parts, torque at the base, and release by insertion.

States. T(s) is the torque (N mm) in the shaft at the distance s from the tip. T(0) = 0, and outside of the tissue
(s > L2) T is constant. With the torsional stiffness GJ (N mm2) and the length L1 outside, base and tip differ by
equation (1) of docs/explanation/mechanics.md::

    base - tip = (int_0^L2 T ds + L1 T(L2)) / GJ

Rotation. Friction gives at most the torque tau per length, |dT/ds| <= tau. A rotation of the base starts a slip front
at the surface, which moves towards the tip. Behind the front, from s = a to the surface, dT/ds = +tau or -tau; ahead of
it, T and all angles are unchanged: this part is stuck. The twist determines a. In a shaft without torque, for example,
base - tip = tau b (L1 + b/2) / GJ, with the slipping length b = L2 - a and the torque tau b at the base. If the front
reaches the tip, the whole shaft slips, and the tip follows at the lag of `Torsion`. T is piecewise linear, so each step
is the root of a quadratic equation; there is no grid.

Insertion. The shaft keeps T(s), because s moves with the shaft. If the needle is retracted, the freed part has no
friction, and the same fronts redistribute its torque.

Release. Friction opposes the direction of sliding. While the needle moves by dx along its axis, a surface point that
rotates by dphi at the radius r feels the torque tau r dphi / sqrt(dx^2 + (r dphi)^2) per length, however small. The
twist therefore diffuses out of the shaft, GJ d2phi/ds2 = tau r dphi/dx. `Torsion.release_mm` is the length over which
its slowest mode falls to 1/e, equation (2); it is about r times the lag, a fraction of a millimetre. T decays by this
factor.

A static friction above the kinetic one changes nothing here: at the front of a continuous shaft, it acts on a length of
zero. The tip sticks and slips because the front reaches it late. Lags above 45 degrees at 100 mm are measured in some
phantoms (K. B. Reed, A. M. Okamura, N. J. Cowan, "Modeling and control of needles with torsional friction", IEEE Trans.
Biomed. Eng., abstract). That isotropic friction acts in tissue, and so the release, is an assumption.

Torsional lag: the tip rotates less than the base, because the tissue resists the rotation of the shaft.

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

import math
from dataclasses import dataclass

import numpy as np

from needleplan.config import ConfigTable, Number, ruled
from needleplan.errors import Mistake, ModelError
from needleplan.signals import Array

__all__ = ["Torsion", "TwistedShaft", "dragged"]


def dragged(tip_rad: float, base_rad: float, lag_rad: float) -> float:
    """Return the angle of the tip (rad) after the base has moved to `base_rad`.

    The tip stays at `tip_rad` unless it would lag by more than `lag_rad`; then it follows the base at this lag.
    """
    return min(max(tip_rad, base_rad - lag_rad), base_rad + lag_rad)


@dataclass(frozen=True)
class Torsion(ConfigTable, error=ModelError):
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

    stiffness_n_mm2: float = ruled(Number("N mm2", above=0))
    torque_per_length_n: float = ruled(Number("N", at_least=0))

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


# Twist (rad) below which a difference between base and tip causes no slip; bounds the number of corners of T(s).
_LEAST_RAD = 1e-8
# Distance (mm) within which insertion merges corners of T(s) that the chatter of a servo has made.
_MERGED_MM = 0.2


class TwistedShaft:
    """A shaft that twists as the module docstring describes, initially without torque.

    - `tip_rad`: angle of the tip (rad)
    - `torque_n_mm`: torque at the base (N mm), positive if the base is ahead of the tip
    - `stuck_mm`: length from the tip that did not slip in the last rotation
    """

    def __init__(self, torsion: Torsion, length_mm: float, roll_rad: float = 0.0, release_mm: float = 0.0) -> None:
        self.tip_rad: float = roll_rad
        self.stuck_mm: float = 0.0
        self._torsion, self._length_mm, self._release_mm = torsion, length_mm, release_mm
        self._last = (roll_rad, 0.0)
        # Distances from the tip and torques at the corners of T(s); the last corner is at the surface.
        self._places, self._torques = [0.0], [0.0]
        # Integrals of T from the tip to the first corners; `_integrals` computes the missing ones.
        self._sums = [0.0]

    @property
    def torque_n_mm(self) -> float:
        """Torque at the base (N mm)."""
        return self._torques[-1]

    def step(self, base_rad: float, inserted_mm: float) -> float:
        """Insert the needle to a length, then rotate its base to an angle, and return the angle of the tip (rad).

        The insertion moves the surface along the shaft and releases a part of the torque: the tip turns by the twist
        that is lost. The rotation lets a slip front run from the surface towards the tip. Outside of the tissue or
        without friction, the tip has the angle of the base.
        """
        if (base_rad, inserted_mm) == self._last:
            return self.tip_rad
        last_inserted_mm = self._last[1]
        self._last = (base_rad, inserted_mm)
        if inserted_mm <= 0 or not self._torsion.torque_per_length_n:
            self._places, self._torques, self._sums = [0.0], [0.0], [0.0]
            self.tip_rad = base_rad
            return base_rad
        if inserted_mm != last_inserted_mm:
            self._move_surface(inserted_mm)
            # The integrals at the last two corners, which may be new, must be computed again.
            del self._sums[max(len(self._places) - 2, 1) :]
            if self._release_mm:
                kept = math.exp(-abs(inserted_mm - last_inserted_mm) / self._release_mm)
                twist = self._twist()
                self._torques, self._sums = [kept * torque for torque in self._torques], [0.0]
                self.tip_rad += twist - self._twist()
        self._slip(base_rad)
        return self.tip_rad

    def _move_surface(self, inserted_mm: float) -> None:
        """Move the last corner of T(s), which is at the surface, to a new inserted length."""
        places, torques = self._places, self._torques
        while len(places) > 1 and places[-1] >= inserted_mm:
            place, torque = places.pop(), torques.pop()
            if places[-1] < inserted_mm:
                share = (inserted_mm - places[-1]) / (place - places[-1])
                torques.append(torques[-1] + share * (torque - torques[-1]))
                places.append(inserted_mm)
                return
        if len(places) > 1 and torques[-1] == torques[-2]:
            places[-1] = inserted_mm
            if len(places) > 3 and places[-2] - places[-4] < _MERGED_MM:
                del places[-3], torques[-3]
        else:
            places.append(inserted_mm)
            torques.append(torques[-1])

    def _integrals(self) -> list[float]:
        """Return the integral of T from the tip to each corner."""
        places, torques, sums = self._places, self._torques, self._sums
        for j in range(len(sums), len(places)):
            sums.append(sums[-1] + (places[j] - places[j - 1]) * (torques[j] + torques[j - 1]) / 2)
        return sums

    def _twist(self) -> float:
        """Return the angle (rad) between base and tip, by equation (1)."""
        outside = self._length_mm - self._places[-1]
        return (self._integrals()[-1] + outside * self._torques[-1]) / self._torsion.stiffness_n_mm2

    def _slip(self, base_rad: float) -> None:
        """Let a slip front run from the surface until the torque gives the twist between `base_rad` and the tip."""
        places, torques, sums = self._places, self._torques, self._integrals()
        length, tau = self._length_mm, self._torsion.torque_per_length_n
        surface = places[-1]
        wanted = (base_rad - self.tip_rad) * self._torsion.stiffness_n_mm2
        rest = wanted - sums[-1] - (length - surface) * torques[-1]
        if abs(rest) <= _LEAST_RAD * self._torsion.stiffness_n_mm2:
            return
        slope = math.copysign(tau, rest)
        for j in range(len(places) - 2, -1, -1):
            behind = surface - places[j]
            # Torque integral with the front at corner j; `over` is its excess over the wanted integral.
            at_corner = sums[j] + torques[j] * (length - places[j]) + slope * behind * (length - surface + behind / 2)
            over = (at_corner - wanted) * math.copysign(1.0, rest)
            if over < 0:
                continue
            old = (torques[j + 1] - torques[j]) / (places[j + 1] - places[j])
            arm = length - places[j]
            root = arm * arm - 2 * (wanted - at_corner) / (old - slope) if old != slope else 0.0
            front = places[j] + min(max(arm - math.sqrt(max(root, 0.0)), 0.0), places[j + 1] - places[j])
            torque = torques[j] + old * (front - places[j])
            del places[j + 1 :], torques[j + 1 :], sums[j + 1 :]
            if front > places[-1]:
                places.append(front)
                torques.append(torque)
            if surface > front:
                places.append(surface)
                torques.append(torque + slope * (surface - front))
            self.stuck_mm = front
            return
        self._places, self._torques, self._sums = [0.0, surface], [0.0, slope * surface], [0.0]
        self.stuck_mm = 0.0
        self.tip_rad = base_rad - math.copysign(self._torsion.lag_rad(length - surface, surface), slope)
