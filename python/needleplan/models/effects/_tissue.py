"""Effects of tissue motion: compliant tissue moves with the needle, and breathing moves the tissue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from needleplan import _ppvi
from needleplan.models._base import Model, WrappingModel
from needleplan.models._parameter import parameter
from needleplan.models._simulate import simulate
from needleplan.models.effects._laws import breathing
from needleplan.models.friction import BlendedReversal, ShaftAndTip, slid_along
from needleplan.signals import Array, Motion

__all__ = ["BreathingTissue", "GivingTissue", "SlowTurning", "breathing_forces"]

# Number of breathing motions that are simulated at once, chosen so that their arrays fit into the processor's cache.
_AT_ONCE = 16


@dataclass(frozen=True, kw_only=True)
class SlowTurning(WrappingModel):
    """The base model, part of whose friction reverses over a travel that is longer by `size` (mm).

    The state is (z, z_long), the bristles of the base and of this part. The force is linear in the bristle, so the
    shaft has the force of (1 - share) z + share z_long, and the tip that of (1 - tip) z + tip z_long.
    """

    base: ShaftAndTip
    size: float = parameter("mm", 0, 20, "additional travel over which friction reverses", typical=0.1)
    share: float = parameter("", 0, 1, "share of the shaft's friction with this travel", typical=1.0, default=1.0)
    tip: float = parameter("", 0, 1, "share of the tip's force with this travel", typical=1.0, default=1.0)

    @cached_property
    def slow(self) -> ShaftAndTip:
        """The base model with the longer travel, clipped to its range; the base model itself if the amplitude is 0."""
        longest = self.base.parameters()["presliding_mm"].upper
        travel = min(self.base.presliding_mm + self.size, longest)
        return self.base.with_values(presliding_mm=travel) if self.size else self.base

    def initial_state(self, motion: Motion) -> Array:
        """Return the states of both bristles at rest, shape (2,)."""
        return np.concatenate([self.base.initial_state(motion), self.slow.initial_state(motion)])

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of change of both bristles, shape (2, ...)."""
        return np.concatenate([self.base.derivative(state[:1], motion), self.slow.derivative(state[1:], motion)])

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the axial force (N), shape (...)."""
        return self.shaft_n(state, motion) + self.tip_n(state, motion)

    def shaft_n(self, state: Array, motion: Motion) -> Array:
        """Return the friction along the shaft (N), shape (...)."""
        return self.base.shaft_n(_blend(state, self.share), motion)

    def tip_n(self, state: Array, motion: Motion) -> Array:
        """Return the force on the tip (N), shape (...)."""
        return self.base.tip_n(_blend(state, self.tip), motion)

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return both bristles (dimensionless, -1 to 1) at every sample, shape (2, samples)."""
        return np.concatenate([self.base.integrate(motion, start[:1]), self.slow.integrate(motion, start[1:])])


def _blend(state: Array, share: float) -> Array:
    """Return (1 - share) of the first bristle plus `share` of the second, shape (1, ...)."""
    return state[:1] + share * (state[1:2] - state[:1])


@dataclass(frozen=True, kw_only=True)
class GivingTissue(WrappingModel):
    """A model in compliant tissue, which moves with the needle (Kelvin and Voigt).

    The bristle z of the base model, from -1 to 1, represents the friction. Friction displaces the tissue by u (mm):
    lag u' = s z - u. The velocity relative to the tissue, v - u', drives the bristle. The state is (z, u).

    The largest displacement s = size (1 - growth + growth L / 50 mm) may grow with the inserted length L. If each layer
    of the tissue is held where it is, the friction of the layer displaces the layer: `growth` is 0. If the tissue is
    held as a whole, as an organ by its ligaments, the friction of the whole shaft displaces it: `growth` is 1. Both
    springs in series give values between. Beside a `SlowTurning`, its longer bristle represents the friction.
    """

    base: ShaftAndTip | SlowTurning
    size: float = parameter("mm", 0, 50, "largest displacement of the tissue at 50 mm inserted length", typical=0.5)
    lag_s: float = parameter("s", 1e-3, 20, "time constant, damping over stiffness")
    growth: float = parameter(
        "", 0, 1, "share of the displacement in proportion to the inserted length", typical=1.0, default=0.0
    )

    def largest_mm(self, motion: Motion) -> Array:
        """Return the displacement of the tissue (mm) that complete friction causes, at each sample."""
        inserted = np.maximum(np.asarray(motion.depth_mm, float), 0.0)
        return np.asarray(self.size * (1 - self.growth + self.growth * inserted / _REFERENCE_MM))

    def initial_state(self, motion: Motion) -> Array:
        """Return the bristles of the base at rest and a tissue displacement of 0, shape (n + 1,)."""
        return np.append(self.base.initial_state(motion), 0.0)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of change of the bristles and of the tissue displacement, shape (n + 1, ...)."""
        tissue = (self.largest_mm(motion) * state[-2] - state[-1]) / self.lag_s
        sliding = replace(motion, velocity_mm_s=np.asarray(motion.velocity_mm_s - tissue))
        return np.concatenate([self.base.derivative(state[:-1], sliding), np.asarray(tissue)[None]])

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the axial force (N), shape (...)."""
        return self.base.output(state[:-1], motion)

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the bristles (-1 to 1) and the tissue displacement u (mm), shape (n + 1, samples).

        u is 0 if `size` is 0.
        """
        if not self.size:
            return np.vstack([self.base.integrate(motion, start[:-1]), np.full(len(motion), float(start[-1]))])
        inner = self.base.slow if isinstance(self.base, SlowTurning) else self.base
        velocity, time = np.asarray(motion.velocity_mm_s, float), np.asarray(motion.time_s, float)
        sizes = self.largest_mm(motion)
        given = self.lag_s, inner.presliding_mm, float(start[-2]), float(start[-1])
        dragged = _dragged(velocity.tobytes(), time.tobytes(), sizes.tobytes(), *given)
        if isinstance(self.base, ShaftAndTip) and not isinstance(self.base, BlendedReversal):
            return dragged
        sliding = replace(motion, velocity_mm_s=velocity - (sizes * dragged[0] - dragged[1]) / self.lag_s)
        bristle = dragged[0] + inner.deviation(sliding) if isinstance(inner, BlendedReversal) else dragged[0]
        if not isinstance(self.base, SlowTurning):
            return np.vstack([bristle, dragged[1]])
        return np.vstack([self.base.base.integrate(sliding, start[:1]), bristle, dragged[1]])


@lru_cache(maxsize=64)
def _dragged(
    velocity_mm_s: bytes,
    time_s: bytes,
    largest_mm: bytes,
    lag_s: float,
    presliding_mm: float,
    bristle: float,
    moved: float,
) -> Array:
    """Return bristle and tissue displacement (mm) at every sample, shape (2, samples), as a read-only array.

    Velocities, times and largest displacements are byte strings, so that the result can be cached. `bristle` and
    `moved` are the first state.

    Each step uses the trapezoidal rule for the tissue.
    """
    velocity, time, largest = (np.frombuffer(data) for data in (velocity_mm_s, time_s, largest_mm))
    states: Array = _ppvi.dragged(velocity, time, largest, lag_s, presliding_mm, (bristle, moved))
    states.flags.writeable = False
    return states


# Inserted length (mm) at which `GivingTissue.size` is the largest displacement, whatever its growth.
_REFERENCE_MM = 50.0


@dataclass(frozen=True, kw_only=True)
class BreathingTissue(WrappingModel):
    """A model whose tissue moves along the needle by breathing; the state is the state of the base model.

    The displacement of the tissue is u = size/2 (sin a - rest/2 cos^2 a + rest) with a = 2 pi f t + phase. For rest 0,
    u is a sine. For rest 1, u is size ((1 + sin a)/2)^2, which dwells at exhalation (u = 0), the usual form for organs
    (Lujan et al., Med. Phys. 26 (1999) 715, n = 2). For rest -1, u dwells at the other end, as for a needle that comes
    from the opposite side.
    """

    base: Model
    size: float = parameter("mm", 0, 60, "displacement from one end to the other", typical=0.5)
    frequency_hz: float = parameter("Hz", 0.02, 5, "frequency of the breathing")
    phase_rad: float = parameter("rad", -20, 20, "phase at the beginning of a trial", typical=1.0)
    rest: float = parameter("", -1, 1, "dwell: 0 is a sine, 1 dwells at exhalation, -1 at inhalation", typical=1.0)

    def relative(self, motion: Motion) -> Motion:
        """Return the motion of the needle relative to the tissue; `motion` itself if the amplitude is 0."""
        if not self.size:
            return motion
        times = np.asarray(motion.time_s, float).tobytes()
        moved, speed = _breath(times, self.frequency_hz, self.phase_rad, self.rest)
        shape = np.shape(motion.time_s)
        depth = motion.depth_mm - self.size * moved.reshape(shape)
        velocity = motion.velocity_mm_s - self.size * speed.reshape(shape)
        return Motion(motion.time_s, depth, velocity, np.sign(velocity), motion.angle_rad)

    def initial_state(self, motion: Motion) -> Array:
        """Return the state of the base at rest."""
        return self.base.initial_state(motion)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of change of the state of the base in the relative motion."""
        return self.base.derivative(state, self.relative(motion))

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the output of the base in the relative motion."""
        return self.base.output(state, self.relative(motion))

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the states of the base for the motion relative to the tissue, shape (n, samples)."""
        return simulate(self.base, self.relative(motion), start).states


@lru_cache(maxsize=16)
def _breath(time_s: bytes, frequency_hz: float, phase_rad: float, rest: float) -> tuple[Array, Array]:
    """Return displacement (mm) and velocity (mm/s) of breathing tissue for amplitude 1, as read-only arrays.

    `time_s` is the byte string of the times, so that the result can be cached: a fit asks for the same times
    repeatedly.
    """
    place, velocity = breathing(np.frombuffer(time_s), frequency_hz, phase_rad, rest)
    place.flags.writeable = velocity.flags.writeable = False
    return place, velocity


def breathing_forces(base: ShaftAndTip, motion: Motion, breaths: Sequence[Mapping[str, float]]) -> Array:
    """Return the force (N) for each of several breathing motions of the tissue, shape (breaths, samples).

    Each entry of `breaths` holds all parameters of `BreathingTissue` by name. The forces equal those of
    `BreathingTissue`; several motions are computed at once, which is faster.
    """
    forces = np.empty((len(breaths), len(motion)))
    sizes = np.array([[breath["size"]] for breath in breaths])
    rows = np.array([[breath[name] for name in ("frequency_hz", "phase_rad", "rest")] for breath in breaths])
    kinds, which = np.unique(rows, axis=0, return_inverse=True)  # many entries differ in their amplitude only
    moved, speed = breathing(motion.time_s, *kinds.T[..., None])
    for first in range(0, len(breaths), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        kind, size = which.ravel()[part], sizes[part]
        depth, velocity = motion.depth_mm - size * moved[kind], motion.velocity_mm_s - size * speed[kind]
        bristle = slid_along(velocity, motion.time_s, base.presliding_mm)
        along = Motion(motion.time_s, depth, velocity, np.sign(velocity), motion.angle_rad)
        forces[part] = base.output(bristle[None], along)
    return forces
