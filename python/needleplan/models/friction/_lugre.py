"""The term beta of the averaged LuGre model: what the spread of the normal force does to the mean bristle.

For bristles that are carried along the shaft with the speed v, whose bending is z = psi(zeta) phi(t), psi =
zeta^lambda, the mean bending weighted with fn obeys (thesis, (3.11)) z' = v - sigma0 |v| z/g + beta v z, and by parts

    beta = [ int_0^L psi fn' dzeta - psi(L) fn(L) ] / int_0^L psi fn dzeta.

What was wrong in print: (3.12) divides its last term by Fn where it has to be Fn z; (3.16), the right trapezoid, leaves
that term out although fn(L) = f is not zero there, and so becomes practically zero (positive, 5e-10 to 2e-3 per mm at
L = 76 mm) where it should be -0.017 to -0.079. (3.17), the isosceles one, is right.

What no choice of psi mends: the partial differential equation gives a bending that is flat beyond the first g/sigma0
(0.03 to 0.5 mm), which is lambda -> 0 and beta -> 0. See `needleplan.models.friction.distributed`.

----

Friction with bristles: Model II (lumped), Models III-A and III-B (averaged over the patch).

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
from needleplan.models._base import LinearStateModel, constant, parameter
from needleplan.models.friction._base import Profile, StribeckFriction, choice
from needleplan.signals import Array, Motion

__all__ = ["AveragedLuGre", "Beta", "LuGre", "LumpedLuGre", "OutputForm", "beta_per_mm"]

_SHORTEST_MM = 1e-3
"""Shorter patches count as this long: beta grows as 1/L."""


class Beta(StrEnum):
    """Which term stands in the equation."""

    TRANSPORT = "transport"
    """beta v: (3.17) for the isosceles trapezoid, (3.16) with its end term for the right one.

    It lowers |F| on insertion and raises it on retraction, by 2 to 5 % each, and makes the bristle unstable on
    retraction where -beta > sigma0/g (isosceles, lambda 5: below a length of 1.4 to 4.4 mm).
    """

    PRINTED = "printed"
    """beta v as printed: (3.16) without its end term for the right trapezoid; (3.17) for the isosceles one."""

    ABSOLUTE = "absolute"
    """beta |v|, isosceles only: a patch of fixed length that fresh bristles enter at whichever end is upstream."""

    TIP = "tip"
    """beta v for a tip inside of the tissue, L' = v, where fn grows with the patch (Leibniz's rule); 0 for lambda 0."""


def beta_per_mm(profile: Profile, term: Beta, length_mm: Array, ramp_mm: float, exponent: float) -> Array:
    """Return beta (1/mm) for inserted lengths, any shape; `profile` is RIGHT or ISOSCELES, `exponent` lambda >= 0."""
    length = np.maximum(np.asarray(length_mm, float), _SHORTEST_MM)
    # Each branch is evaluated on lengths of its own side only, so that no power of a negative number appears.
    if profile is Profile.RIGHT:
        short, long = np.minimum(length, ramp_mm), np.maximum(length, ramp_mm)
        triangle, trapezoid = _right(term, short, long, ramp_mm, exponent)
        return np.where(length <= ramp_mm, triangle, trapezoid)
    short, long = np.minimum(length, 2 * ramp_mm), np.maximum(length, 2 * ramp_mm)
    triangle, trapezoid = _isosceles(term, short, long, ramp_mm, exponent)
    return np.where(length <= 2 * ramp_mm, triangle, trapezoid)


def _right(term: Beta, short: Array, long: Array, w: float, lam: float) -> tuple[Array, Array]:
    below = (lam + 2) * long ** (lam + 1) - w ** (lam + 1)
    rising = (lam + 2) / ((lam + 1) * short), (lam + 2) * w**lam / below
    if term is Beta.PRINTED:
        return rising
    if term is Beta.TIP:
        return rising[0] - 2 / short, rising[1] - 1 / (long - w / 2)
    end = (lam + 2) / short, (lam + 2) * (lam + 1) * long**lam / below
    return rising[0] - end[0], rising[1] - end[1]


def _isosceles(term: Beta, short: Array, long: Array, w: float, lam: float) -> tuple[Array, Array]:
    power = 2 ** (lam + 1)
    weight = long ** (lam + 2) - (long - w) ** (lam + 2) - w ** (lam + 2)
    if term is Beta.TIP:
        triangle = ((lam + 2) / (power - 1) - 2) / short
        return triangle, (lam + 2) * w ** (lam + 1) / weight - 1 / (long - w)
    triangle = -2 * (lam + 2) * (2**lam - 1) / (power - 1) / short
    return triangle, (lam + 2) * ((long - w) ** (lam + 1) + w ** (lam + 1) - long ** (lam + 1)) / weight


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
