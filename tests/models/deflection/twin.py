"""The slow obvious twin: the two sub-beams as they are written, by collocation (scipy's solve_bvp)."""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_bvp

from needleplan.models.deflection import Beam
from needleplan.signals import Array


def collocation(beam: Beam, path: Callable[[Array], Array] | None = None) -> Callable[[float], float]:
    """Return the deflection by distance behind the tip; `path` is a function of the place in the tissue."""
    made = {name: float(value) for name, value in vars(beam).items() if name != "steps"}
    inside, bending = made["depth_mm"], made["bending_n_mm2"]
    outside = made["length_mm"] - inside

    def rates(t: Array, y: Array) -> Array:
        x = t * inside
        axial = made["tip_axial_n"] + made["axial_rate_n_mm"] * (inside - x)
        entry = made["tip_axial_n"] + made["axial_rate_n_mm"] * inside
        anchor = path(x) if path else 0.0
        fourth = -(axial * y[6] + made["slope_n_mm"] * y[5] + made["foundation_n_mm2"] * (y[4] - anchor)) / bending
        outer = np.stack([y[1], y[2], y[3], -entry * y[2] / bending]) * outside
        return np.concatenate([outer, np.stack([y[5], y[6], y[7], fourth]) * inside])

    def ends(a: Array, b: Array) -> Array:
        shear = bending * b[7] + made["tip_push_n"] + made["tip_follow_n"] * b[5]
        moment = bending * b[6] - made["tip_moment_n_mm"]
        return np.concatenate([a[:2], b[:4] - a[4:], [moment / bending, shear / bending]])

    grid = np.linspace(0, 1, 41)
    solution = solve_bvp(rates, ends, grid, np.zeros((8, grid.size)), tol=1e-10, max_nodes=100_000)
    assert solution.success, solution.message

    def at(behind_mm: float) -> float:
        if behind_mm <= inside:
            return float(solution.sol((inside - behind_mm) / inside)[4])
        return float(solution.sol((made["length_mm"] - behind_mm) / outside)[0])

    return at
