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

----

LuGre friction on tissue that gives way: Models II and III of chapter 3 under the tissue motion of chapter 4.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np

from needleplan.models._base import Channel, LinearStateModel, SelfIntegratingModel, constant, parameter
from needleplan.models.friction import AveragedLuGre, Beta, LuGre, LumpedLuGre, OutputForm, Profile, StribeckFriction
from needleplan.models.tissue._stepping import FrictionLaw, first_root, step_through
from needleplan.signals import Array, Motion

__all__ = ["AveragedOnTissue", "LuGreLaw", "LumpedOnTissue", "MovingTissue", "PointwiseLaw"]


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


@dataclass(frozen=True, kw_only=True)
class LumpedOnTissue(StribeckFriction, MovingTissue):
    """Model II on Kelvin-Voigt tissue: what is fitted instead of a slow observer."""

    name: ClassVar[str] = "lumped_lugre_on_tissue"
    sigma1: float = parameter("s/mm", 1e-5, 1e3, "damping of the bristles")

    def friction(self) -> LumpedLuGre:
        """Return Model II."""
        return LumpedLuGre(**{each.name: getattr(self, each.name) for each in fields(LumpedLuGre)})

    def law(self, motion: Motion) -> FrictionLaw:
        """Return the friction on plain numbers."""
        return LuGreLaw(self.friction(), motion)


@dataclass(frozen=True, kw_only=True)
class AveragedOnTissue(StribeckFriction, MovingTissue):
    """Models III-A and III-B on Kelvin-Voigt tissue; see `AveragedLuGre` for the choices."""

    name: ClassVar[str] = "averaged_lugre_on_tissue"
    sigma1: float = parameter("s/mm", 1e-5, 1e3, "damping of the bristles")
    exponent: float = constant("", 0, 20, "lambda: how bending grows along the patch", default=5.0)
    profile: Profile = Profile.ISOSCELES
    beta: Beta = Beta.TRANSPORT

    def friction(self) -> AveragedLuGre:
        """Return Model III."""
        chosen = {each.name: getattr(self, each.name) for each in fields(AveragedLuGre) if each.name != "form"}
        return AveragedLuGre(**chosen, form=OutputForm.CONSISTENT)

    def law(self, motion: Motion) -> FrictionLaw:
        """Return the friction on plain numbers."""
        return LuGreLaw(self.friction(), motion)


class LuGreLaw:
    """LuGre friction with the consistent output, one number at a time: what `PointwiseLaw` gives, 50 times as fast."""

    coefficients: Callable[[int, float], tuple[float, float]]
    force: Callable[[int, float, float, float], float]

    def __init__(self, friction: LuGre, motion: Motion) -> None:
        sigma0, sigma1, sigma2 = friction.sigma0, friction.sigma1, friction.sigma2
        mu_c, drop, alpha, gamma = friction.mu_c, friction.mu_s - friction.mu_c, friction.alpha, friction.gamma
        normal = friction.total_normal_force_n(motion).tolist()
        inside = (motion.depth_mm > 0).tolist()
        transport = [_transport(friction, motion, sign) for sign in (1.0, -1.0)]
        exp = math.exp

        def coefficients(sample: int, w: float) -> tuple[float, float]:  # noqa: ARG001
            speed = w if w > 0 else -w
            return w, sigma0 * speed / (mu_c + drop * exp(-alpha * speed))

        def general(sample: int, w: float) -> tuple[float, float]:
            if not inside[sample]:
                forcing, rate = friction.coefficients(motion[sample])
                return float(forcing), float(rate)
            speed = w if w > 0 else -w
            level = mu_c + drop * exp(-alpha * speed**gamma)
            return w, sigma0 * speed / level - transport[w < 0][sample] * speed

        def force(sample: int, w: float, bending: float, bending_rate: float) -> float:
            result: float = normal[sample] * (sigma0 * bending + sigma1 * bending_rate + sigma2 * w)
            return result

        plain = all(inside) and gamma == 1 and not any(map(any, transport))
        self.coefficients = coefficients if plain else general
        self.force = force


def _transport(friction: LuGre, motion: Motion, sign: float) -> list[float]:
    """Return what the transport along the patch adds to z'/z for a velocity of 1 mm/s in the direction of `sign`."""
    velocity = np.full(len(motion), sign)
    moved = Motion(motion.time_s, motion.depth_mm, velocity, velocity, motion.angle_rad)
    return [float(each) for each in friction.transport_per_s(moved)]
