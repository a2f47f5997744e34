"""What the axial force adds: vf, and the offset F0 if kf is known, or kf if F0 is known."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from scipy import stats

from needleplan.identification.bent_path import beyond
from needleplan.models import Estimate, Fit, InsertionForce, TipPath, fit
from needleplan.models.deflection import AxialOffset
from needleplan.signals import Record

__all__ = ["axial_estimates"]

_NORMAL = float(stats.norm.ppf(0.975))
_ROUNDS = 6


def axial_estimates(
    records: Sequence[Record],
    path: TipPath,
    cutting_force: Estimate,
    curvature: Estimate,
    factor: Callable[[float], tuple[float, float]],
    skip_mm: float,
    offset: AxialOffset | None,
) -> tuple[dict[str, Estimate], Fit]:
    """Return friction and axial_offset, or with a given `offset` friction, cutting_force and stiffness; and the fit.

    `cutting_force` is that of the deflection with the kf that is assumed; `factor` gives g and its deviation for a kf.
    Raises DataError.
    """
    start = InsertionForce(0.0 if offset is None else offset.value_n, 1e-5, abs(cutting_force.value), path.bevel)
    free = ["friction", "offset" if offset is None else "cutting_force"]
    result = fit(start, records, free=free, mask=lambda record: beyond(record, skip_mm))
    friction, own = (result.estimates[name] for name in free)
    if offset is None:
        sd = math.hypot(own.sd, cutting_force.sd * math.sin(path.bevel))
        return {"friction": friction, "axial_offset": _normal(own.value, sd)}, result
    force = _normal(own.value, math.hypot(own.sd, offset.sd_n / math.sin(path.bevel)))
    stiffness = _stiffness(path, force, curvature, factor)
    return {"friction": friction, "cutting_force": force, "stiffness": stiffness}, result


def _stiffness(
    path: TipPath, force: Estimate, curvature: Estimate, factor: Callable[[float], tuple[float, float]]
) -> Estimate:
    """Return kf = 4 EI (Fc cos a/(EI g |curvature|))^4: four times the relative errors of force, curvature and g."""
    bend, limits = abs(curvature.value), path.parameters()["stiffness"]
    if force.value <= 0 or bend == 0:
        return Estimate(math.nan, math.inf, 0.0, math.inf, "N/mm2", identified=False)
    value, g, sd = path.stiffness, 1.0, 0.0
    for _ in range(_ROUNDS):  # g hardly depends on kf
        g, sd = factor(value)
        lam = force.value * math.cos(path.bevel) / (path.bending * bend * g)
        value = min(max(4 * path.bending * lam**4, limits.lower), limits.upper)
    relative = 4 * math.sqrt((force.sd / force.value) ** 2 + (curvature.sd / bend) ** 2 + (sd / g) ** 2)
    low, high = (value * math.exp(sign * _NORMAL * relative) for sign in (-1, 1))
    return Estimate(value, relative * value, low, high, "N/mm2", identified=relative < 1)


def _normal(value: float, sd: float) -> Estimate:
    return Estimate(value, sd, value - _NORMAL * sd, value + _NORMAL * sd, "N", identified=True)
