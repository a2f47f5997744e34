"""Friction on moving tissue: a needle in tissue that is held by a spring and a damper.

The needle moves with the velocity v, the tissue with s = u'. Friction depends on the difference w = v - s, and the
friction on the needle is the force that moves the tissue (Kelvin and Voigt), equation (3) of
docs/explanation/tissue-motion.md with a mass::

    z' = forcing(w) - rate(w) z          the bristle of any friction model with one linear state
    u' = s
    m s' = F(z, w) - c s - k u

The moving mass m is a few grams, and its inertia is below a millinewton. The equation needs the mass: without it, the
balance F = k u + c s does not determine s if friction falls with the velocity faster than damping rises. With a bent
bristle and mu_s below mu_c, this happens at every reversal, and the balance has three roots. With any mass, the tissue
accelerates from its present velocity to the first root in the direction of the force; the integration takes this root.
If friction itself falls with the velocity (mu_c below mu_s), needle and tissue stick and slip. The jumps are then
shorter than a sample, and single samples of the force are unreliable.

Integration of a needle in moving tissue: one scalar equation per sample, in Python floats.

A step of length h from one sample to the next uses the means of the coefficients at its two ends::

    z+ = (z + A (1 + B/2)) / (1 + B + B^2/2),   A = h (forcing + forcing+)/2,   B = h (rate + rate+)/2
    u+ = u + h (s + s+)/2
    m (s+ - s)/h + c s+ + k u+ = F(z+, v+ - s+)

The first line is exp(-B) z + A (1 - exp(-B))/B to second order, and is stable for any B. The last line is solved for s+
by the secant method, from an extrapolation of the previous velocities. If the secant method does not reach a stable
root, `first_root` searches for it.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Generator
from dataclasses import dataclass, fields
from typing import ClassVar, Protocol

import numpy as np
from scipy.optimize import brentq

from needleplan.models._base import Channel, LinearStateModel, SelfIntegratingModel
from needleplan.models._parameter import constant, parameter
from needleplan.models.friction import AveragedLuGre, Beta, LuGre, LumpedLuGre, OutputForm, Profile, StribeckFriction
from needleplan.signals import Array, Motion

__all__ = [
    "AveragedOnTissue",
    "FrictionLaw",
    "LuGreLaw",
    "LumpedOnTissue",
    "MovingTissue",
    "PointwiseLaw",
    "bristle_step",
    "first_root",
    "step_through",
    "stepping",
]


# Residual force at which a step counts as solved, N.
_TOLERANCE_N = 1e-12
# Number of secant steps before the search for the first root.
_SECANTS = 12
# First step of the search for the first root, mm/s; each further step is 20 % longer.
_FIRST_STEP_MM_S = 0.01
# Change of the tissue velocity beyond which the search gives up and the state becomes NaN, mm/s.
_FARTHEST_MM_S = 1e5


class FrictionLaw(Protocol):
    """Interface of a friction law with one bristle, evaluated with Python floats at a sample of a motion.

    `w_mm_s` is the velocity of the needle relative to the tissue. `bending` is the state of the bristle, `bending_rate`
    the rate of change of this state per second.
    """

    def coefficients(self, sample: int, w_mm_s: float) -> tuple[float, float]:
        """Return the forcing (unit of the bristle per second) and the rate (1/s) of the bristle."""

    def force(self, sample: int, w_mm_s: float, bending: float, bending_rate: float) -> float:
        """Return the friction on the needle (N)."""


def step_through(law: FrictionLaw, k: float, c: float, m: float, motion: Motion, start: Array) -> Array:
    """Return bristle state, tissue displacement (mm) and tissue velocity (mm/s) at every sample, shape (3, samples).

    `start`, shape (3,), is the state at the first sample. All samples after the state has grown without bound are NaN.
    """
    times, needle = motion.time_s.tolist(), motion.velocity_mm_s.tolist()
    bent, moved, speed = (float(number) for number in start)
    steps = stepping(law, k, c, m, needle[0], (bent, moved, speed))
    next(steps)
    rows = [(bent, moved, speed)]
    for sample in range(1, len(times)):
        row = steps.send((sample, times[sample] - times[sample - 1], needle[sample]))
        if row[2] != row[2]:
            break
        rows.append(row[:3])
    states = np.full((3, len(times)), np.nan)
    states[:, : len(rows)] = np.array(rows).T
    return states


def bristle_step(bent: float, half_s: float, forcing: tuple[float, float], rate: tuple[float, float]) -> float:
    """Return the bristle state after a step of twice `half_s`; `forcing` and `rate` have values at both ends."""
    decay = half_s * (rate[0] + rate[1])
    return (bent + half_s * (forcing[0] + forcing[1]) * (1 + decay / 2)) / (1 + decay + decay * decay / 2)


def stepping(
    law: FrictionLaw, k: float, c: float, m: float, velocity: float, start: tuple[float, float, float], first: int = 0
) -> Generator[tuple[float, float, float, float], tuple[int, float, float], None]:
    """Return a generator that integrates step by step, for motions that are not known in advance.

    The generator receives the sample (an index for `law`), the length of the step (s) and the velocity of the needle at
    the end of the step. The generator yields bristle state, tissue displacement (mm), tissue velocity (mm/s) and force
    on the needle (N). All four are NaN if the motion has diverged. `velocity` is the velocity of the needle at the
    sample `first`, and `start` is the state there. `k`, `c` and `m` are stiffness, damping and mass of the tissue.
    """
    coefficients, friction = law.coefficients, law.force
    bent, moved, speed = start
    forcing, rate = coefficients(first, velocity - speed)
    sample, half, held, spring, force = first, 0.0, 0.0, c, 0.0
    new_bent = new_forcing = new_rate = 0.0

    def balance(tried: float) -> float:
        """Return resisting minus driving force on the tissue (N) for the velocity `tried` at the end of the step."""
        nonlocal new_bent, new_forcing, new_rate, force
        relative = velocity - tried
        new_forcing, new_rate = coefficients(sample, relative)
        new_bent = bristle_step(bent, half, (forcing, new_forcing), (rate, new_rate))
        force = friction(sample, relative, new_bent, new_forcing - new_rate * new_bent)
        return held + spring * tried - force

    before = earlier = speed
    slope = c + 1.0
    while True:
        sample, step, velocity = yield bent, moved, speed, force
        half = step / 2
        held = k * (moved + half * speed) - m / step * speed
        spring = c + m / step + k * half
        tried = 3 * (speed - before) + earlier
        error = balance(tried)
        for _ in range(_SECANTS):
            if -_TOLERANCE_N < error < _TOLERANCE_N or not slope > 0:
                break
            last, tried = tried, tried - error / slope
            last_error, error = error, balance(tried)
            if tried == last:
                error = 0.0
                break
            slope = (error - last_error) / (tried - last)
        if not (slope > 0 and -_TOLERANCE_N < error < _TOLERANCE_N):
            tried = first_root(balance, speed)
            slope = c + 1.0
            balance(tried)
        earlier, before, moved, speed = before, speed, moved + half * (speed + tried), tried
        bent, forcing, rate = new_bent, new_forcing, new_rate


def first_root(balance: Callable[[float], float], speed: float) -> float:
    """Return the equilibrium velocity (mm/s) of the tissue nearest to `speed` in the direction of the force, or NaN.

    NaN means that no equilibrium was found. `balance` is the resisting force minus the driving force (N) as a function
    of the velocity: the tissue decelerates if `balance` is positive.
    """
    error = balance(speed)
    if error == 0:
        return speed
    near, step = speed, -_FIRST_STEP_MM_S if error > 0 else _FIRST_STEP_MM_S
    while abs(near - speed) < _FARTHEST_MM_S:
        far = near + step
        beyond = balance(far)
        if beyond != beyond:
            break
        if (beyond > 0) != (error > 0):
            return float(brentq(balance, near, far, xtol=1e-13, rtol=1e-14))
        near, step = far, 1.2 * step
    return float("nan")


@dataclass(frozen=True, kw_only=True)
class MovingTissue(SelfIntegratingModel):
    """Abstract base class of friction on tissue that a spring and a damper hold.

    The state is the bristle, the displacement u (mm) and the velocity u' (mm/s) of the tissue. The output is the
    friction on the needle. A subclass defines the friction model (`friction`), and may define a faster `law`.

    Examples
    --------
    >>> import needleplan as npl
    >>> issubclass(npl.models.LumpedOnTissue, npl.models.MovingTissue)
    True
    """

    channel: ClassVar[Channel] = Channel.FORCE
    stiffness: float = parameter("N/mm", 1e-4, 1e3, "k, stiffness of the spring that holds the tissue")
    damping: float = parameter("N s/mm", 1e-6, 1e2, "c, damping of the tissue")
    mass: float = constant("N s^2/mm", 1e-9, 1e-3, "m, mass of the moving tissue; 1e-6 is a gram", default=1e-6)

    @abstractmethod
    def friction(self) -> LinearStateModel:
        """Return the friction model; the velocity of its motion is relative to the tissue."""

    def law(self, motion: Motion) -> FrictionLaw:
        """Return the friction law along a motion, which the integration evaluates one sample at a time.

        A model with a faster law than the default, `PointwiseLaw`, overrides this method.
        """
        return PointwiseLaw(self.friction(), motion)

    def relative(self, state: Array, motion: Motion) -> Motion:
        """Return the motion with the velocity relative to the tissue; the depth remains the depth of the needle.

        Parameters
        ----------
        state : numpy.ndarray
            State, shape (n, ...); row 2 is the velocity of the tissue (mm/s).
        motion : Motion
            Motion or instant.

        Returns
        -------
        Motion
        """
        velocity = np.asarray(motion.velocity_mm_s - state[2])
        return Motion(motion.time_s, motion.depth_mm, velocity, np.sign(velocity), motion.angle_rad)

    def initial_state(self, motion: Motion) -> Array:
        """Return the state with a straight bristle and undisplaced tissue, shape (3,).

        The tissue moves with the velocity at which the damping of the tissue balances the friction.
        """
        law = self.law(motion)
        velocity = float(np.atleast_1d(motion.velocity_mm_s)[0])

        def balance(speed: float) -> float:
            forcing, _ = law.coefficients(0, velocity - speed)
            return self.damping * speed - law.force(0, velocity - speed, 0.0, forcing)

        return np.array([0.0, 0.0, first_root(balance, 0.0)])

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rates of change of the three states, shape (3, ...)."""
        relative, friction = self.relative(state, motion), self.friction()
        forcing, rate = friction.coefficients(relative)
        force = friction.output(state[:1], relative)
        pull = force - self.damping * state[2] - self.stiffness * state[1]
        return np.array([forcing - rate * state[0], state[2], pull / self.mass])

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the friction (N), shape (...)."""
        return self.friction().output(state[:1], self.relative(state, motion))

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return bristle, displacement u (mm) and velocity u' (mm/s), shape (3, samples); NaN after a divergence."""
        return step_through(self.law(motion), self.stiffness, self.damping, self.mass, motion, start)


class PointwiseLaw:
    """Friction law that evaluates any friction model with one linear state; slow, and the reference for `LuGreLaw`."""

    def __init__(self, friction: LinearStateModel, motion: Motion) -> None:
        self._friction, self._motion = friction, motion

    def coefficients(self, sample: int, w_mm_s: float) -> tuple[float, float]:
        """Return forcing (unit of the bristle per second) and rate (1/s) for a velocity relative to the tissue."""
        forcing, rate = self._friction.coefficients(self._at(sample, w_mm_s))
        return float(forcing), float(rate)

    def force(self, sample: int, w_mm_s: float, bending: float, bending_rate: float) -> float:  # noqa: ARG002
        """Return the friction on the needle (N) for a state `bending` of the bristle; `bending_rate` is not used."""
        return float(self._friction.output(np.array([bending]), self._at(sample, w_mm_s)))

    def _at(self, sample: int, w_mm_s: float) -> Motion:
        needle, velocity = self._motion, np.asarray(w_mm_s)
        return Motion(
            needle.time_s[sample], needle.depth_mm[sample], velocity, np.sign(velocity), needle.angle_rad[sample]
        )


@dataclass(frozen=True, kw_only=True)
class LumpedOnTissue(StribeckFriction, MovingTissue):
    """Model II (`LumpedLuGre`) on tissue that a spring and a damper hold.

    A fit of this model gives the motion of the tissue without the slow observer of the thesis.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import sinusoid
    >>> model = npl.models.LumpedOnTissue(
    ...     mu_c=0.73, sigma2=0.016, sigma0=1.3, sigma1=0.46, mu_s=0.034, alpha=0.09, stiffness=0.5, damping=0.1
    ... )
    >>> motion = sinusoid(offset_mm=60.0, amplitude_mm=10.0, frequency_hz=0.2, cycles=1.0, rate_hz=50.0)
    >>> run = npl.models.simulate(model, motion)
    >>> run.finite, run.states.shape == (3, len(motion))
    (True, True)
    """

    name: ClassVar[str] = "lumped_lugre_on_tissue"
    sigma1: float = parameter("s/mm", 1e-5, 1e3, "damping of the bristles")

    def friction(self) -> LumpedLuGre:
        """Return Model II with the parameters of this model."""
        return LumpedLuGre(**{field.name: getattr(self, field.name) for field in fields(LumpedLuGre)})

    def law(self, motion: Motion) -> FrictionLaw:
        """Return the friction law of Model II along a motion."""
        return LuGreLaw(self.friction(), motion)


@dataclass(frozen=True, kw_only=True)
class AveragedOnTissue(StribeckFriction, MovingTissue):
    """Models III-A and III-B (`AveragedLuGre`) on tissue that a spring and a damper hold.

    `AveragedLuGre` explains `profile` and `beta`, and which of their values the friction model refuses.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import sinusoid
    >>> model = npl.models.AveragedOnTissue(
    ...     mu_c=0.79, sigma2=0.014, sigma0=1.2, sigma1=0.37, mu_s=0.033, alpha=0.09, stiffness=0.5, damping=0.1
    ... )
    >>> motion = sinusoid(offset_mm=60.0, amplitude_mm=10.0, frequency_hz=0.2, cycles=1.0, rate_hz=50.0)
    >>> npl.models.simulate(model, motion).finite
    True
    """

    name: ClassVar[str] = "averaged_lugre_on_tissue"
    sigma1: float = parameter("s/mm", 1e-5, 1e3, "damping of the bristles")
    exponent: float = constant("", 0, 20, "lambda, exponent of the bending along the patch", default=5.0)
    profile: Profile = Profile.ISOSCELES
    beta: Beta = Beta.TRANSPORT

    def friction(self) -> AveragedLuGre:
        """Return Model III with the parameters of this model and the corrected output equation."""
        chosen = {field.name: getattr(self, field.name) for field in fields(AveragedLuGre) if field.name != "form"}
        return AveragedLuGre(**chosen, form=OutputForm.CONSISTENT)

    def law(self, motion: Motion) -> FrictionLaw:
        """Return the friction law of Model III along a motion."""
        return LuGreLaw(self.friction(), motion)


class LuGreLaw:
    """Friction law of LuGre models with the consistent output: `PointwiseLaw`, but fifty times as fast."""

    coefficients: Callable[[int, float], tuple[float, float]]
    force: Callable[[int, float, float, float], float]

    def __init__(self, friction: LuGre, motion: Motion) -> None:
        sigma0, sigma1, sigma2 = friction.sigma0, friction.sigma1, friction.sigma2
        mu_c, drop, alpha, gamma = friction.mu_c, friction.mu_s - friction.mu_c, friction.alpha, friction.gamma
        normal = friction.total_normal_force_n(motion).tolist()
        inside = (motion.depth_mm > 0).tolist()
        transport = [_transport(friction, motion, sign) for sign in (1.0, -1.0)]
        exp = math.exp

        def coefficients(sample: int, w: float) -> tuple[float, float]:  # noqa: ARG001
            speed = w if w > 0 else -w
            return w, sigma0 * speed / (mu_c + drop * exp(-alpha * speed))

        def general(sample: int, w: float) -> tuple[float, float]:
            if not inside[sample]:
                forcing, rate = friction.coefficients(motion[sample])
                return float(forcing), float(rate)
            speed = w if w > 0 else -w
            level = mu_c + drop * exp(-alpha * speed**gamma)
            return w, sigma0 * speed / level - transport[w < 0][sample] * speed

        def force(sample: int, w: float, bending: float, bending_rate: float) -> float:
            result: float = normal[sample] * (sigma0 * bending + sigma1 * bending_rate + sigma2 * w)
            return result

        plain = all(inside) and gamma == 1 and not any(map(any, transport))
        self.coefficients = coefficients if plain else general
        self.force = force


def _transport(friction: LuGre, motion: Motion, sign: float) -> list[float]:
    """Return the transport term of z'/z (1/s) at every sample for the velocity `sign` times 1 mm/s."""
    velocity = np.full(len(motion), sign)
    moved = Motion(motion.time_s, motion.depth_mm, velocity, velocity, motion.angle_rad)
    return [float(transport) for transport in friction.transport_per_s(moved)]
