"""The moving mass, identified together with friction: `identify friction --mass`.

A force sensor that drives a mass m measures friction and inertia, with the acceleration a from the velocity::

    F = F_friction + m a

m is one more parameter of the fit; it may come out negative, so that its interval is not cut off at 0. Two things can
hide it:

- **No excitation.** If m a is small beside what the friction model leaves, the interval of m contains 0. The remark
  then gives the acceleration that would determine 0.1 kg: the interval is proportional to 1/a.
- **Noise of the motion.** Noise of depth or velocity adds to a and to the friction, and biases m, mostly towards 0.
  The bias is found by adding noise of the same size once more and fitting again (SIMEX, Cook and Stefanski, J. Am.
  Stat. Assoc. 89 (1994) 1314): the interval is widened by the change in the opposite direction. If the change is more
  than 20 %, the mass is not determined.

The model file stores the mass as the effect `inertia`. The acceleration is the central difference of the velocity.
Without a velocity column, the velocity is computed from the depth
without delay (`velocity_without_delay`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from needleplan.identification.friction_candidates import Candidate
from needleplan.models import Estimate, Fit, SelfIntegratingModel, simulate
from needleplan.models._parameter import Parameter, parameter, parameters_of
from needleplan.models.effects import AddedEffect, AugmentedModel, with_effect
from needleplan.models.friction import Friction
from needleplan.signals import Array, Motion, Record, velocity_without_delay

__all__ = ["FrictionWithMass", "MovingMass", "inertia_n", "moving_mass", "stored", "with_mass", "with_velocity"]

# Force that accelerates 1 kg by 1 mm/s^2, N.
_N_PER_KG_MM_S2 = 1e-3
# Relative change of the mass by noise of the motion above which the mass is not determined.
_NOISY = 0.2
# Mass (kg) of a needle with its holder and relative standard deviation, for which the remark gives an acceleration.
_USUAL_KG, _WANTED = 0.1, 0.1
# Standard deviation of the third difference of white noise of unit variance.
_THIRD_DIFFERENCE_SD = 20**0.5
# Standard deviation per median absolute deviation of normal noise.
_MAD = 1.4826


def inertia_n(motion: Motion) -> Array:
    """Return the inertia of 1 kg (N) along a motion, shape (samples,)."""
    return np.asarray(_N_PER_KG_MM_S2 * np.gradient(motion.velocity_mm_s, motion.time_s))


@dataclass(frozen=True)
class FrictionWithMass(SelfIntegratingModel):
    """A friction model with a moving mass; its parameters are those of the friction and `mass_kg`.

    The output is available for whole motions only, because the acceleration needs neighbouring samples.
    """

    base: Friction
    mass_kg: float = parameter("kg", -100, 100, "moving mass", default=0.0, typical=0.1)

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the friction model, with the mass."""
        return f"{self.base.name}+inertia"

    @property
    def channel(self) -> Any:  # type: ignore[override]
        """Channel of the friction model."""
        return self.base.channel

    def __getattr__(self, name: str) -> Any:
        """Return a parameter or a method of the friction model."""
        if name.startswith("__") or name == "base":
            raise AttributeError(name)
        return getattr(self.base, name)

    def parameters(self) -> dict[str, Parameter]:  # type: ignore[override]
        """Return the parameters of the friction, and `mass_kg`."""
        return {**self.base.parameters(), **parameters_of(self)}

    def values(self) -> dict[str, float]:
        """Return the values of the friction, and `mass_kg`."""
        return {**self.base.values(), "mass_kg": self.mass_kg}

    def with_values(self, **values: float) -> Self:
        """Return a copy with some values changed."""
        mass = values.pop("mass_kg", self.mass_kg)
        return replace(self, base=self.base.with_values(**values), mass_kg=mass)

    def initial_state(self, motion: Motion) -> Array:
        """Return the state of the friction at rest."""
        return self.base.initial_state(motion)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rate of change of the state of the friction."""
        return self.base.derivative(state, motion)

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states of the friction."""
        return np.asarray(simulate(self.base, motion, start).states)

    def output(self, state: Array, motion: Motion) -> Array:
        """Return friction and inertia (N), shape (samples,)."""
        return np.asarray(self.base.output(state, motion) + self.mass_kg * inertia_n(motion))


def with_velocity(record: Record) -> Record:
    """Return the record with a velocity: its own, or that of the depth without delay."""
    if "velocity_mm_s" in record.columns:
        return record
    return record.with_column(
        "velocity_mm_s", velocity_without_delay(record["time_s"], record["depth_mm"]).velocity_mm_s
    )


def with_mass(candidate: Candidate) -> Candidate:
    """Return the candidate with a moving mass in addition."""
    assert isinstance(candidate.model, Friction)
    return replace(candidate, model=FrictionWithMass(candidate.model), free=(*candidate.free, "mass_kg"))


@dataclass(frozen=True)
class MovingMass:
    """The identified mass (kg): its estimate, the change by additional noise of the motion, and remarks."""

    estimate: Estimate
    change_kg: float
    remarks: tuple[str, ...]


def moving_mass(found: Fit, train: Sequence[Record], refit: Callable[[Sequence[Record]], Fit]) -> MovingMass:
    """Return the mass of a fit of `FrictionWithMass` to the records `train`.

    `refit` repeats the fit with other records, which have a velocity.
    """
    each = found.estimates["mass_kg"]
    random = np.random.default_rng(0)
    again = refit([with_velocity(_noisier(record, random)) for record in train])
    change = again.estimates["mass_kg"].value - each.value
    low, high = each.low - max(change, 0.0), each.high - min(change, 0.0)
    noisy = abs(change) > _NOISY * abs(each.value)
    estimate = replace(each, low=low, high=high, identified=low > 0 and not noisy)
    if estimate.identified:
        return MovingMass(estimate, change, ())
    largest = max(float(np.max(np.abs(inertia_n(with_velocity(record).motion())))) for record in train)
    size = (
        f"the largest acceleration is {1e3 * largest:.3g} mm/s2, so that 1 kg gives {1e3 * largest:.2g} mN beside "
        f"residuals of {1e3 * found.rmse:.2g} mN"
    )
    remark = (
        f"the motion does not determine the moving mass: {low:.2g} to {high:.2g} kg fit, and it is left out; {size}. "
    )
    if low > 0:
        remark += (
            f"Noise of the measured motion changes the mass by {100 * abs(change / each.value):.0f} %: record the "
            "velocity, or the depth with less noise"
        )
    else:
        factor = max(2.0, each.sd / (_WANTED * _USUAL_KG))
        remark += (
            f"A mass of {_USUAL_KG:g} kg is found within {100 * _WANTED:.0f} % with about {factor:.2g} times the "
            "acceleration: move faster, or with shorter reversals"
        )
    return MovingMass(estimate, change, (remark,))


def stored(found: Fit, mass: MovingMass) -> AugmentedModel:
    """Return the friction model with the effect `inertia`, as a model file holds it; the mass must be above 0."""
    assert isinstance(found.model, FrictionWithMass)
    size = mass.estimate
    return with_effect(found.model.base, AddedEffect("inertia", {"size": size.value}, {"size": size}))


def _noisier(record: Record, random: np.random.Generator) -> Record:
    """Return the record with noise added to its velocity, or without one to its depth, of the size of that in it."""
    name = "velocity_mm_s" if "velocity_mm_s" in record.columns else "depth_mm"
    values = record[name]
    third = np.diff(values, 3)
    sd = _MAD * float(np.median(np.abs(third - np.median(third)))) / _THIRD_DIFFERENCE_SD if third.size else 0.0
    return record.with_column(name, values + random.normal(0.0, sd, values.size))
