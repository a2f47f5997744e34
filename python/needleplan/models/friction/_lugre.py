"""Friction with bristles: Model II (lumped) and Models III-A and III-B (averaged over the patch).

The state is the mean bending z (mm) of the bristles, weighted with the normal force (thesis, (3.11); equations (1) and
(2) of docs/explanation/friction.md)::

    z' = v - sigma0 |v| z / g(v) + beta v z
    F  = Fn(L) (sigma0 z + sigma1 z' + sigma2 v)

The equation is not stiff in mm and s: with the published parameters sigma0 |v|/g is at most 31 1/s. Outside of the
tissue the bristles are straight.

**The term beta.** Bristles are carried along the shaft with the velocity v. With the bending z = psi(zeta) phi(t) and
psi = zeta^lambda, integration by parts gives::

    beta = [ int_0^L psi fn' dzeta - psi(L) fn(L) ] / int_0^L psi fn dzeta

**Corrections to the print.** (3.12) divides its last term by Fn; the divisor must be Fn z. (3.16), for the right
trapezoid, omits the end term although fn(L) = f is not zero there. The beta of (3.16) is therefore almost zero (5e-10
to 2e-3 per mm at L = 76 mm) instead of -0.017 to -0.079 per mm. (3.17), for the isosceles trapezoid, is right.

**A limit of the ansatz.** The partial differential equation gives a bending that is constant beyond the first g/sigma0
(0.03 to 0.5 mm) of the patch. This corresponds to lambda -> 0 and beta -> 0; no psi of the thesis has this form. See
`distributed`.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.models._base import LinearStateModel
from needleplan.models._parameter import constant, parameter
from needleplan.models.friction._base import Profile, StribeckFriction, choice
from needleplan.signals import Array, Motion

__all__ = ["AveragedLuGre", "Beta", "LuGre", "LumpedLuGre", "OutputForm", "beta_per_mm"]

# Shortest length of a patch, mm; bounds beta, which grows as 1/L.
_SHORTEST_MM = 1e-3


class Beta(StrEnum):
    """The transport term in the equation of the averaged LuGre model.

    Examples
    --------
    >>> from needleplan.models import Beta
    >>> [str(term) for term in Beta]
    ['transport', 'printed', 'absolute', 'tip']
    """

    TRANSPORT = "transport"
    """beta v: (3.17) for the isosceles trapezoid, (3.16) with its end term for the right one.

    The term lowers |F| on insertion and raises it on retraction, by 2 to 5 % each. On retraction the state is unstable
    if -beta > sigma0/g: for the isosceles profile and lambda = 5, below a length of 1.4 to 4.4 mm.
    """

    PRINTED = "printed"
    """beta v as printed: (3.16) without its end term for the right trapezoid, (3.17) for the isosceles one."""

    ABSOLUTE = "absolute"
    """beta |v|, for the isosceles trapezoid only: fresh bristles enter a patch of fixed length at its upstream end."""

    TIP = "tip"
    """beta v for a tip in the tissue (L' = v), so that fn changes with the patch (Leibniz's rule); 0 for lambda = 0."""


def beta_per_mm(profile: Profile, term: Beta, length_mm: Array, ramp_mm: float, exponent: float) -> Array:
    """Return beta (1/mm) for every inserted length in `length_mm`, in its shape; lengths below 1 um count as 1 um.

    `profile` must be RIGHT or ISOSCELES; `exponent` is lambda >= 0. ABSOLUTE has the beta of TRANSPORT.
    """
    length = np.maximum(np.asarray(length_mm, float), _SHORTEST_MM)
    # Each branch is evaluated for lengths in its own range only, to avoid powers of negative numbers.
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


# Decay rate of the bending outside of the tissue, 1/s; the bristles become straight within about one sample.
_FORGETTING_PER_S = 1e3


class OutputForm(StrEnum):
    """The output equation of the averaged LuGre model.

    Examples
    --------
    >>> from needleplan.models import OutputForm
    >>> [str(form) for form in OutputForm]
    ['consistent', 'printed']
    """

    CONSISTENT = "consistent"
    """F = Fn (sigma0 z + sigma1 z' + sigma2 v): (3.11), and (3.18) after integration by parts."""

    PRINTED = "printed"
    """(3.19): F = f (L - w) {(1 - sigma1 |v|/g) sigma0 z - sigma1 z' + (sigma1 + sigma2) v}.

    The printed equation has two errors. The integral of -sigma1 v dz/dzeta is sigma1 beta v Fn z and not -sigma1 z' Fn:
    as printed, the damping of the bristles cancels and leaves a force -sigma1 beta v z of one sign (53 to 222 mN at the
    largest velocity). And f (L - w) is Fn only for L >= 2w; it is negative for L < w. Tables 3.4 and 3.5 cannot result
    from this equation: a fit drives sigma1 to zero.
    """


@dataclass(frozen=True, kw_only=True)
class LuGre(StribeckFriction, LinearStateModel):
    """Abstract base class of friction with one bristle state, the mean bending in mm."""

    sigma1: float = parameter("s/mm", 1e-5, 1e3, "damping of the bristles")

    @abstractmethod
    def transport_per_s(self, motion: Motion) -> Array:
        """Return the transport term of z'/z (1/s), shape (...)."""

    def coefficients(self, motion: Motion) -> tuple[Array, Array]:
        """Return forcing (mm/s) and rate (1/s), shape (...) each. Outside of the tissue the bending decays fast."""
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
    """Model II, (3.13): one bristle for the whole patch, beta = 0.

    With the constant profile this is the published model, whose force does not depend on the inserted length. With
    another profile the normal force follows the length. Such a model predicts friction with the tip in the tissue: its
    error is 8 mN on data of Model III-B, compared with 60 to 74 mN for the published model.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import sinusoid
    >>> model = npl.models.LumpedLuGre(mu_c=0.73, sigma2=0.016, sigma0=1.3, sigma1=0.46, mu_s=0.034, alpha=0.09)
    >>> motion = sinusoid(offset_mm=126.0, amplitude_mm=25.0, frequency_hz=0.05, cycles=1.0)
    >>> run = npl.models.simulate(model, motion)
    >>> print(f"{run.output.max():.2f} N")
    0.51 N
    """

    name: ClassVar[str] = "lumped_lugre"

    def transport_per_s(self, motion: Motion) -> Array:
        """Return zero, shape (...)."""
        return np.zeros_like(np.asarray(motion.velocity_mm_s, float))


@dataclass(frozen=True, kw_only=True)
class AveragedLuGre(LuGre):
    """Models III-A (profile `RIGHT`) and III-B (profile `ISOSCELES`, the default): psi = zeta^exponent along the patch.

    `beta` and `form` select the printed equations or the corrected ones. The constructor also raises ModelError for
    another profile, for an unknown `beta` or `form`, and for a `beta` that does not apply to the profile.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> model = npl.models.AveragedLuGre(mu_c=0.79, sigma2=0.014, sigma0=1.2, sigma1=0.37, mu_s=0.033, alpha=0.09)
    >>> run = npl.models.simulate(model, insertion_cycles(50.0, 5.0))
    >>> print(f"{run.output.max():.2f} N")
    0.23 N
    """

    name: ClassVar[str] = "averaged_lugre"
    exponent: float = constant("", 0, 20, "lambda, exponent of the bending along the patch", default=5.0)
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
        """Return beta v (1/s), shape (...); beta |v| for `Beta.ABSOLUTE`."""
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
