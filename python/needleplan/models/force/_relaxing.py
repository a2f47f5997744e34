"""Axial force that relaxes: an elastic tissue with up to two Maxwell branches, capsules that break, and layers.

The needle at the depth x has passed the depth X at most. It stretches the tissue from a reference depth a on: the
contact, or the deepest capsule that has broken. With the extension u = x - a > 0, the stiffness ratio m(x) of the layer
and the stiffness k exp(b u), the elastic force E and the force q of a branch obey equation (3) of
docs/explanation/force.md::

    E' = m k exp(b u) x'          q' = g m k exp(b u) x' - q/tau

E is a function of the depth. A branch is a spring of g times the stiffness in series with a damper (Maxwell): at rest q
decays with the time constant tau. For u <= 0 there is no extension, and q only decays.

**Capsule.** At X = d the capsule breaks. E and q are released: their sum R decays with the travel beyond d, R' = -(R/r)
X', while the next tissue is stretched from a = d on, with E = q = 0. R is continuous at the break, so that the force is
a continuous function of d, and d can be fitted. A **layer** begins without a break: only m changes.

**Friction and cutting.** Beyond the first capsule (without one: beyond the contact c) the shaft rubs and the tip cuts::

    F = E + q1 + q2 + R + f (x - c) sign(x') + F_c (1 - exp(-(X - c)/r)) exp(-(X - x)/r) [x' > 0]

**Exact step.** Between two samples the depth is linear, x' = v. A step is divided where it crosses c or a boundary. In
a part of the duration h that ends at the extension u+, equation (4)::

    q+ = exp(-h/tau) q + g m k v h exp(b u+) phi(y),     y = (b v + 1/tau) h,     phi(y) = (1 - exp(-y))/y

The result therefore does not depend on the sampling rate. In an insertion at constant speed without a dwell, a branch
adds exp(b u) times a constant, minus a transient: it hardly differs from a stiffer spring. A dwell, or two speeds, are
needed to identify a branch.

Sources: Maxwell branches in parallel with a spring, Fung, Biomechanics (1993), section 7; elastic tissue, puncture,
friction and cutting in sequence, Okamura, Simone, O'Leary, IEEE Trans. Biomed. Eng. 51 (2004) 1707.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from needleplan.models._base import Channel, SelfIntegratingModel
from needleplan.models._parameter import constant, parameter
from needleplan.signals import Array, Motion, recurrence

__all__ = ["BOUNDARIES", "NOWHERE_MM", "RelaxingForce"]

# Largest number of capsules and layers.
BOUNDARIES = 4

# Depth (mm) of a boundary that does not exist.
NOWHERE_MM = 1000.0


def _boundary() -> Any:
    about = "depth of a capsule or layer; 1000: none"
    return parameter("mm", 0, NOWHERE_MM, about, default=NOWHERE_MM, typical=1.0, free=False)


def _ratio() -> Any:
    about = "ratio of the stiffness beyond the boundary to the stiffness at the contact"
    return parameter("", 1e-3, 1e3, about, default=1.0, free=False)


def _breaks() -> Any:
    return constant("", 0, 1, "1: a capsule that breaks; 0: a layer that begins", default=1.0)


@dataclass(frozen=True)
class RelaxingForce(SelfIntegratingModel):
    """Force of an elastic tissue that relaxes, with capsules that break and layers.

    The model gives the axial force (N) of a motion. The state is (X, q1, q2, R): largest depth (mm), forces of the two
    branches and released force (N). The equations stand in docs/explanation/force.md, (3) and (4).

    A branch is a spring in series with a damper, parallel to the spring of the tissue; a branch with the stiffness 0
    does not exist. Friction and cutting act from the depth c on: the depth of the first capsule, or the contact if
    there is no capsule. `fit` estimates branches, boundaries and ratios only if `free` names them.

    Examples
    --------
    A tissue is stretched by 10 mm in 1 s and held: the branch relaxes, the spring does not.

    >>> import numpy as np
    >>> import needleplan as npl
    >>> from needleplan.signals import Motion
    >>> motion = Motion.sampled(np.array([0.0, 1.0, 2.0, 21.0]), np.array([0.0, 10.0, 10.0, 10.0]))
    >>> model = npl.models.RelaxingForce(stiffness=0.05, branch_1=1.0, time_1_s=2.0)
    >>> print(npl.models.simulate(model, motion).output.round(2))
    [0.   0.9  0.74 0.5 ]
    """

    name: ClassVar[str] = "relaxing_force"
    channel: ClassVar[Channel] = Channel.FORCE

    contact_mm: float = parameter(
        "mm", 0, 500, "depth at which the needle touches the tissue", default=0.0, typical=1.0
    )
    stiffness: float = parameter("N/mm", 1e-7, 1e2, "stiffness k at the contact", default=0.01)
    growth: float = parameter("1/mm", 1e-4, 5, "growth b of the logarithm of the stiffness", default=1e-3)
    branch_1: float = parameter(
        "", 0, 1e3, "ratio g of the stiffness of branch 1 to k", default=0.0, typical=0.5, free=False
    )
    time_1_s: float = parameter("s", 1e-3, 1e4, "time constant of branch 1", default=1.0, free=False)
    branch_2: float = parameter(
        "", 0, 1e3, "ratio g of the stiffness of branch 2 to k", default=0.0, typical=0.5, free=False
    )
    time_2_s: float = parameter("s", 1e-3, 1e4, "time constant of branch 2", default=20.0, free=False)
    friction: float = parameter("N/mm", 0, 10, "friction f per length beyond the depth c", default=0.0, typical=0.01)
    cutting: float = parameter("N", 0, 50, "cutting force F_c beyond the depth c", default=0.0, typical=0.1)
    boundary_1_mm: float = _boundary()
    ratio_1: float = _ratio()
    breaks_1: float = _breaks()
    boundary_2_mm: float = _boundary()
    ratio_2: float = _ratio()
    breaks_2: float = _breaks()
    boundary_3_mm: float = _boundary()
    ratio_3: float = _ratio()
    breaks_3: float = _breaks()
    boundary_4_mm: float = _boundary()
    ratio_4: float = _ratio()
    breaks_4: float = _breaks()
    release_mm: float = constant("mm", 1e-3, 10, "travel r over which a released force decays", default=0.3)

    @property
    def boundaries(self) -> list[tuple[float, float, bool]]:
        """The capsules and layers that exist, by depth: depth (mm), stiffness ratio, and whether it breaks."""
        rows = (
            (getattr(self, f"boundary_{n}_mm"), getattr(self, f"ratio_{n}"), getattr(self, f"breaks_{n}") > 0)
            for n in range(1, BOUNDARIES + 1)
        )
        return sorted(row for row in rows if row[0] < NOWHERE_MM)

    @property
    def sliding_mm(self) -> float:
        """Depth c from which on there is friction and cutting: the first capsule, or the contact (mm)."""
        return next((depth for depth, _, breaks in self.boundaries if breaks), self.contact_mm)

    def initial_state(self, motion: Motion) -> Array:
        """Return the first depth and three forces of 0, shape (4,)."""
        return np.array([float(np.ravel(motion.depth_mm)[0]), 0.0, 0.0, 0.0])

    def derivative(self, state: Array, motion: Motion) -> Array:
        """Return the time derivatives of X (mm/s), q1, q2 and R (N/s) while no capsule breaks, shape (4, ...)."""
        depth, speed = np.asarray(motion.depth_mm, float), np.asarray(motion.velocity_mm_s, float)
        growing = np.where(depth >= state[0], np.maximum(speed, 0.0), 0.0)
        loading = self._slope(depth, self._reference(state[0])) * speed
        return np.array([
            growing,
            self.branch_1 * loading - state[1] / self.time_1_s,
            self.branch_2 * loading - state[2] / self.time_2_s,
            -state[3] / self.release_mm * growing,
        ])  # fmt: skip

    def output(self, state: Array, motion: Motion) -> Array:
        """Return the axial force (N), shape (...)."""
        deepest, depth = np.asarray(state[0]), np.asarray(motion.depth_mm, float)
        from_mm, direction = self.sliding_mm, np.asarray(motion.direction)
        rubbing = self.friction * np.maximum(depth - from_mm, 0.0) * direction
        begun = -np.expm1(-np.maximum(deepest - from_mm, 0.0) / self.release_mm)
        fresh = np.exp(-np.maximum(deepest - depth, 0.0) / self.release_mm) * (direction > 0)
        elastic = self.elastic_n(depth, deepest)
        return np.asarray(elastic + state[1] + state[2] + state[3] + rubbing + self.cutting * begun * fresh)

    def elastic_n(self, depth_mm: Array, deepest_mm: Array) -> Array:
        """Return the elastic force E.

        Parameters
        ----------
        depth_mm : numpy.ndarray
            Depths (mm), shape (...).
        deepest_mm : numpy.ndarray
            Largest depths so far (mm), shape (...).

        Returns
        -------
        numpy.ndarray
            Force (N), shape (...).
        """
        begin = self._reference(deepest_mm)
        total = np.zeros(np.broadcast_shapes(np.shape(depth_mm), np.shape(begin)))
        for low, high, ratio in self._layers():
            lowest, highest = np.maximum(begin, low), np.maximum(begin, high)
            ends = np.clip(depth_mm, lowest, highest) - begin, lowest - begin
            upper, lower = (np.expm1(self.growth * np.asarray(end)) for end in ends)
            total += ratio * self.stiffness / self.growth * np.maximum(upper - lower, 0.0)
        return np.asarray(total)

    def integrate(self, motion: Motion, start: Array) -> Array:
        """Return X (mm), q1, q2 and R (N), shape (4, samples); exact if the depth is linear between samples."""
        time, depth, sampled = self._divided(motion)
        deepest = np.maximum(np.maximum.accumulate(depth), start[0])
        step, travel = np.diff(time), np.diff(depth)
        loading = self._slope((depth[1:] + depth[:-1]) / 2, self._reference(deepest[:-1]), depth[1:]) * travel
        released = np.exp(-np.diff(deepest) / self.release_mm)
        states = np.vstack([deepest, np.zeros((3, depth.size))])
        states[1:, 0] = start[1:]
        breaks = sorted({d for d, _, breaks in self.boundaries if breaks and start[0] < d <= deepest[-1]})
        places = [0, *(int(np.argmax(deepest >= d)) for d in breaks), depth.size - 1]
        for number, (begin, end) in enumerate(pairwise(places)):
            if number:
                elastic = float(self.elastic_n(depth[begin], np.nextafter(breaks[number - 1], 0.0)))
                states[3, begin] += elastic + states[1, begin] + states[2, begin]
                states[1:3, begin] = 0.0
            part = slice(begin, end)
            for row, share, lasting in ((1, self.branch_1, self.time_1_s), (2, self.branch_2, self.time_2_s)):
                exponent = self.growth * travel[part] + step[part] / lasting
                offset = share * loading[part] * _phi(exponent)
                states[row, begin : end + 1] = recurrence(np.exp(-step[part] / lasting), offset, states[row, begin])
            states[3, begin : end + 1] = recurrence(released[part], np.zeros(end - begin), states[3, begin])
        return np.asarray(states[:, sampled])

    def step(self, state: Array, before: Motion, after: Motion) -> Array:
        """Return the states after one step, shape (4, m). Raises NotImplementedError for a step over a boundary."""
        first, last = float(before.depth_mm), float(after.depth_mm)
        levels = np.concatenate([np.ravel(self.contact_mm), *(np.ravel(depth) for depth, _, _ in self.boundaries)])
        if first != last and ((levels >= min(first, last)) & (levels <= max(first, last))).any():
            raise NotImplementedError
        h, middle = float(after.time_s) - float(before.time_s), np.full(state.shape[1], (first + last) / 2)
        loading = self._slope(middle, self._reference(state[0]), np.full_like(middle, last)) * (last - first)
        deepest = np.maximum(state[0], last)
        rows = [deepest]
        for row, share, lasting in ((1, self.branch_1, self.time_1_s), (2, self.branch_2, self.time_2_s)):
            offset = share * loading * _phi(self.growth * (last - first) + h / lasting)
            rows.append(np.exp(-h / lasting) * state[row] + offset)
        return np.array([*rows, np.exp((state[0] - deepest) / self.release_mm) * state[3]])

    def _layers(self) -> list[tuple[float, float, float]]:
        """Return the layers: first depth, last depth (mm) and stiffness ratio of each."""
        rows = [(self.contact_mm, 1.0), *((depth, ratio) for depth, ratio, _ in self.boundaries)]
        ends = [*(depth for depth, _ in rows[1:]), np.inf]
        return [(depth, end, ratio) for (depth, ratio), end in zip(rows, ends, strict=True)]

    def _reference(self, deepest: Array) -> Array:
        """Return the depth a (mm) from which on the tissue is stretched, shape (...)."""
        begin = np.full(np.shape(deepest), self.contact_mm)
        for depth, _, breaks in self.boundaries:
            if breaks:
                begin = np.where(np.asarray(deepest) >= depth, np.maximum(depth, self.contact_mm), begin)
        return begin

    def _slope(self, depth: Array, begin: Array, at: Array | None = None) -> Array:
        """Return m k exp(b u) (N/mm), shape (...), 0 for u <= 0: m and the sign of u at `depth`, exp(b u) at `at`."""
        ratio = np.ones(np.shape(depth))
        for low, _, each in self._layers()[1:]:
            ratio = np.where(depth >= low, each, ratio)
        reached = depth if at is None else at
        return np.asarray(
            np.where(depth > begin, ratio * self.stiffness * np.exp(self.growth * (reached - begin)), 0.0)
        )

    def _divided(self, motion: Motion) -> tuple[Array, Array, Any]:
        """Return times and depths with the crossings of contact and boundaries, and the indices of the samples."""
        times, depths = [motion.time_s], [motion.depth_mm]
        first, last = motion.depth_mm[:-1], motion.depth_mm[1:]
        for level in (self.contact_mm, *(depth for depth, _, _ in self.boundaries)):
            (inside,) = np.nonzero((first - level) * (last - level) < 0)
            share = (level - first[inside]) / (last[inside] - first[inside])
            times.append(motion.time_s[inside] + share * motion.interval_s[inside])
            depths.append(np.full(inside.size, level))
        time, depth = np.concatenate(times), np.concatenate(depths)
        order = np.argsort(time, kind="stable")
        sampled = np.argsort(order, kind="stable")[: len(motion)]
        return time[order], depth[order], sampled


def _phi(y: Array | float) -> Array:
    """Return (1 - exp(-y))/y, 1 at y = 0; shape (...)."""
    small = np.abs(y) < 1e-9
    return np.where(small, 1.0 - y / 2, -np.expm1(-y) / np.where(small, 1.0, y))
