"""Axial force as a function of depth: LuGre friction driven by the inserted length l (thesis, eqs. 2.1 to 2.4).

Equations (1) and (2) of docs/explanation/force.md::

    z' = l (beta - sigma0 z / g(l)),        g(l) = f1 + f2 exp(-alpha l)
    f  = sigma0 z l + sign(l') l { sigma1 exp(-alpha l) (beta - sigma0 z / g(l)) + sigma2 }

**Corrections to the print.** Eq. 2.1 prints sign(l) instead of sign(l'). With sign(l), which is always +1, the force of
a retraction would not become negative, in contradiction to Figs. 2.7 and 2.9. The first term is sigma0 z l; with sigma0
z, the statements of the text about sigma0 and sigma1 would not hold.

At rest the sign keeps its last value (`Motion.direction`). The model has no relaxation: z also changes during a dwell,
because its input is l and not l'.

**Units** with l in mm: beta 1/(mm s); f1, f2 and sigma1 N s; sigma0 and sigma2 N/mm; alpha 1/mm; z is dimensionless.

**Symmetry.** The scale of z is arbitrary. For every c > 0 the following change leaves the force as it is::

    (beta, f1, f2, sigma0, sigma1, z) -> (beta/c, c f1, c f2, c sigma0, c sigma1, z/c)

Of the seven parameters only six are therefore identifiable. Model I fixes beta, Model II fixes f2 and alpha. Compare
two identifications only after `with_gauge` has brought both to the same beta.

**Asymptotes.** z approaches the equilibrium beta g(l) / sigma0 with the rate l sigma0 / g(l). Where this rate is large
compared with the rate of change of l, the damping term vanishes and::

    insertion  f -> (beta g(l) + sigma2) l,        retraction  f -> (beta g(l) - sigma2) l
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, TypeVar

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.models._base import Channel, LinearStateModel
from needleplan.models._parameter import constant, parameter
from needleplan.signals import Array, Motion

__all__ = [
    "DepthForce",
    "ForceModel1",
    "ForceModel2",
    "insertion_asymptote",
    "regauged",
    "retraction_asymptote",
    "with_gauge",
]


@dataclass(frozen=True)
class DepthForce(LinearStateModel):
    """Abstract base class of the force-depth models, which differ only in the free parameters.

    If g(l) is not positive at some depth, z is unstable there. The constructor accepts such parameters, because a fit
    may try them; `proper` is False then.
    """

    channel: ClassVar[Channel] = Channel.FORCE

    sigma0: float = parameter("N/mm", 1e-8, 1e2, "stiffness of the bristles; small values make a high and sharp peak")
    sigma1: float = parameter(
        "N s", 1e-6, 1e4, "damping of the bristles; affects the peak, and the retraction near the entry"
    )
    sigma2: float = parameter("N/mm", 1e-8, 1e2, "force per depth that reverses with the direction")
    f1: float = parameter("N s", 1e-7, 1e3, "g far from the surface")
    f2: float = parameter("N s", -1e3, 1e3, "g at the surface minus g far from it", typical=0.02)
    alpha: float = parameter("1/mm", 1e-4, 1e1, "decay rate, with depth, of the effect of the surface")
    beta: float = parameter("1/(mm s)", 1e-7, 1e3, "rate of z per depth")

    @property
    def proper(self) -> bool:
        """Whether g(l) > 0 for all l >= 0. Otherwise z is unstable and the simulated force becomes NaN."""
        return self.f1 > 0 and self.f1 + self.f2 > 0

    def g(self, depth_mm: Array) -> Array:
        """Return g (N s) of eq. 2.2, of the shape of `depth_mm`; NaN at depths at which g is not positive.

        At these depths z would grow without bound. The NaN propagates to the simulated force, so that no fit accepts
        the parameters.
        """
        g = np.asarray(self.f1 + self.f2 * np.exp(-self.alpha * depth_mm))
        return np.where(g > 0, g, np.nan)

    def coefficients(self, motion: Motion) -> tuple[Array, Array]:
        """Return the forcing l beta and the rate l sigma0 / g(l), 1/s each, of the shape of the depth."""
        depth = motion.depth_mm
        return np.asarray(depth * self.beta), np.asarray(depth * self.sigma0 / self.g(depth))

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the axial force (N), shape (...), positive if it resists insertion."""
        return self._force(state, motion.depth_mm, motion.direction)

    def output_as_printed(self, state: Array, motion: Motion) -> Array:
        """Return the axial force (N) of eq. 2.1 as printed, shape (...): with sign(l), which ignores the direction."""
        return self._force(state, motion.depth_mm, np.sign(motion.depth_mm))

    def _force(self, state: Array, depth: Array, sign: Array) -> Array:
        z = state[0]
        damping = self.sigma1 * np.exp(-self.alpha * depth) * (self.beta - self.sigma0 * z / self.g(depth))
        return np.asarray(self.sigma0 * z * depth + sign * depth * (damping + self.sigma2))


@dataclass(frozen=True)
class ForceModel1(DepthForce):
    """Force-depth model I (eqs. 2.1, 2.2): beta is fixed, the other parameters are identified.

    The thesis calls beta0 "a normalized constant" and prints no value. Every value permits the same forces, because the
    other parameters scale with it. With the default, f1, f2 and sigma0 have the magnitude of the values that the thesis
    prints for Model II.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> model = npl.models.ForceModel1(sigma0=8e-3, sigma1=2.5, sigma2=4e-3, f1=0.056, f2=-0.021, alpha=0.05)
    >>> run = npl.models.simulate(model, insertion_cycles(80.0, 10.0))
    >>> print(f"{run.output.max():.2f} N")
    0.41 N
    """

    name: ClassVar[str] = "force_model_1"

    beta: float = constant("1/(mm s)", 1e-7, 1e3, "rate of z per depth; fixes the scale of z", default=0.02)


@dataclass(frozen=True)
class ForceModel2(DepthForce):
    """Force-depth model II (eqs. 2.3, 2.4): f2 and alpha are fixed at the values of Model I, beta is identified.

    Up to the scale of z, Model II is Model I with a fixed alpha and a free ratio f2 / f1. Model II cannot represent
    more than Model I; the smaller errors of Model II in the thesis are due to the estimator.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> model = npl.models.ForceModel2(
    ...     sigma0=7.9e-3, sigma1=2.46, sigma2=4.14e-3, f1=0.0559, f2=-0.0211, alpha=0.0525, beta=0.0255
    ... )
    >>> run = npl.models.simulate(model, insertion_cycles(80.0, 10.0))
    >>> print(f"{run.output.max():.2f} N")
    0.44 N
    """

    name: ClassVar[str] = "force_model_2"

    f2: float = constant("N s", -1e3, 1e3, "g at the surface minus g far from it; fixes the scale of z", typical=0.02)
    alpha: float = constant("1/mm", 1e-4, 1e1, "decay rate, with depth, of the effect of the surface", typical=0.05)


def insertion_asymptote(model: DepthForce, depth_mm: Array) -> Array:
    """Return the axial force (N) of an insertion in equilibrium, (beta g(l) + sigma2) l, at the depths l in `depth_mm`.

    The bristle state z has its equilibrium (`steady_state`). The result has the shape of `depth_mm`, and is NaN at
    depths where g(l) is not positive.
    """
    return np.asarray((model.beta * model.g(depth_mm) + model.sigma2) * depth_mm)


def retraction_asymptote(model: DepthForce, depth_mm: Array) -> Array:
    """Return the axial force (N) of a retraction in equilibrium, (beta g(l) - sigma2) l, at the depths l in `depth_mm`.

    The bristle state z has its equilibrium (`steady_state`). The result has the shape of `depth_mm`, and is NaN at
    depths where g(l) is not positive.
    """
    return np.asarray((model.beta * model.g(depth_mm) - model.sigma2) * depth_mm)


_Force = TypeVar("_Force", bound=DepthForce)


def regauged(model: _Force, c: float) -> _Force:
    """Return a model with the same forces as `model`, whose state z is the state z of `model` divided by c.

    Raises ModelError if c is not positive, or a parameter would leave its range.
    """
    if not c > 0:
        raise ModelError(Mistake("c", f"{c}", "must be positive"), model.name)
    scaled = {name: c * getattr(model, name) for name in ("f1", "f2", "sigma0", "sigma1")}
    return model.with_values(beta=model.beta / c, **scaled)


def with_gauge(model: _Force, beta: float) -> _Force:
    """Return the model with the given beta (1/(mm s)) and the same forces.

    Raises ModelError if beta is not positive, or a parameter would leave its range.
    """
    if not beta > 0:
        raise ModelError(Mistake("beta", f"{beta}", "must be positive"), model.name)
    return regauged(model, model.beta / beta)
