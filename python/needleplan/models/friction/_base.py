"""Base classes of the friction models: the contact patch, its normal force, and the velocity dependence.

The patch is the part of the shaft within tissue of the thickness `thickness_mm`. While the tip is in the tissue, the
inserted length is the depth. After the tip has passed through the tissue, the inserted length is the thickness. The
normal force is distributed along the patch by the `profile`. The total normal force is `normal_force_n` at the inserted
length `reference_mm`. In the thesis this is 1 N at 76 mm, which fixes the scale of mu_c, mu_s and sigma2.

fn(zeta) is the normal force per length at the distance zeta from the entry, for an inserted length L (thesis, (3.15)).
With a plateau f and ramps of the length w::

    right trapezoid          zeta/w on the first w, then 1                                  Fn = f (L - w/2)
    isosceles trapezoid      zeta/w on the first w, then 1, (L - zeta)/w on the last w      Fn = f (L - w)

Short patches are triangles. For L <= w the right profile rises up to zeta = L, with Fn = f L^2/(2w). For L <= 2w the
isosceles profile rises to L/2 and falls again, with Fn = f L^2/(4w). Equation (3.19) of the thesis uses f (L - w) for
any length, which is negative for L < w.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar, TypeVar

import numpy as np

from needleplan.errors import Mistake, ModelError
from needleplan.models._base import Channel, Model
from needleplan.models._parameter import constant, parameter
from needleplan.signals import Array, Motion

__all__ = ["Friction", "Profile", "StribeckFriction", "choice", "intensity", "normal_length_mm"]


class Profile(StrEnum):
    """Distribution fn(zeta) of the normal force along the inserted shaft.

    Examples
    --------
    >>> from needleplan.models import Profile
    >>> [str(profile) for profile in Profile]
    ['constant', 'uniform', 'right', 'isosceles']
    """

    CONSTANT = "constant"
    """The total normal force Fn does not depend on the length. The thesis uses Fn = 1 N for Models I and II."""

    UNIFORM = "uniform"
    """fn = f: the normal force is proportional to the inserted length."""

    RIGHT = "right"
    """Right trapezoid, Model III-A."""

    ISOSCELES = "isosceles"
    """Isosceles trapezoid, Model III-B."""


def normal_length_mm(profile: Profile, length_mm: Array, ramp_mm: float) -> Array:
    """Return Fn/f (mm), total normal force divided by plateau, for every inserted length in `length_mm`, in its shape.

    For the constant profile, which has no plateau, the result is 1 without a unit.
    """
    length = np.asarray(length_mm, float)
    if profile is Profile.CONSTANT:
        return np.ones_like(length)
    if profile is Profile.UNIFORM:
        return length
    if profile is Profile.RIGHT:
        return np.where(length <= ramp_mm, length**2 / (2 * ramp_mm), length - ramp_mm / 2)
    return np.where(length <= 2 * ramp_mm, length**2 / (4 * ramp_mm), length - ramp_mm)


def intensity(profile: Profile, position_mm: Array, length_mm: Array | float, ramp_mm: float) -> Array:
    """Return fn/f at positions from the entry, zero outside of [0, length]. The arguments broadcast.

    The constant profile does not define a distribution; it is treated as uniform.
    """
    position, length = np.broadcast_arrays(np.asarray(position_mm, float), np.asarray(length_mm, float))
    inside = (position >= 0) & (position <= length)
    rising = np.minimum(position / ramp_mm, 1.0)
    if profile is Profile.RIGHT:
        return np.where(inside, rising, 0.0)
    if profile is Profile.ISOSCELES:
        return np.where(inside, np.minimum(rising, (length - position) / ramp_mm), 0.0)
    return np.where(inside, 1.0, 0.0)


_Choice = TypeVar("_Choice", bound=StrEnum)


def choice(kind: type[_Choice], value: object, key: str, model: str) -> _Choice:
    """Return the member of the enumeration `kind` that `value` names. Raises ModelError, listing the members."""
    try:
        return kind(str(value))
    except ValueError:
        rule = f"must be one of {', '.join(kind)}"
        raise ModelError(Mistake(key, str(value), rule), model) from None


@dataclass(frozen=True, kw_only=True)
class Friction(Model):
    """Abstract base class of friction along the inserted shaft; the force is positive on insertion.

    The symbols are those of chapter 3 of the thesis. The constructor also raises ModelError for an unknown `profile`.
    """

    channel: ClassVar[Channel] = Channel.FORCE
    mu_c: float = parameter("", 1e-4, 100, "friction coefficient at high speed")
    sigma2: float = parameter("s/mm", -10, 10, "viscous coefficient; negative values occur in muscle", typical=0.01)
    thickness_mm: float = constant("mm", 0, 1e4, "thickness of the tissue; a needle may pass through", default=76.0)
    normal_force_n: float = constant("N", 0, 1e3, "total normal force at the reference length", default=1.0)
    reference_mm: float = constant("mm", 1e-3, 1e4, "inserted length at which the normal force is given", default=76.0)
    ramp_mm: float = constant("mm", 1e-3, 1e3, "w, length of the ramps of the normal force", default=2.5)
    profile: Profile = Profile.CONSTANT

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "profile", choice(Profile, self.profile, "profile", type(self).__name__))

    def inserted_mm(self, motion: Motion) -> Array:
        """Return the length of the shaft in the tissue, shape (...): the depth, clipped to [0, thickness]."""
        return np.asarray(np.clip(motion.depth_mm, 0.0, self.thickness_mm))

    def plateau_n_mm(self) -> float:
        """Return the plateau f (N/mm) of the normal force per length; for the constant profile, the total force (N)."""
        reference = np.asarray(self.reference_mm)
        return self.normal_force_n / float(normal_length_mm(self.profile, reference, self.ramp_mm))

    def total_normal_force_n(self, motion: Motion) -> Array:
        """Return Fn (N) for the inserted length, shape (...)."""
        length = normal_length_mm(self.profile, self.inserted_mm(motion), self.ramp_mm)
        return np.asarray(self.plateau_n_mm() * length)


@dataclass(frozen=True, kw_only=True)
class StribeckFriction(Friction):
    """Abstract base class of friction whose coefficient changes from mu_s at rest to mu_c at high velocity.

    In Tables 3.2 to 3.4 of the thesis, mu_c is ten to thirty times mu_s: friction rises with the velocity, without a
    Stribeck drop. The tables print mu_c and mu_s in the right columns: if their values were exchanged, the ratio of the
    error of the Karnopp model to that of Model II would be 8 to 12 times the published ratio.
    """

    sigma0: float = parameter("1/mm", 1e-4, 1e4, "stiffness of the bristles")
    mu_s: float = parameter("", 1e-5, 100, "friction coefficient at rest")
    alpha: float = parameter("s/mm", 1e-4, 100, "rate of the transition from mu_s to mu_c")
    gamma: float = constant("", 0.1, 4, "exponent of the speed in this transition", default=1.0)

    def level(self, motion: Motion) -> Array:
        """Return g(v) of (3.2), the friction coefficient at the velocity of the motion, shape (...)."""
        speed = np.abs(motion.velocity_mm_s)
        power = speed if self.gamma == 1 else speed**self.gamma
        return np.asarray(self.mu_c + (self.mu_s - self.mu_c) * np.exp(-self.alpha * power))
