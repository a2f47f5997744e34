"""Exact solution of the beam equation for a needle that is anchored to the straight line (path = 0).

In the tissue the characteristic polynomial is EI r^4 + b r + kf = (r^2 + 2 p r + m)(r^2 - 2 p r + n) EI. a = 4 p^2 is
the positive root of::

    a^3 - 4 (kf/EI) a - (b/EI)^2 = 0,      m = (a - b/(EI sqrt(a)))/2,   n = (a + b/(EI sqrt(a)))/2

u is a sum of exp(-p x) {cos, sin}(q1 x), with x from the entry point, and exp(-p y) {cos, sin}(q2 y), with y from the
tip. These functions never exceed one. Outside, u is a cubic, clamped at the base. The two coefficients of the cubic are
eliminated analytically, which reduces the 6 x 6 system of the two sub-beams to 4 x 4.

The result has ten correct digits for depths above a quarter of 1/lam. At a fortieth of 1/lam it has eight, because the
four functions are then nearly dependent. Axial load (`AxialTerms.CONSISTENT`) has no such solution; use
`solve_elements`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from needleplan.artifacts import CallRepr
from needleplan.errors import Mistake, ModelError
from needleplan.models.deflection._beam import Beam
from needleplan.signals import Array

__all__ = ["ExactShape", "solve_exact"]

# Newton steps for the root of the resolvent cubic.
_NEWTON_STEPS = 12


@dataclass(frozen=True)
class ExactShape(CallRepr):
    """Shapes of bent needles.

    `decay_1_mm` is p, and `wave_1_mm` are (q1, q2) of the module docstring, shape (insertions,) each. `weights` are the
    coefficients of the four functions, shape (4, insertions).
    """

    beam: Beam
    decay_1_mm: Array
    wave_1_mm: tuple[Array, Array]
    weights: Array

    @property
    def tip_mm(self) -> Array:
        """Deflection of the tip, mm, of the shape of the beam's coefficients."""
        return self.at(0.0)

    def at(self, behind_tip_mm: ArrayLike) -> Array:
        """Return the deflection (mm) at a distance behind the tip.

        If the beam has several insertions, `behind_tip_mm` must broadcast to their shape. Raises ModelError if
        broadcasting gives another shape.
        """
        return self._derivative(np.asarray(behind_tip_mm, float), 0)

    def _derivative(self, behind: Array, order: int) -> Array:
        flat, shape = self.beam.flat(), self.beam.shape
        distance = np.broadcast_to(behind, np.broadcast_shapes(behind.shape, shape))
        if shape and distance.shape != shape:
            rule = f"must broadcast with the insertions, {shape}"
            raise ModelError(Mistake("behind_tip_mm", f"shape {behind.shape}", rule), "deflection")
        place = distance.reshape(-1)
        inside = np.clip(place, 0.0, flat.depth_mm)
        x = flat.depth_mm - inside
        values = _basis(x, flat.depth_mm, self.decay_1_mm, self.wave_1_mm)
        at_place = np.einsum("fn,fdn->dn", self.weights, values)
        entry = np.einsum("fn,fdn->dn", self.weights, _basis(0 * x, flat.depth_mm, self.decay_1_mm, self.wave_1_mm))
        outside = np.clip(flat.length_mm - place, 0.0, None)
        cubic = entry[3] / 6
        square = (entry[2] - entry[3] * (flat.length_mm - flat.depth_mm)) / 2
        free = square * outside**2 + cubic * outside**3 if order == 0 else 2 * square * outside + 3 * cubic * outside**2
        result: Array = np.where(place <= flat.depth_mm, at_place[order], free)
        return result.reshape(distance.shape)


def solve_exact(beam: Beam) -> ExactShape:
    """Return the exact shape of the needle for every insertion in `beam`, with a clamped base and a straight path.

    Raises ModelError for axial load, and for friction so strong that the shape contains no decaying waves.
    """
    if np.any(beam.tip_axial_n) or np.any(beam.axial_rate_n_mm):
        rule = "axial load has no solution in exponentials; use solve_elements"
        raise ModelError(Mistake("terms", "consistent", rule), "deflection")
    if beam.steps:
        rule = "a stiffness that changes along the shaft has no solution in exponentials; use solve_elements"
        raise ModelError(Mistake("stiffness_steps", str(beam.steps), rule), "deflection")
    flat = beam.flat()
    p, waves = _roots(flat)
    depth, outer = flat.depth_mm, flat.length_mm - flat.depth_mm
    entry, tip = _basis(np.zeros_like(depth), depth, p, waves), _basis(depth, depth, p, waves)
    # Rows: compatibility of displacement and slope with the clamped outer beam; moment and shear at the tip. Each row
    # is scaled by powers of p and, for the outer beam, of its length.
    system = np.empty((depth.size, 4, 4))
    system[:, 0] = (entry[:, 0] - outer**2 / 2 * entry[:, 2] + outer**3 / 3 * entry[:, 3]).T
    system[:, 1] = (entry[:, 1] - outer * entry[:, 2] + outer**2 / 2 * entry[:, 3]).T
    system[:, 2] = tip[:, 2].T
    system[:, 3] = (tip[:, 3] + flat.tip_follow_n / flat.bending_n_mm2 * tip[:, 1]).T
    system[:, 0] *= (1 / (1 + (p * outer) ** 3))[:, None]
    system[:, 1] *= (1 / (p * (1 + (p * outer) ** 2)))[:, None]
    system[:, 2] *= (1 / p**2)[:, None]
    system[:, 3] *= (1 / p**3)[:, None]
    loads = np.zeros((depth.size, 4, 1))
    loads[:, 2, 0] = flat.tip_moment_n_mm / flat.bending_n_mm2 / p**2
    loads[:, 3, 0] = -flat.tip_push_n / flat.bending_n_mm2 / p**3
    return ExactShape(beam, p, waves, np.asarray(np.linalg.solve(system, loads)[:, :, 0].T, float))


def _roots(flat: Beam) -> tuple[Array, tuple[Array, Array]]:
    """Return p and (q1, q2) of the module docstring."""
    stiffness, friction = flat.foundation_n_mm2 / flat.bending_n_mm2, flat.slope_n_mm / flat.bending_n_mm2
    a: Array = 2 * np.sqrt(stiffness) + np.cbrt(friction**2)
    for _ in range(_NEWTON_STEPS if np.any(friction) else 0):  # from above, where the cubic is convex: no overshoot
        a = a - (a**3 - 4 * stiffness * a - friction**2) / (3 * a**2 - 4 * stiffness)
    shift = friction / np.sqrt(a)
    squares = a / 4 - shift / 2, a / 4 + shift / 2
    if min(float(square.min(initial=1.0)) for square in squares) <= 0:
        rule = "friction bends the needle more than the foundation: no decaying waves; use solve_elements"
        raise ModelError(Mistake("friction_n_s_mm2", "", rule), "deflection")
    half: Array = np.sqrt(a) / 2
    return half, (np.sqrt(squares[0]), np.sqrt(squares[1]))


def _basis(x: Array, depth: Array, p: Array, waves: tuple[Array, Array]) -> Array:
    """Return the derivatives 0 to 3 of the four functions at x from the entry point, shape (4, 4, insertions).

    The first axis is the function, the second the order of the derivative.
    """
    values = np.empty((4, 4, x.size))
    for start, (distance, rate, q) in enumerate(((x, -p, waves[0]), (depth - x, p, waves[1]))):
        size, angle = np.exp(-p * distance), q * distance
        cosine, sine = size * np.cos(angle), size * np.sin(angle)
        turn = q if start == 0 else -q  # the second pair runs against x
        one, two = values[2 * start], values[2 * start + 1]
        one[0], two[0] = cosine, sine
        for order in range(3):
            one[order + 1] = rate * one[order] - turn * two[order]
            two[order + 1] = rate * two[order] + turn * one[order]
    return values
