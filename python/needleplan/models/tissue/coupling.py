"""Friction on tissue that gives way: a needle, the tissue around it, and the springs that hold that tissue.

The needle moves with the velocity v, the tissue with s = u'. What rubs is the difference w = v - s, and the friction
that the needle feels is what moves the tissue (Kelvin and Voigt)::

    z' = forcing(w) - rate(w) z          the bristle of any friction model with one linear state
    u' = s
    m s' = F(z, w) - c s - k u

The mass m of the tissue that moves is a few grams and its inertia below a millinewton. It is there because without it
the balance F = k u + c s is no equation for s where friction falls with the speed faster than damping rises: with a
bent bristle and mu_s below mu_c that happens at every reversal, and the balance then has three roots. With a mass,
however small, the tissue goes from its present speed to the first root in the direction of the force: that is which
root is taken here. Where friction falls with the speed by itself (mu_c below mu_s) needle and tissue stick and slip in
earnest; the jumps then take less than a sample, and single samples of the force are not to be trusted.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needleplan.models.base import Channel, LinearStateModel, SelfIntegratingModel
from needleplan.models.parameter import constant, parameter
from needleplan.models.tissue.stepping import FrictionLaw, first_root, step_through
from needleplan.signals import Array, Motion

__all__ = ["MovingTissue", "PointwiseLaw"]


@dataclass(frozen=True, kw_only=True)
class MovingTissue(SelfIntegratingModel):
    """Friction on tissue that is held by a spring and a damper; abstract. State: bristle, u (mm), u' (mm/s).

    The force on the needle is the friction. A member says what rubs (`friction`), and may give a faster `law`.
    """

    channel: ClassVar[Channel] = Channel.FORCE
    stiffness: float = parameter("N/mm", 1e-4, 1e3, "k: of what holds the tissue")
    damping: float = parameter("N s/mm", 1e-6, 1e2, "c: of what holds the tissue")
    mass: float = constant("N s^2/mm", 1e-9, 1e-3, "m: of the tissue that moves; 1e-6 is a gram", default=1e-6)

    @abstractmethod
    def friction(self) -> LinearStateModel:
        """Return what rubs; the velocity in its motion is that of the needle relative to the tissue."""

    def law(self, motion: Motion) -> FrictionLaw:
        """Return the friction on plain numbers: here by way of `friction`, for any of them, slowly."""
        return PointwiseLaw(self.friction(), motion)

    def relative(self, state: Array, motion: Motion) -> Motion:
        """Return the motion of the needle relative to the tissue; the inserted depth is taken as that of the needle."""
        velocity = np.asarray(motion.velocity_mm_s - state[2])
        return Motion(motion.time_s, motion.depth_mm, velocity, np.sign(velocity), motion.angle_rad)

    def initial_state(self, motion: Motion) -> Array:
        """Return straight bristles and tissue where it rests, with the speed that balances the friction, shape (3,)."""
        law = self.law(motion)
        velocity = float(np.atleast_1d(motion.velocity_mm_s)[0])

        def balance(speed: float) -> float:
            forcing, _ = law.coefficients(0, velocity - speed)
            return self.damping * speed - law.force(0, velocity - speed, 0.0, forcing)

        return np.array([0.0, 0.0, first_root(balance, 0.0)])

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of the three states, shape (3, ...)."""
        relative, friction = self.relative(state, motion), self.friction()
        forcing, rate = friction.coefficients(relative)
        force = friction.output(state[:1], relative)
        pull = force - self.damping * state[2] - self.stiffness * state[1]
        return np.array([forcing - rate * state[0], state[2], pull / self.mass])

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the friction (N), shape (...)."""
        return self.friction().output(state[:1], self.relative(state, motion))

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states, shape (3, samples); NaN from where they grow without bound."""
        return step_through(self.law(motion), self.stiffness, self.damping, self.mass, motion, start)


class PointwiseLaw:
    """Any friction model with one linear state, one number at a time: slow."""

    def __init__(self, friction: LinearStateModel, motion: Motion) -> None:
        self._friction, self._motion = friction, motion

    def coefficients(self, sample: int, w_mm_s: float) -> tuple[float, float]:
        """Return forcing and rate of the bristle."""
        forcing, rate = self._friction.coefficients(self._at(sample, w_mm_s))
        return float(forcing), float(rate)

    def force(self, sample: int, w_mm_s: float, bending: float, bending_rate: float) -> float:  # noqa: ARG002
        """Return the friction on the needle (N)."""
        return float(self._friction.output(np.array([bending]), self._at(sample, w_mm_s)))

    def _at(self, sample: int, w_mm_s: float) -> Motion:
        needle, velocity = self._motion, np.asarray(w_mm_s)
        return Motion(
            needle.time_s[sample], needle.depth_mm[sample], velocity, np.sign(velocity), needle.angle_rad[sample]
        )
