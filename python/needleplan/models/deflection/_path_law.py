"""Where the tip goes in tissue that remembers its path, in closed form.

Fresh tissue is unstressed where the tip passes, so the springs of a long needle are anchored to where the tip has been.
With lam = (kf/4EI)^(1/4), P the lateral force on the tip and s the depth (free end of a semi-infinite beam, Hetenyi)::

    y(s) = (2 lam/kf) P(s) + 2 lam int_0^inf exp(-lam xi) cos(lam xi) y(s - xi) dxi

The kernel has the moments 1, 0, -1/lam^2: moving or turning everything changes nothing. Its solution needs no history
but two integrals::

    y = (2 lam/kf) [P + 2 lam int P + 2 lam^2 int int P],      y'' = (P + P'/lam + P''/(2 lam^2))/(EI lam)

A constant P makes a circle, R = EI lam/P. Behind the tip the needle is at
d(xi) = exp(-lam xi) sin(lam xi)/(2 lam^2 R) beside the path, and its tip looks 1/(2 lam R) to the outside of it.
A bevel flip, P to -P, makes the path jump by 4 lam P/kf and turn by 8 lam^2 P/kf; no experiment has tested that.

Where the tissue keeps only a part mu of the tip's path, y is the response of a second-order system to P, and becomes
a circle only for mu = 1::

    Y/P = (2 lam/kf) [(p + lam)^2 + lam^2]/[p^2 + 2 lam (1 - mu) p + 2 lam^2 (1 - mu)]

The thesis has none of this: its foundation is anchored to the straight line (mu = 0).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from needleplan.errors import Mistake, ModelError
from needleplan.models.deflection._beam import ElasticTissue, NeedleShaft
from needleplan.signals import Array

__all__ = ["FreePath", "circle_push_n", "flip_jump", "side_slip", "steady_radius_mm", "tip_path_mm"]


@dataclass(frozen=True)
class FreePath:
    """The tip at a depth, to be advanced step by step at a cost that does not grow with the depth.

    `push_n` is P there, and `once_n_mm`, `twice_n_mm2` its first and second integral from the entry.
    """

    needle: NeedleShaft
    tissue: ElasticTissue
    depth_mm: float = 0.0
    push_n: float = 0.0
    once_n_mm: float = 0.0
    twice_n_mm2: float = 0.0

    def advanced(self, depth_mm: float, push_n: float) -> FreePath:
        """Return the tip at a greater depth, P linear on the way; at the same depth P jumps (a flip of the bevel).

        Raises ModelError for a smaller depth: the law is that of fresh tissue.
        """
        step = depth_mm - self.depth_mm
        if not step >= 0:
            rule = f"must not be less than the depth reached, {self.depth_mm:g} mm"
            raise ModelError(Mistake("depth_mm", f"{depth_mm:g}", rule), "tip path")
        once = self.once_n_mm + step * (self.push_n + push_n) / 2
        twice = self.twice_n_mm2 + step * self.once_n_mm + step**2 * (2 * self.push_n + push_n) / 6
        return FreePath(self.needle, self.tissue, depth_mm, push_n, once, twice)

    @property
    def lateral_mm(self) -> float:
        """Lateral position of the tip."""
        lam, unit = self.tissue.decay_1_mm(self.needle), self._unit
        return unit * (self.push_n + 2 * lam * self.once_n_mm + 2 * lam**2 * self.twice_n_mm2)

    @property
    def heading_rad(self) -> float:
        """Direction of the path where P is constant: the slope of y."""
        lam = self.tissue.decay_1_mm(self.needle)
        return self._unit * (2 * lam * self.push_n + 2 * lam**2 * self.once_n_mm)

    @property
    def curvature_1_mm(self) -> float:
        """Curvature of the path where P is constant: 1/R = P/(EI lam)."""
        return 1 / steady_radius_mm(self.needle, self.tissue, self.push_n) if self.push_n else 0.0

    @property
    def _unit(self) -> float:
        return 2 * self.tissue.decay_1_mm(self.needle) / self.tissue.stiffness_n_mm2


def tip_path_mm(needle: NeedleShaft, tissue: ElasticTissue, depth_mm: ArrayLike, push_n: ArrayLike) -> Array:
    """Return y at the depths, shape (..., samples): the law above for P that is linear between samples.

    `depth_mm` (samples,) does not decrease; two samples at one depth are a jump of P. `push_n` has the shape
    (..., samples). Raises ModelError.
    """
    depth, push = np.asarray(depth_mm, float), np.asarray(push_n, float)
    step = np.diff(depth)
    if depth.ndim != 1 or push.shape[-1:] != depth.shape or not (step >= 0).all():
        rule = "must be a row that does not decrease, with a force for every depth"
        raise ModelError(Mistake("depth_mm", f"shape {depth.shape}", rule), "tip path")
    lam = tissue.decay_1_mm(needle)
    none = np.zeros((*push.shape[:-1], 1))
    once = np.concatenate([none, np.cumsum(step * (push[..., 1:] + push[..., :-1]) / 2, axis=-1)], axis=-1)
    added = step * once[..., :-1] + step**2 * (2 * push[..., :-1] + push[..., 1:]) / 6
    twice = np.concatenate([none, np.cumsum(added, axis=-1)], axis=-1)
    return np.asarray(2 * lam / tissue.stiffness_n_mm2 * (push + 2 * lam * once + 2 * lam**2 * twice))


def steady_radius_mm(needle: NeedleShaft, tissue: ElasticTissue, push_n: float, axial_n: float = 0.0) -> float:
    """Return the radius of the circle that a constant lateral force makes, EI lam/P, mm; infinite for no force.

    `axial_n` is a constant compression N of the needle, which changes it by the factor 1 + N/(8 EI lam^2) at first
    order. Raises ModelError where N is at the load that buckles the embedded needle, 2 sqrt(EI kf), or beyond.
    """
    bending, spring = needle.bending_stiffness_n_mm2, tissue.stiffness_n_mm2
    if push_n == 0:
        return math.inf
    if axial_n == 0:
        return bending * tissue.decay_1_mm(needle) / push_n
    most = 2 * math.sqrt(bending * spring)
    if not axial_n < most:
        raise ModelError(Mistake("axial_n", f"{axial_n:g}", f"must be less than {most:g} N, where it buckles"))
    square = tissue.decay_1_mm(needle) ** 2
    a, b = math.sqrt(square - axial_n / (4 * bending)), math.sqrt(square + axial_n / (4 * bending))
    spread = axial_n / spring * (3 * a * b**2 - a**3)
    return bending / push_n * (spread + (1 - axial_n**2 / (2 * bending * spring)) * (3 * a**2 - b**2) / (2 * a))


def circle_push_n(needle: NeedleShaft, tissue: ElasticTissue, depth_mm: ArrayLike, radius_mm: float) -> Array:
    """Return the lateral force (N) that makes a circle tangent at the entry: it rises over a length of some 1/lam."""
    lam = tissue.decay_1_mm(needle)
    angle = lam * np.asarray(depth_mm, float)
    rise = 1 - np.exp(-angle) * (np.cos(angle) + np.sin(angle))
    return np.asarray(needle.bending_stiffness_n_mm2 * lam / radius_mm * rise)


def side_slip(
    needle: NeedleShaft, tissue: ElasticTissue, radius_mm: float, behind_tip_mm: ArrayLike = 0.0
) -> tuple[Array, float]:
    """Return how far the needle lies beside its path at a distance behind the tip (mm), and its slope less the path's.

    Of a circle, steady. The slope is that at the tip (rad): negative, to the outside.
    """
    lam = tissue.decay_1_mm(needle)
    angle = lam * np.asarray(behind_tip_mm, float)
    return np.asarray(np.exp(-angle) * np.sin(angle) / (2 * lam**2 * radius_mm)), -1 / (2 * lam * radius_mm)


def flip_jump(needle: NeedleShaft, tissue: ElasticTissue, push_n: float) -> tuple[float, float]:
    """Return the jump (mm) and turn (rad) of the path where P becomes -P, towards the new side; not validated."""
    lam, spring = tissue.decay_1_mm(needle), tissue.stiffness_n_mm2
    return 4 * lam * push_n / spring, 8 * lam**2 * push_n / spring
