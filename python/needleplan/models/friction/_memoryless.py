"""Friction without memory: the benchmark of Karnopp's kind, and Model I.

----

What of a measured axial force is not friction: inertia of the needle, and cutting at the tip (thesis, 3.4.2).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from needleplan.errors import Mistake, ModelError
from needleplan.models._simulate import simulate
from needleplan.models.friction._base import Friction, StribeckFriction
from needleplan.signals import Array, Motion, Record

__all__ = ["ForceParts", "Karnopp", "QuasiStatic", "cutting_force", "into_fresh_tissue"]


@dataclass(frozen=True, kw_only=True)
class Karnopp(Friction):
    """F = (sign(v) mu_c + sigma2 v) Fn: the benchmark of the thesis, linear in its parameters (after Okamura 2004).

    Karnopp's dead zone is left out, as a width was not published and a prescribed motion does not need one. At rest the
    friction keeps the sign of the last movement.
    """

    name: ClassVar[str] = "karnopp"

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return no state, shape (0,)."""
        return np.zeros(0)

    def derivative(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return no rates, shape (0,)."""
        return np.zeros_like(state)

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the friction (N), shape (...)."""
        ratio = self.mu_c * motion.direction + self.sigma2 * motion.velocity_mm_s
        return np.asarray(self.total_normal_force_n(motion) * ratio)


@dataclass(frozen=True, kw_only=True)
class QuasiStatic(StribeckFriction):
    """Model I, (3.9): the steady bending of bristles that are carried in at one end of the patch.

    F = {sign(v) g [1 - g/(sigma0 L) (1 - e^(-sigma0 L/g))] + sigma2 v} Fn. For L = 76 mm the bracket is above 0.99:
    sigma0 cannot be identified from such a patch. The steady bending (3.7) solves (3.6) only for v > 0; for v < 0 it is
    what transport with |v|, bristles entering at the other end, gives.
    """

    name: ClassVar[str] = "quasi_static"

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return no state, shape (0,)."""
        return np.zeros(0)

    def derivative(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return no rates, shape (0,)."""
        return np.zeros_like(state)

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the friction (N), shape (...)."""
        level = self.level(motion)
        lengths = self.sigma0 * self.inserted_mm(motion) / level
        share = np.where(lengths > 0, 1 + np.expm1(-lengths) / np.where(lengths > 0, lengths, 1.0), 0.0)
        ratio = motion.direction * level * share + self.sigma2 * motion.velocity_mm_s
        return np.asarray(self.total_normal_force_n(motion) * ratio)


_N_PER_KG_MM_S2 = 1e-3


@dataclass(frozen=True)
class ForceParts:
    """The parts of the axial force (N), shape (samples,) each; they add up to what was measured."""

    friction_n: Array
    inertia_n: Array
    cutting_n: Array


def cutting_force(record: Record, friction: Friction, mass_kg: float) -> ForceParts:
    """Return the cutting force of a trial: measured - friction - inertia.

    `mass_kg` is the needle with its holder beyond the sensor. The sensor pushes the mass as well as the needle through
    the tissue, so inertia is mass times acceleration in the direction of insertion (the thesis' F = Fz + m a has its
    sensor axis the other way round); at 0.05 Hz it is 0.1 mN. The friction is simulated from rest along the record's
    motion. Raises DataError without `force_n`, ModelError for a mass that is negative or no number.
    """
    if not 0 <= mass_kg < np.inf:
        raise ModelError(Mistake("mass_kg", str(mass_kg), "must be a number that is not negative"), "cutting_force")
    measured = record["force_n"]
    motion = record.motion()
    rubbed = simulate(friction, motion).output
    inertia = _N_PER_KG_MM_S2 * mass_kg * np.gradient(motion.velocity_mm_s, motion.time_s)
    return ForceParts(rubbed, inertia, measured - rubbed - inertia)


def into_fresh_tissue(motion: Motion, margin_mm: float = 0.0) -> NDArray[np.bool_]:
    """Return where the tip is deeper than ever before, less `margin_mm`, and moving in: where it cuts; bool (samples,).

    The first sample counts as reached before.
    """
    reached = np.concatenate([[motion.depth_mm[0]], np.maximum.accumulate(motion.depth_mm)[:-1]])
    return np.asarray((motion.depth_mm > reached - margin_mm) & (motion.velocity_mm_s > 0))
