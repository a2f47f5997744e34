"""Friction without memory: the benchmark of Karnopp's kind, and Model I."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models.friction.shaft import Friction, StribeckFriction
from needleplan.signals import Array, Motion

__all__ = ["Karnopp", "QuasiStatic"]


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
