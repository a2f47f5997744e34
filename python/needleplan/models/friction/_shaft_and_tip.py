"""Friction along the inserted shaft and cutting at the tip: a lumped model of the axial force of an insertion.

::

    z' = (v - |v| z) / presliding                                       -1 <= z <= 1: Dahl's bristle
    F  = friction L z + cutting (1 - exp(-L / onset)) (1 + z)/2

L is the inserted length. The bristle depends on the path only and not on the velocity: friction is the same at any
velocity, and at rest the force keeps its value. The tip resists while it is pushed in and not on retraction: after a
retraction by x, (1 + z)/2 is exp(-x / presliding).

Sources: Dahl, AIAA J. 14 (1976) 1675; Okamura et al., IEEE Trans. Biomed. Eng. 51 (2004) 1707, who separate the forces
of shaft and tip. Further phenomena of tissue and sensor are effects (`needleplan.models.effects`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import ClassVar

import numpy as np
from scipy.special import gammaincinv

from needleplan import _ppvi
from needleplan.models._base import Channel, SelfIntegratingModel
from needleplan.models._parameter import parameter
from needleplan.models.friction._law_curves import LawCurves
from needleplan.signals import Array, AveragedMotion, Motion

__all__ = ["BlendedReversal", "ShaftAndTip", "slid", "slid_along"]


def slid(motion: Motion, length_mm: float, start: float = 0.0) -> Array:
    """Return Dahl's bristle z with z' = (v - |v| z)/length along a motion, shape (samples,), read-only.

    `start` is z at the first sample. The result is exact for a velocity that is linear between samples, including
    reversals within a step: on each side of a reversal, z approaches the sign of the velocity exponentially with the
    travel.
    """
    velocity, time = np.asarray(motion.velocity_mm_s, float), np.asarray(motion.time_s, float)
    return _slid(velocity.tobytes(), time.tobytes(), float(length_mm), float(start))


def slid_along(velocity_mm_s: Array, time_s: Array, length_mm: float) -> Array:
    """Return Dahl's bristle for many motions at the same times, shape (motions, samples), each from z = 0.

    `velocity_mm_s` has the shape (motions, samples).
    """
    return _ppvi.slid(np.ascontiguousarray(velocity_mm_s), np.ascontiguousarray(time_s), [length_mm], 0.0)


@lru_cache(maxsize=32)
def _slid(velocity_mm_s: bytes, time_s: bytes, length_mm: float, start: float) -> Array:
    """Return the bristle, shape (samples,), read-only.

    Velocities and times are byte strings, so that the result can be cached: a fit repeats the same motion and length.
    """
    bristle: Array = _ppvi.slid(np.frombuffer(velocity_mm_s)[None], np.frombuffer(time_s), [length_mm], start)[0]
    bristle.flags.writeable = False
    return bristle


@dataclass(frozen=True, kw_only=True)
class ShaftAndTip(SelfIntegratingModel):
    """Axial force of friction and cutting (N), positive if it resists insertion.

    The state is the bristle, from -1 to 1.

    Examples
    --------
    >>> import needleplan as npl
    >>> from needleplan.signals import insertion_cycles
    >>> model = npl.models.ShaftAndTip(friction=0.01, cutting=0.5, onset_mm=3.0, presliding_mm=0.5)
    >>> run = npl.models.simulate(model, insertion_cycles(50.0, 5.0))
    >>> print(f"{run.output.max():.2f} N, {run.output.min():.2f} N")
    1.00 N, -0.47 N
    """

    name: ClassVar[str] = "shaft_and_tip"
    channel: ClassVar[Channel] = Channel.FORCE

    friction: float = parameter("N/mm", 1e-6, 10, "friction per inserted length")
    cutting: float = parameter("N", 1e-5, 100, "cutting force of the tip, deep in the tissue")
    onset_mm: float = parameter("mm", 1e-2, 50, "depth over which the cutting force rises")
    presliding_mm: float = parameter("mm", 1e-3, 20, "travel over which friction reverses")
    curves: LawCurves | None = field(
        default=None,
        repr=False,
        metadata={"about": "measured deviations of friction and cutting force from these laws"},
    )

    def initial_state(self, motion: Motion) -> Array:  # noqa: ARG002
        """Return z = 0, the straight bristle, shape (1,)."""
        return np.zeros(1)

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the rate of the bristle (1/s), shape (1, ...)."""
        velocity = np.asarray(motion.velocity_mm_s, float)
        return np.asarray((velocity - np.abs(velocity) * state) / self.presliding_mm)

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the bristle along a motion, shape (1, samples)."""
        return slid(motion, self.presliding_mm, float(start[0]))[None]

    def shaft_n(self, state: Array, motion: Motion) -> Array:
        """Return the friction force of the shaft.

        Parameters
        ----------
        state : numpy.ndarray
            State, shape (n, ...).
        motion : Motion
            Motion or instant.

        Returns
        -------
        numpy.ndarray
            Force (N), shape (...).
        """
        return self._forces_n(state, motion)[0] if self.curves else self._law_n(state, motion)

    def tip_n(self, state: Array, motion: Motion) -> Array:
        """Return the force of the tip.

        Parameters
        ----------
        state : numpy.ndarray
            State, shape (n, ...).
        motion : Motion
            Motion or instant.

        Returns
        -------
        numpy.ndarray
            Force (N), shape (...).
        """
        return self._forces_n(state, motion)[1]

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the axial force (N), shape (...)."""
        shaft, tip = self._forces_n(state, motion)
        return shaft + tip

    def _law_n(self, state: Array, motion: Motion) -> Array:
        return np.asarray(self.friction * np.maximum(motion.depth_mm, 0.0) * state[0])

    def _forces_n(self, state: Array, motion: Motion) -> tuple[Array, Array]:
        """Return friction and cutting force (N), shape (...) each, by the laws and their curves."""
        depth = np.asarray(motion.depth_mm, float)
        grown = _grown(depth.tobytes(), self.onset_mm) if depth.ndim == 1 else _growing(depth, self.onset_mm)
        shaft, full = self._law_n(state, motion), self.cutting * grown
        tip = np.asarray(full * (1 + state[0]) / 2)
        return self.curves.changed(shaft, tip, full, motion) if self.curves else (shaft, tip)


def _growing(depth_mm: Array, onset_mm: float) -> Array:
    return np.asarray(-np.expm1(-np.maximum(depth_mm, 0.0) / onset_mm))


@lru_cache(maxsize=32)
def _grown(depth_mm: bytes, onset_mm: float) -> Array:
    """Return the cutting force as a share of its value deep in the tissue, shape (samples,).

    `depth_mm` is the byte string of the depths, so that the result can be cached.
    """
    return _growing(np.frombuffer(depth_mm), onset_mm)


@dataclass(frozen=True, kw_only=True)
class BlendedReversal(ShaftAndTip):
    """A `ShaftAndTip` with another law of reversal: the bristle is blended with bristles of other lengths."""

    name: ClassVar[str] = "blended_reversal"
    shares: tuple[float, ...] = ()
    """Lengths of the other bristles, in units of `presliding_mm`."""

    weights: tuple[float, ...] = ()
    """Weight of each of them; they replace the same weight of the model's own bristle."""

    closed: float = 0.0
    """Weight of elastoplastic contacts, which close their small loops; they too replace the model's own bristle."""

    def closing(self, motion: Motion) -> Array:
        """Return the difference of elastoplastic contacts and Dahl's bristle, shape (samples,).

        Both have the same curve after a reversal from sliding to sliding. They differ in their memory: a contact that
        goes to and fro by less than the presliding length returns to the force from which it came (Iwan, J. Appl. Mech.
        33 (1966) 893), while Dahl's bristle creeps to zero. For an `AveragedMotion`, it is the mean over its intervals.
        """
        if isinstance(motion, AveragedMotion):
            return motion.mean(self.closing(motion.fine))
        velocity, time = np.asarray(motion.velocity_mm_s, float), np.asarray(motion.time_s, float)
        return _closing(velocity.tobytes(), time.tobytes(), self.presliding_mm)

    def others(self, motion: Motion) -> Array:
        """Return the differences of the other bristles and Dahl's bristle, shape (shares, samples).

        For an `AveragedMotion`, they are means over its intervals.
        """
        if isinstance(motion, AveragedMotion):
            return motion.mean(self.others(motion.fine))
        velocity, time = np.asarray(motion.velocity_mm_s, float), np.asarray(motion.time_s, float)
        return _others(velocity.tobytes(), time.tobytes(), self.presliding_mm, self.shares)

    def deviation(self, motion: Motion) -> Array:
        """Return the difference of the blended bristle and Dahl's bristle, shape (samples,).

        For an `AveragedMotion`, it is the mean over its intervals.
        """
        if isinstance(motion, AveragedMotion):  # the mean of the blend costs less than a blend of 15 means
            return motion.mean(self.deviation(motion.fine))
        blended = np.asarray(np.array(self.weights) @ self.others(motion))
        return blended + self.closed * self.closing(motion) if self.closed else blended

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return the blended bristle along a motion, shape (1, samples)."""
        return super().integrate(motion, start) + self.deviation(motion)


@lru_cache(maxsize=64)
def _others(velocity_mm_s: bytes, time_s: bytes, length_mm: float, shares: tuple[float, ...]) -> Array:
    """Return the difference of bristles of other lengths and the bristle of `length_mm`, shape (shares, samples)."""
    lengths = [length_mm, *(share * length_mm for share in shares)]
    plain, *others = _ppvi.slid(np.frombuffer(velocity_mm_s)[None], np.frombuffer(time_s), lengths, 0.0)
    differences: Array = np.array(others) - plain
    differences.flags.writeable = False
    return differences


# Elastoplastic elements, and the travel over which each yields, in presliding lengths: quantiles of the law (Gamma of
# shape 2) that gives Dahl's curve from sliding to sliding.
_ELEMENTS = 24
_QUANTILES = gammaincinv(2.0, (np.arange(_ELEMENTS) + 0.5) / _ELEMENTS)
_YIELDS: list[float] = (_QUANTILES / _QUANTILES.mean()).tolist()


@lru_cache(maxsize=64)
def _closing(velocity_mm_s: bytes, time_s: bytes, length_mm: float) -> Array:
    """Return the mean of elastoplastic elements minus Dahl's bristle of the same length, shape (samples,).

    An element stretches by 1 over its yield travel, and slides at -1 and 1.
    """
    differences: Array = _ppvi.yielding(np.frombuffer(velocity_mm_s), np.frombuffer(time_s), length_mm, _YIELDS)
    differences -= _slid(velocity_mm_s, time_s, length_mm, 0.0)
    differences.flags.writeable = False
    return differences
