"""Friction models without a state, and the separation of friction from a measured force.

The models are the benchmark of Karnopp's kind and Model I of the thesis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from needleplan.artifacts import ShortRepr
from needleplan.errors import Mistake, ModelError
from needleplan.models._parameter import parameter
from needleplan.models._simulate import simulate
from needleplan.models.friction._base import Friction, StribeckFriction
from needleplan.signals import Array, Motion, Record

__all__ = ["DirectionalKarnopp", "ForceParts", "Karnopp", "QuasiStatic", "cutting_force", "into_fresh_tissue"]


@dataclass(frozen=True, kw_only=True)
class Karnopp(Friction):
    """F = (sign(v) mu_c + sigma2 v) Fn: the benchmark of the thesis (after Okamura 2004).

    The model is linear in its parameters. Karnopp's dead zone is left out: the thesis prints no width, and a prescribed
    motion does not need it. At rest the friction keeps the sign of the last movement.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> run = npl.models.simulate(npl.models.Karnopp(mu_c=0.5, sigma2=0.02), insertion_cycles(50.0, 5.0))
    >>> print(f"{run.output.max():.2f} N, {run.output.min():.2f} N")
    0.60 N, -0.60 N
    """

    name: ClassVar[str] = "karnopp"

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return the empty state, shape (0,)."""
        return np.zeros(0)

    def derivative(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return an empty array, because there is no state, shape (0,)."""
        return np.zeros_like(state)

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the friction (N), shape (...)."""
        ratio = self.mu_c * motion.direction + self.sigma2 * motion.velocity_mm_s
        return np.asarray(self.total_normal_force_n(motion) * ratio)


@dataclass(frozen=True, kw_only=True)
class DirectionalKarnopp(Karnopp):
    """F = (mu_c + sigma2 v) Fn on insertion, and (-mu_c_out + sigma2_out v) Fn on retraction.

    Drives with a screw or a belt rub differently in each direction, and the bevel of a needle presses it to one side.
    Half of the difference of the two forces at slow motion cannot be told from an offset of the sensor.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> model = npl.models.DirectionalKarnopp(mu_c=0.5, sigma2=0.02, mu_c_out=0.4, sigma2_out=0.03)
    >>> run = npl.models.simulate(model, insertion_cycles(50.0, 5.0))
    >>> print(f"{run.output.max():.2f} N, {run.output.min():.2f} N")
    0.60 N, -0.55 N
    """

    name: ClassVar[str] = "karnopp_by_direction"
    mu_c_out: float = parameter("", 1e-4, 100, "friction coefficient at high speed on retraction")
    sigma2_out: float = parameter("s/mm", -10, 10, "viscous coefficient on retraction", typical=0.01)

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the friction (N), shape (...)."""
        way, speed = motion.direction, motion.velocity_mm_s
        inward = self.mu_c * way + self.sigma2 * speed
        outward = self.mu_c_out * way + self.sigma2_out * speed
        return np.asarray(self.total_normal_force_n(motion) * np.where(way < 0, outward, inward))


@dataclass(frozen=True, kw_only=True)
class QuasiStatic(StribeckFriction):
    """Model I, (3.9): the steady bending of bristles that enter at one end of the patch.

    F = {sign(v) g [1 - g/(sigma0 L) (1 - exp(-sigma0 L/g))] + sigma2 v} Fn. For L = 76 mm the bracket is above 0.99, so
    that sigma0 is not identifiable from such a patch. The steady bending (3.7) solves (3.6) only for v > 0. For v < 0,
    (3.7) is the solution of transport with |v|: the bristles enter at the other end.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> model = npl.models.QuasiStatic(mu_c=0.7, sigma2=0.017, sigma0=1.3, mu_s=0.04, alpha=0.08)
    >>> run = npl.models.simulate(model, insertion_cycles(50.0, 5.0))
    >>> print(f"{run.output.max():.2f} N")
    0.34 N
    """

    name: ClassVar[str] = "quasi_static"

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return the empty state, shape (0,)."""
        return np.zeros(0)

    def derivative(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return an empty array, because there is no state, shape (0,)."""
        return np.zeros_like(state)

    def output(self, state: Array, motion: Motion) -> Array:  # noqa: ARG002
        """Return the friction (N), shape (...)."""
        level = self.level(motion)
        lengths = self.sigma0 * self.inserted_mm(motion) / level
        share = np.where(lengths > 0, 1 + np.expm1(-lengths) / np.where(lengths > 0, lengths, 1.0), 0.0)
        ratio = motion.direction * level * share + self.sigma2 * motion.velocity_mm_s
        return np.asarray(self.total_normal_force_n(motion) * ratio)


# Force that accelerates 1 kg by 1 mm/s^2, N.
_N_PER_KG_MM_S2 = 1e-3


@dataclass(frozen=True)
class ForceParts(ShortRepr):
    """Components of a measured axial force (N), shape (samples,) each; their sum is the measured force.

    Parameters
    ----------
    friction_n : Array
        Friction along the shaft.
    inertia_n : Array
        Inertia of needle and holder.
    cutting_n : Array
        Remainder: cutting at the tip.

    Examples
    --------
    >>> import numpy as np
    >>> from needleplan.models import ForceParts
    >>> parts = ForceParts(friction_n=np.array([0.3]), inertia_n=np.zeros(1), cutting_n=np.array([0.2]))
    >>> print(f"{parts.friction_n[0] + parts.inertia_n[0] + parts.cutting_n[0]:.1f} N")
    0.5 N
    """

    friction_n: Array
    inertia_n: Array
    cutting_n: Array


def cutting_force(record: Record, friction: Friction, mass_kg: float) -> ForceParts:
    """Separate the measured force of a trial into friction, inertia and cutting force (thesis, 3.4.2).

    The sensor accelerates the needle and its holder. The inertia is therefore mass times acceleration in the direction
    of insertion; at 0.05 Hz it is about 0.1 mN. (F = Fz + m a in the thesis has the opposite sensor axis.) The friction
    is simulated from rest along the motion of the record.

    Parameters
    ----------
    record : Record
        The trial, with the column `force_n`.
    friction : Friction
        Identified friction model.
    mass_kg : float
        Mass of the needle and its holder beyond the sensor.

    Returns
    -------
    ForceParts
        The three components.

    Raises
    ------
    DataError
        If the record has no column `force_n`.
    ModelError
        If the mass is negative or not a number.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import Record, insertion_cycles
    >>> motion, friction = insertion_cycles(50.0, 5.0), npl.models.Karnopp(mu_c=0.5, sigma2=0.02)
    >>> measured = npl.models.simulate(friction, motion).output + 0.2
    >>> record = Record({"time_s": motion.time_s, "depth_mm": motion.depth_mm,
    ...                  "velocity_mm_s": motion.velocity_mm_s, "force_n": measured})
    >>> print(f"{npl.models.cutting_force(record, friction, mass_kg=0.0).cutting_n.mean():.2f} N")
    0.20 N
    """
    if not 0 <= mass_kg < np.inf:
        raise ModelError(Mistake("mass_kg", str(mass_kg), "must be a number that is not negative"), "cutting_force")
    measured = record["force_n"]
    motion = record.motion()
    rubbed = simulate(friction, motion).output
    inertia = _N_PER_KG_MM_S2 * mass_kg * motion.acceleration_mm_s2
    return ForceParts(rubbed, inertia, measured - rubbed - inertia)


def into_fresh_tissue(motion: Motion, margin_mm: float = 0.0) -> NDArray[np.bool_]:
    """Return a mask of the samples at which the tip cuts: it moves in and is deeper than ever before.

    Parameters
    ----------
    motion : Motion
        The motion. The depth of its first sample counts as already cut.
    margin_mm : float
        Distance behind the largest previous depth that still counts as cutting.

    Returns
    -------
    NDArray
        Mask, bool of shape (samples,).

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> motion = insertion_cycles(50.0, 5.0, cycles=2)
    >>> cutting = npl.models.into_fresh_tissue(motion)
    >>> bool(cutting[motion.time_s > 25.0].any())  # the second insertion follows the path of the first
    False
    """
    reached = np.concatenate([[motion.depth_mm[0]], np.maximum.accumulate(motion.depth_mm)[:-1]])
    return np.asarray((motion.depth_mm > reached - margin_mm) & (motion.velocity_mm_s > 0))
