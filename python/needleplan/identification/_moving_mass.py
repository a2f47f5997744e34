"""What hangs on the force sensor, identified together with friction: `identify friction --mass --offset`.

A force sensor that drives a mass m measures friction and inertia, with the acceleration a from the velocity, and its
own offset F_0::

    F = F_friction + m a + F_0

m is one more parameter of the fit; it may come out negative, so that its interval is not cut off at 0. Two things can
hide it:

- **No excitation.** If m a is small beside what the friction model leaves, the interval of m contains 0. The remark
  then gives the acceleration that would determine 0.1 kg: the interval is proportional to 1/a.
- **Noise of the motion.** Noise of depth or velocity adds to a and to the friction, and biases m, mostly towards 0.
  The bias is found by adding noise of the same size once more and fitting again (SIMEX, Cook and Stefanski, J. Am.
  Stat. Assoc. 89 (1994) 1314): the interval is widened by the change in the opposite direction. If the change is more
  than 20 %, the mass is not determined.

Without a velocity column, the velocity is computed from the depth
without delay (`velocity_without_delay`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from needleplan.identification.friction_candidates import Candidate
from needleplan.models import Estimate, Fit, Model, SelfIntegratingModel, simulate
from needleplan.models._parameter import Parameter, parameter, parameters_of
from needleplan.models.effects import AddedEffect, with_effect
from needleplan.models.friction import DirectionalKarnopp, Friction
from needleplan.signals import Array, Motion, Record, velocity_without_delay

__all__ = ["FrictionOnSensor", "MovingMass", "inertia_n", "moving_mass", "on_sensor", "stored", "with_velocity"]

# Force that accelerates 1 kg by 1 mm/s^2, N.
_N_PER_KG_MM_S2 = 1e-3
# Share of the normal force that is a small offset.
_SMALL = 0.1
# Windows (s) of the velocity of a depth, of which one is chosen.
_WINDOWS_S = (0.005, 0.008, 0.012, 0.02, 0.03, 0.045, 0.07, 0.1)
# Difference of two accelerations, in units of the noise of one of them, from which one of them is rounded off.
_DIFFERS = 2.0
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
    return np.asarray(_N_PER_KG_MM_S2 * motion.acceleration_mm_s2)


@dataclass(frozen=True)
class FrictionOnSensor(SelfIntegratingModel):
    """A friction model with a moving mass and an offset of the sensor; their values are among its parameters.

    The output is available for whole motions only, because the acceleration needs neighbouring samples.
    """

    base: Friction
    mass_kg: float = parameter("kg", -1000, 1000, "moving mass", default=0.0, typical=0.1)
    offset_n: float = parameter("N", -1000, 1000, "reading at zero force", default=0.0, typical=0.01)

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name of the friction model, with mass and offset."""
        return f"{self.base.name}+inertia+bias"

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
        """Return the parameters of the friction, `mass_kg` and `offset_n`."""
        known = parameters_of(self)
        known["offset_n"] = replace(known["offset_n"], typical=_SMALL * self.base.normal_force_n)
        return {**self.base.parameters(), **known}

    def values(self) -> dict[str, float]:
        """Return the values of the friction, `mass_kg` and `offset_n`."""
        return {**self.base.values(), "mass_kg": self.mass_kg, "offset_n": self.offset_n}

    def with_values(self, **values: float) -> Self:
        """Return a copy with some values changed."""
        mass, offset = values.pop("mass_kg", self.mass_kg), values.pop("offset_n", self.offset_n)
        return replace(self, base=self.base.with_values(**values), mass_kg=mass, offset_n=offset)

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
        """Return friction, inertia and offset (N), shape (samples,)."""
        return np.asarray(self.base.output(state, motion) + self.mass_kg * inertia_n(motion) + self.offset_n)


def with_velocity(record: Record) -> Record:
    """Return the record with a velocity: its own, or the derivative of the depth without delay.

    A short window passes the noise of the depth on to the acceleration, and a long window smooths real changes. The
    chosen window is the longest one whose accelerations differ from those of every shorter window by at most twice the
    noise of the shorter one (Lepskii, Theory Probab. Appl. 35 (1990) 454).
    """
    if "velocity_mm_s" in record.columns:
        return record
    noise_mm, chosen = _noise(record["depth_mm"]), None
    shorter: list[tuple[Array, float]] = []
    for window_s in _WINDOWS_S:
        velocity, gain = _velocity(record, window_s)
        acceleration = np.gradient(velocity, record["time_s"])
        if any(float(np.std(acceleration - other)) > _DIFFERS * noise for other, noise in shorter):
            break
        chosen = velocity
        shorter.append((acceleration, noise_mm * gain))
    assert chosen is not None
    return record.with_column("velocity_mm_s", chosen)


def _velocity(record: Record, window_s: float) -> tuple[Array, float]:
    """Return the velocity, and the noise of its acceleration (1/s2) for noise of the depth of unit variance."""
    time, impulse = record["time_s"], np.zeros(len(record))
    impulse[len(record) // 2] = 1.0
    velocity, response = (
        velocity_without_delay(time, values, window_s).velocity_mm_s for values in (record["depth_mm"], impulse)
    )
    return velocity, float(np.linalg.norm(np.gradient(response, time)))


def on_sensor(candidate: Candidate, *, mass: bool, offset: bool) -> Candidate:
    """Add a moving mass, an offset of the sensor, or both to a candidate, and return it.

    Friction by direction gets no offset: its different forces in the two directions take up an offset.
    """
    assert isinstance(candidate.model, Friction)
    more = {"mass_kg": mass, "offset_n": offset and not isinstance(candidate.model, DirectionalKarnopp)}
    free = (*candidate.free, *(name for name, wanted in more.items() if wanted))
    return replace(candidate, model=FrictionOnSensor(candidate.model), free=free)


@dataclass(frozen=True)
class MovingMass:
    """The identified mass (kg): its estimate, its change if noise is added to the motion, and remarks."""

    estimate: Estimate
    change_kg: float
    remarks: tuple[str, ...]


def moving_mass(found: Fit, train: Sequence[Record], refit: Callable[[Sequence[Record]], Fit]) -> MovingMass:
    """Return the mass of a fit of `FrictionOnSensor` to the records `train`.

    `refit` repeats the fit with other records, which have a velocity.
    """
    mass = found.estimates["mass_kg"]
    random = np.random.default_rng(0)
    again = refit([with_velocity(_noisier(record, random)) for record in train])
    change = again.estimates["mass_kg"].value - mass.value
    low, high = mass.low - max(change, 0.0), mass.high - min(change, 0.0)
    noisy = abs(change) > _NOISY * abs(mass.value)
    estimate = replace(mass, low=low, high=high, identified=low > 0 and not noisy)
    if estimate.identified:
        return MovingMass(estimate, change, ())
    largest = max(float(np.max(np.abs(inertia_n(with_velocity(record).motion())))) for record in train)
    size = (
        f"the largest acceleration is {1e3 * largest:.3g} mm/s2, so that 1 kg gives {1e3 * largest:.3g} mN beside "
        f"residuals of {1e3 * found.rmse:.2g} mN"
    )
    remark = (
        f"the motion does not determine the moving mass: {low:.2g} to {high:.2g} kg fit, and it is left out; {size}. "
    )
    if low > 0:
        remark += (
            f"Noise of the measured motion changes the mass by {100 * abs(change / mass.value):.0f} %: record the "
            "velocity, or the depth with less noise"
        )
    elif high < 0:
        remark += (
            "A mass below 0 is the force of a spring or of a delay: is force_n positive against the insertion, taken "
            "at the time of depth_mm, and the holder stiff?"
        )
    else:
        factor = max(2.0, mass.sd / (_WANTED * _USUAL_KG))
        remark += (
            f"A mass of {_USUAL_KG:g} kg is found within {100 * _WANTED:.0f} % with about {factor:.2g} times the "
            "acceleration: move faster, or with shorter reversals"
        )
    return MovingMass(estimate, change, (remark,))


def stored(found: Fit) -> Model:
    """Return the fitted friction model with the fitted effects `inertia` and `bias`; a fitted mass is above 0."""
    assert isinstance(found.model, FrictionOnSensor)
    names = {"mass_kg": "inertia", "offset_n": "bias"}
    effects = [
        AddedEffect(names[name], {"size": estimate.value}, {"size": estimate})
        for name, estimate in found.estimates.items()
        if name in names
    ]
    return with_effect(found.model.base, effects) if effects else found.model.base


def _noisier(record: Record, random: np.random.Generator) -> Record:
    """Return the record with noise added to its velocity, or without one to its depth, of the size of that in it."""
    name = "velocity_mm_s" if "velocity_mm_s" in record.columns else "depth_mm"
    return record.with_column(name, record[name] + random.normal(0.0, _noise(record[name]), len(record)))


def _noise(values: Array) -> float:
    """Return the standard deviation of white noise on smooth values, from their third differences."""
    third = np.diff(values, 3)
    return _MAD * float(np.median(np.abs(third - np.median(third)))) / _THIRD_DIFFERENCE_SD if third.size else 0.0
