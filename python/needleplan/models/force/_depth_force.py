"""The force-depth model: LuGre friction with the inserted length l in the place of the velocity (eqs. 2.1 to 2.4).

::

    z' = l (beta - sigma0 z / g(l)),        g(l) = f1 + f2 exp(-alpha l)
    f  = sigma0 z l + sign(l') l { sigma1 exp(-alpha l) (beta - sigma0 z / g(l)) + sigma2 }

The print has lost where the dot of the velocity belongs. It belongs into the sign: with sign(l), which is always +1, or
with "sign(l) l' {...}" the force of a retraction would not turn negative, against Figs. 2.7 and 2.9. The first term is
read as sigma0 z l; with "sigma0 z" the statements of the text about sigma0 and sigma1 do not hold.

At rest the sign is the last one that was not zero (`Motion.direction`). Relaxation is not in the model: z goes on while
the needle dwells, since its input is l and not l'.

Units with l in mm: beta 1/(mm s), f1, f2 and sigma1 N s, sigma0 and sigma2 N/mm, alpha 1/mm; z has none. The scale of
z is free (`needleplan.models.force.gauge`), so that beta, f1, f2, sigma0 and sigma1 mean something only together.

----

Model I of chapter 2: beta is a fixed normalisation, everything else is identified (eqs. 2.1, 2.2).

----

Model II of chapter 2: f2 and alpha are fixed, taken from Model I, and beta is identified (eqs. 2.3, 2.4).

----

Closed forms of the force-depth model once z has settled: the force far behind the peak.

z follows its equilibrium z = beta g(l) / sigma0 with the rate l sigma0 / g(l). Where that is fast beside the change of
l, the damping term is gone and, exactly in the limit,

    insertion  f -> (beta g(l) + sigma2) l,        retraction  f -> (beta g(l) - sigma2) l.

----

The exact symmetry of the force-depth model: nobody has ever measured the scale of z.

For every c > 0::

    (beta, f1, f2, sigma0, sigma1, z) -> (beta/c, c f1, c f2, c sigma0, c sigma1, z/c)

leaves the force as it is: z' keeps its form, as sigma0/g does not change, and sigma0 z, sigma1 beta and
sigma1 sigma0 z/g do not either. sigma2 and alpha stay. So the seven numbers are six, and no data can tell all seven.
Model I takes one away by fixing beta, Model II by fixing f2. Compare parameters of two identifications only after
`with_gauge` has brought both to the same beta.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, TypeVar

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.models._base import Channel, LinearStateModel, constant, parameter
from needleplan.signals import Array, Motion

__all__ = [
    "DepthForce",
    "ForceModel1",
    "ForceModel2",
    "insertion_asymptote",
    "regauged",
    "regauged_state",
    "retraction_asymptote",
    "steady_state",
    "with_gauge",
]


@dataclass(frozen=True)
class DepthForce(LinearStateModel):
    """Axial force as a function of depth; abstract: the two models differ only in what is free.

    A g(l) that is not positive somewhere makes z unstable there; it is no error, since identification may try it, and
    `proper` says it.
    """

    channel: ClassVar[Channel] = Channel.FORCE

    sigma0: float = parameter("N/mm", 1e-8, 1e2, "stiffness of the bristles: small, and the peak is high and sharp")
    sigma1: float = parameter("N s", 1e-6, 1e4, "damping of the bristles: peak, and retraction near the entry")
    sigma2: float = parameter("N/mm", 1e-8, 1e2, "force per depth that changes its sign with the direction")
    f1: float = parameter("N s", 1e-7, 1e3, "g far from the surface")
    f2: float = parameter("N s", -1e3, 1e3, "g at the surface less g far from it", typical=0.02)
    alpha: float = parameter("1/mm", 1e-4, 1e1, "rate of decay with depth of what is special at the surface")
    beta: float = parameter("1/(mm s)", 1e-7, 1e3, "rate of z per depth")

    @property
    def proper(self) -> bool:
        """Whether g(l) > 0 for all l >= 0, without which the force grows without bound."""
        return self.f1 > 0 and self.f1 + self.f2 > 0

    def g(self, depth_mm: Array) -> Array:
        """Return what z saturates at, in N s, of the shape of `depth_mm` (eq. 2.2); NaN where it is not positive.

        z would grow without bound there, and so the simulation says: it ends in NaN, and no fit accepts it.
        """
        g = np.asarray(self.f1 + self.f2 * np.exp(-self.alpha * depth_mm))
        return np.where(g > 0, g, np.nan)

    def coefficients(self, motion: Motion) -> tuple[Array, Array]:
        """Return l beta and l sigma0 / g(l)."""
        depth = motion.depth_mm
        return np.asarray(depth * self.beta), np.asarray(depth * self.sigma0 / self.g(depth))

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the axial force (N), positive where it resists insertion."""
        return self._force(state, motion.depth_mm, motion.direction)

    def output_as_printed(self, state: Array, motion: Motion) -> Array:
        """Return the force (N) with sign(l), as eq. 2.1 reads without the dot: a deep retraction would push."""
        return self._force(state, motion.depth_mm, np.sign(motion.depth_mm))

    def _force(self, state: Array, depth: Array, sign: Array) -> Array:
        z = state[0]
        damping = self.sigma1 * np.exp(-self.alpha * depth) * (self.beta - self.sigma0 * z / self.g(depth))
        return np.asarray(self.sigma0 * z * depth + sign * depth * (damping + self.sigma2))


@dataclass(frozen=True)
class ForceModel1(DepthForce):
    """The force-depth model with fixed beta.

    The thesis calls beta0 "a normalized constant" and gives no value; none is needed, as every value gives the same
    forces (`needleplan.models.force.gauge`). The default keeps f1, f2 and sigma0 at the size printed for Model II.
    """

    name: ClassVar[str] = "force_model_1"

    beta: float = constant("1/(mm s)", 1e-7, 1e3, "rate of z per depth; fixes the scale of z", default=0.02)


@dataclass(frozen=True)
class ForceModel2(DepthForce):
    """The force-depth model with fixed f2 and alpha.

    Up to the scale of z it is Model I with alpha fixed and f2 / f1 free: nothing that Model I could not do
    (`needleplan.models.force.gauge`). That it did better in the thesis is a matter of the estimator.
    """

    name: ClassVar[str] = "force_model_2"

    f2: float = constant("N s", -1e3, 1e3, "g at the surface less g far from it; fixes the scale of z")
    alpha: float = constant("1/mm", 1e-4, 1e1, "rate of decay with depth of what is special at the surface")


def steady_state(model: DepthForce, depth_mm: Array) -> Array:
    """Return the equilibrium of z at each depth, shape as given."""
    return np.asarray(model.beta * model.g(depth_mm) / model.sigma0)


def insertion_asymptote(model: DepthForce, depth_mm: Array) -> Array:
    """Return the force (N) of an insertion at each depth, shape as given, once z has settled."""
    return np.asarray((model.beta * model.g(depth_mm) + model.sigma2) * depth_mm)


def retraction_asymptote(model: DepthForce, depth_mm: Array) -> Array:
    """Return the force (N) of a retraction at each depth, shape as given, once z has settled."""
    return np.asarray((model.beta * model.g(depth_mm) - model.sigma2) * depth_mm)


_Force = TypeVar("_Force", bound=DepthForce)


def regauged(model: _Force, c: float) -> _Force:
    """Return the model with the scale of z changed by 1/c; its forces are those of `model`.

    Raises ModelError where c is not positive, or a parameter would leave its range.
    """
    if not c > 0:
        raise ModelError(Mistake("c", f"{c}", "must be positive"), model.name)
    scaled = {name: c * getattr(model, name) for name in ("f1", "f2", "sigma0", "sigma1")}
    return model.with_values(beta=model.beta / c, **scaled)


def regauged_state(state: Array, c: float) -> Array:
    """Return the state, of any shape, that belongs to `regauged(model, c)`."""
    return state / c


def with_gauge(model: _Force, beta: float) -> _Force:
    """Return the model with the same forces whose beta (1/(mm s)) is the given one. Raises ModelError as `regauged`."""
    if not beta > 0:
        raise ModelError(Mistake("beta", f"{beta}", "must be positive"), model.name)
    return regauged(model, model.beta / beta)
