"""The path of the tip in closed form, for tissue that remembers the path.

Fresh tissue is unstressed where the tip passes. The springs of a long needle are therefore anchored to the path of the
tip. With lam = (kf/4EI)^(1/4), the lateral force P on the tip and the depth s (free end of a semi-infinite beam,
Hetenyi), equation (2) of docs/explanation/deflection.md is::

    y(s) = (2 lam/kf) P(s) + 2 lam int_0^inf exp(-lam xi) cos(lam xi) y(s - xi) dxi

The kernel has the moments 1, 0 and -1/lam^2: a translation or rotation of everything is a solution. The solution needs
no history except two integrals, equation (3)::

    y = (2 lam/kf) [P + 2 lam int P + 2 lam^2 int int P],      y'' = (P + P'/lam + P''/(2 lam^2))/(EI lam)

A constant P gives a circle, R = EI lam/P. At the distance xi behind the tip, the needle lies beside its path by d(xi) =
exp(-lam xi) sin(lam xi)/(2 lam^2 R), and the tip points outward by the angle 1/(2 lam R). A flip of the bevel, P to -P,
makes the path jump by 4 lam P/kf and turn by 8 lam^2 P/kf; no experiment has tested this prediction.

If the tissue keeps only a share mu of the tip's path, y is the response of a second-order system to P, and becomes a
circle only for mu = 1::

    Y/P = (2 lam/kf) [(p + lam)^2 + lam^2]/[p^2 + 2 lam (1 - mu) p + 2 lam^2 (1 - mu)]

The thesis has no such law: its foundation is anchored to the straight line (mu = 0).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from needleplan.artifacts import CallRepr
from needleplan.errors import Mistake, ModelError
from needleplan.models.deflection._beam import ElasticTissue, NeedleShaft
from needleplan.signals import Array

__all__ = ["FreePath", "steady_radius_mm", "tip_path_mm"]


@dataclass(frozen=True)
class FreePath(CallRepr):
    """State of the path law at one depth. `advanced` returns the state at a larger depth.

    `push_n` is P at this depth. `once_n_mm` and `twice_n_mm2` are the first and second integral of P from the entry.
    """

    needle: NeedleShaft
    tissue: ElasticTissue
    depth_mm: float = 0.0
    push_n: float = 0.0
    once_n_mm: float = 0.0
    twice_n_mm2: float = 0.0

    def advanced(self, depth_mm: float, push_n: float) -> FreePath:
        """Return the state at a greater depth, with P linear in between.

        If `depth_mm` is the present depth, P jumps to `push_n`, as at a flip of the bevel.

        Raises ModelError for a smaller depth: the law holds for fresh tissue only.
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
        """Lateral position of the tip, mm."""
        lam, unit = self.tissue.decay_1_mm(self.needle), self._unit
        return unit * (self.push_n + 2 * lam * self.once_n_mm + 2 * lam**2 * self.twice_n_mm2)

    @property
    def heading_rad(self) -> float:
        """Slope of the path for constant P, rad."""
        lam = self.tissue.decay_1_mm(self.needle)
        return self._unit * (2 * lam * self.push_n + 2 * lam**2 * self.once_n_mm)

    @property
    def curvature_1_mm(self) -> float:
        """Curvature of the path for constant P: 1/R = P/(EI lam)."""
        return 1 / steady_radius_mm(self.needle, self.tissue, self.push_n) if self.push_n else 0.0

    @property
    def _unit(self) -> float:
        self.needle.require_uniform("the law of the path")
        return 2 * self.tissue.decay_1_mm(self.needle) / self.tissue.stiffness_n_mm2


def tip_path_mm(needle: NeedleShaft, tissue: ElasticTissue, depth_mm: ArrayLike, push_n: ArrayLike) -> Array:
    """Return the lateral position y of the tip (mm) at every depth, shape (..., samples), by equation (3).

    `push_n`, shape (..., samples), is the lateral force P on the tip (N). P is linear between samples, and jumps at two
    samples with the same depth. `depth_mm`, shape (samples,), must not decrease. Raises ModelError for other shapes or
    depths.
    """
    needle.require_uniform("the law of the path")
    depth, push = np.asarray(depth_mm, float), np.asarray(push_n, float)
    step = np.diff(depth)
    if depth.ndim != 1 or push.shape[-1:] != depth.shape or not (step >= 0).all():
        rule = "must be a row that does not decrease, with a force for every depth"
        raise ModelError(Mistake("depth_mm", f"shape {depth.shape}", rule), "tip path")
    lam = tissue.decay_1_mm(needle)
    at_entry = np.zeros((*push.shape[:-1], 1))
    # First and second integral of P over the depth, exact for a linear P in each step.
    added_once = step * (push[..., 1:] + push[..., :-1]) / 2
    once = np.concatenate([at_entry, np.cumsum(added_once, axis=-1)], axis=-1)
    added_twice = step * once[..., :-1] + step**2 * (2 * push[..., :-1] + push[..., 1:]) / 6
    twice = np.concatenate([at_entry, np.cumsum(added_twice, axis=-1)], axis=-1)
    return np.asarray(2 * lam / tissue.stiffness_n_mm2 * (push + 2 * lam * once + 2 * lam**2 * twice))  # (3)


def steady_radius_mm(needle: NeedleShaft, tissue: ElasticTissue, push_n: float, axial_n: float = 0.0) -> float:
    """Return the radius EI lam/P (mm) of the circle for a constant lateral force P; infinite for P = 0.

    `axial_n` is a constant compression N, which changes the radius by the factor 1 + N/(8 EI lam^2) to first order.
    Raises ModelError if P is not 0 and N reaches the buckling load of the embedded needle, 2 sqrt(EI kf).
    """
    needle.require_uniform("the steady radius")
    bending, spring = needle.bending_stiffness_n_mm2, tissue.stiffness_n_mm2
    if push_n == 0:
        return math.inf
    if axial_n == 0:
        return bending * tissue.decay_1_mm(needle) / push_n
    most = 2 * math.sqrt(bending * spring)
    if not axial_n < most:
        raise ModelError(Mistake("axial_n", f"{axial_n:g}", f"must be less than the buckling load, {most:g} N"))
    square = tissue.decay_1_mm(needle) ** 2
    a, b = math.sqrt(square - axial_n / (4 * bending)), math.sqrt(square + axial_n / (4 * bending))
    spread = axial_n / spring * (3 * a * b**2 - a**3)
    return bending / push_n * (spread + (1 - axial_n**2 / (2 * bending * spring)) * (3 * a**2 - b**2) / (2 * a))
