"""Friction with bristles: Model II (lumped), Models III-A and III-B (averaged over the patch).

The state is the mean bending z (mm) of the bristles, weighted with the normal force (thesis, (3.11))::

    z' = v - sigma0 |v| z / g(v) + beta v z
    F  = Fn(L) (sigma0 z + sigma1 z' + sigma2 v)

Not stiff in mm and s: sigma0 |v|/g is at most 24 to 31 1/s for the published parameters. A needle outside of the tissue
has no bent bristles.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.models.base import LinearStateModel
from needleplan.models.friction.beta import Beta, beta_per_mm
from needleplan.models.friction.profile import Profile
from needleplan.models.friction.shaft import StribeckFriction, choice
from needleplan.models.parameter import constant, parameter
from needleplan.signals import Array, Motion

__all__ = ["AveragedLuGre", "LuGre", "LumpedLuGre", "OutputForm"]

_FORGETTING_PER_S = 1e3
"""Rate at which bending is forgotten outside of the tissue: within one sample."""


class OutputForm(StrEnum):
    """Which output equation the averaged model has."""

    CONSISTENT = "consistent"
    """F = Fn (sigma0 z + sigma1 z' + sigma2 v): (3.11), and what (3.18) is once its integral is done by parts."""

    PRINTED = "printed"
    """(3.19): F = f (L - w) {(1 - sigma1 |v|/g) sigma0 z - sigma1 z' + (sigma1 + sigma2) v}.

    Wrong twice. The integral of -sigma1 v dz/dzeta is sigma1 beta v Fn z and not -sigma1 z' Fn: as printed, the damping
    of the bristles cancels and a one-signed force -sigma1 beta v z is left (53 to 222 mN at full speed). And f (L - w)
    is Fn for L >= 2w only, negative for L < w. Tables 3.4 and 3.5 cannot have been made with it: a fit drives sigma1 to
    zero.
    """


@dataclass(frozen=True, kw_only=True)
class LuGre(StribeckFriction, LinearStateModel):
    """Friction whose bristles have one state, their mean bending in mm; abstract."""

    sigma1: float = parameter("s/mm", 1e-5, 1e3, "damping of the bristles")

    @abstractmethod
    def transport_per_s(self, motion: Motion) -> Array:
        """Return what the spread of the normal force adds to z'/z (1/s), shape (...)."""

    def coefficients(self, motion: Motion) -> tuple[Array, Array]:
        """Return forcing (mm/s) and rate (1/s), shape (...) each."""
        velocity = np.asarray(motion.velocity_mm_s, float)
        rate = self.sigma0 * np.abs(velocity) / self.level(motion) - self.transport_per_s(motion)
        inside = np.asarray(motion.depth_mm) > 0
        return np.where(inside, velocity, 0.0), np.where(inside, rate, _FORGETTING_PER_S)

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the friction (N), shape (...), for states of the shape (1, ...)."""
        bending = state[0]
        rate = self.derivative(state, motion)[0]
        ratio = self.sigma0 * bending + self.sigma1 * rate + self.sigma2 * motion.velocity_mm_s
        return np.asarray(self.total_normal_force_n(motion) * ratio)


@dataclass(frozen=True, kw_only=True)
class LumpedLuGre(LuGre):
    """Model II, (3.13): all bristles as one, beta = 0.

    With the constant profile it is the published model, which knows nothing of the inserted length; with any other
    profile the normal force follows the length, which is what predicts friction with the tip inside (8 mN beside 60 to
    74 mN where data come from Model III-B).
    """

    name: ClassVar[str] = "lumped_lugre"

    def transport_per_s(self, motion: Motion) -> Array:
        """Return zero."""
        return np.zeros_like(np.asarray(motion.velocity_mm_s, float))


@dataclass(frozen=True, kw_only=True)
class AveragedLuGre(LuGre):
    """Models III-A (profile `RIGHT`) and III-B (`ISOSCELES`, the default): psi = zeta^exponent along the patch.

    `beta` and `form` choose between the equations that were printed and what they should be. Raises ModelError for a
    profile or a term that does not go with it.
    """

    name: ClassVar[str] = "averaged_lugre"
    exponent: float = constant("", 0, 20, "lambda: how bending grows along the patch", default=5.0)
    profile: Profile = Profile.ISOSCELES
    beta: Beta = Beta.TRANSPORT
    form: OutputForm = OutputForm.CONSISTENT

    def __post_init__(self) -> None:
        super().__post_init__()
        source = type(self).__name__
        object.__setattr__(self, "beta", choice(Beta, self.beta, "beta", source))
        object.__setattr__(self, "form", choice(OutputForm, self.form, "form", source))
        if self.profile not in (Profile.RIGHT, Profile.ISOSCELES):
            raise ModelError(Mistake("profile", self.profile, "must be right or isosceles"), source)
        if self.beta is Beta.ABSOLUTE and self.profile is Profile.RIGHT:
            rule = "needs the isosceles profile: the right one is not its own mirror image"
            raise ModelError(Mistake("beta", self.beta, rule), source)

    def transport_per_s(self, motion: Motion) -> Array:
        """Return beta v, or beta |v|."""
        velocity = np.asarray(motion.velocity_mm_s, float)
        term = Beta.TRANSPORT if self.beta is Beta.ABSOLUTE else self.beta
        beta = beta_per_mm(self.profile, term, self.inserted_mm(motion), self.ramp_mm, self.exponent)
        return np.asarray(beta * (np.abs(velocity) if self.beta is Beta.ABSOLUTE else velocity))

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the friction (N), shape (...), for states of the shape (1, ...)."""
        if self.form is OutputForm.CONSISTENT:
            return super().output(state, motion)
        velocity = np.asarray(motion.velocity_mm_s, float)
        rate = self.derivative(state, motion)[0]
        bent = (1 - self.sigma1 * np.abs(velocity) / self.level(motion)) * self.sigma0 * state[0]
        ratio = bent - self.sigma1 * rate + (self.sigma1 + self.sigma2) * velocity
        return np.asarray(self.plateau_n_mm() * (self.inserted_mm(motion) - self.ramp_mm) * ratio)
