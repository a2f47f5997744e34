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
"""

from __future__ import annotations

import math

from needleplan.models.path._torsion import Torsion

__all__ = ["TwistedShaft"]

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
