"""Intrinsic curvature of a needle from the curvatures that sensors along the needle measure.

Least squares of equation (5) of docs/explanation/needle-shape.md over all sensors in the tissue, with the covariance
s^2 (J^T J)^-1; s is the given standard deviation of a curvature, or else that of the residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from scipy.special import ndtri, stdtrit

from needleplan.artifacts import ShortRepr
from needleplan.errors import DataError, Mistake
from needleplan.models._estimates import Estimate
from needleplan.models.deflection._rod import LayeredShape
from needleplan.signals import Array

__all__ = ["ShapeFit", "fit_shape"]

# Curvature (1/mm) above which the unit is questioned: a radius of 10 mm, which no steerable needle has in tissue.
_LARGEST_PER_MM = 0.1

# Unit (1/mm) of the coordinates of the fit: all fitted parameters are curvatures.
_SCALE_PER_MM = 1e-3


@dataclass(frozen=True)
class ShapeFit(ShortRepr):
    """A shape that was fitted to measured curvatures.

    Parameters
    ----------
    model : LayeredShape
        The fitted shape.
    estimates : dict of str to Estimate
        The fitted parameters with 95 % intervals. A parameter is identified if its standard deviation is below 1/m, or
        below its value.
    residual_per_mm : numpy.ndarray
        Measured minus fitted curvatures, shape (n, k, 2); NaN where nothing was measured.

    Examples
    --------
    >>> from needleplan.models import LayeredShape
    >>> from needleplan.models.deflection import fit_shape
    >>> truth = LayeredShape(0.003, start_n_per_mm=0.003)
    >>> measured = truth.curvatures([120.0], [10.0, 30.0, 65.0, 100.0])
    >>> fitted = fit_shape(LayeredShape(0.001, start_n_per_mm=0.001), [120.0], [10.0, 30.0, 65.0, 100.0], measured)
    >>> round(fitted.model.intrinsic_per_mm, 6), fitted.rms_per_mm < 1e-9
    (0.003, True)
    """

    model: LayeredShape
    estimates: dict[str, Estimate]
    residual_per_mm: Array

    @property
    def rms_per_mm(self) -> float:
        """Root mean square of the residuals, 1/mm."""
        return float(np.sqrt(np.nanmean(self.residual_per_mm**2)))


def fit_shape(
    start: LayeredShape,
    depth_mm: ArrayLike,
    from_tip_mm: ArrayLike,
    curvature_per_mm: ArrayLike,
    *,
    free: Sequence[str] = ("intrinsic_per_mm", "start_n_per_mm", "start_b_per_mm"),
    sd_per_mm: float | None = None,
) -> ShapeFit:
    """Fit kappa_c and omega_init to measured curvatures of one needle at one or more depths.

    Parameters
    ----------
    start : LayeredShape
        First guess, with the boundary of the layers and the constants.
    depth_mm : array_like
        Inserted lengths (mm), shape (n,).
    from_tip_mm : array_like
        Distances of the sensors from the tip (mm), increasing, shape (k,).
    curvature_per_mm : array_like
        Measured curvatures along the axes n and b of the needle (1/mm), shape (n, k, 2); NaN: not measured.
    free : sequence of str
        Parameters to fit, curvatures of `LayeredShape`. `start_twist_per_mm` and `second_per_mm` can be added.
    sd_per_mm : float, optional
        Standard deviation of a measured curvature. Default: estimated from the residuals.

    Returns
    -------
    ShapeFit

    Raises
    ------
    DataError
        The sensors are out of order, a curvature is implausibly large, or there are fewer curvatures than parameters.
    """
    depth, behind = np.atleast_1d(np.asarray(depth_mm, float)), np.atleast_1d(np.asarray(from_tip_mm, float))
    measured = np.asarray(curvature_per_mm, float)
    mistakes = []
    wrong = [name for name in free if not name.endswith("_per_mm") or name not in start.values()]
    if wrong:
        names = ", ".join(name for name in start.values() if name.endswith("_per_mm"))
        mistakes.append(Mistake("free", ", ".join(wrong), f"must be parameters of the shape: {names}"))
    if not (behind >= 0).all() or not (np.diff(behind) > 0).all():
        rule = "must increase from 0 or more: the distances of the sensors from the tip, the nearest first"
        mistakes.append(Mistake("from_tip_mm", f"{behind.tolist()}", rule))
    if measured.shape != (depth.size, behind.size, 2):
        rule = (
            f"must be one row for each depth, a curvature along n and b for each sensor: {(depth.size, behind.size, 2)}"
        )
        mistakes.append(Mistake("curvature_per_mm", f"shape {measured.shape}", rule))
    elif np.nanmax(np.abs(measured), initial=0.0) > _LARGEST_PER_MM:
        rule = f"is above {_LARGEST_PER_MM:g} 1/mm, which no needle has in tissue; in 1/m? Then divide by 1000"
        mistakes.append(Mistake("curvature_per_mm", f"{np.nanmax(np.abs(measured)):.3g}", rule))
    if mistakes:
        raise DataError(mistakes)
    counts = np.isfinite(measured) & (depth[:, None, None] >= behind[None, :, None])
    if counts.sum() < len(free):
        rule = f"must be at least {len(free)}, the parameters to fit: too few sensors are in the tissue"
        raise DataError(Mistake("curvatures that were measured", f"{int(counts.sum())}", rule))
    declared = LayeredShape.parameters()

    def changed(coordinates: Array) -> LayeredShape:
        near = np.clip(coordinates, *bounds) * _SCALE_PER_MM
        return start.with_values(**dict(zip(free, near.tolist(), strict=True)))

    def misses(coordinates: Array) -> Array:
        return np.asarray((changed(coordinates).curvatures(depth, behind) - measured)[counts] / _SCALE_PER_MM)

    bounds = np.array([(declared[name].lower, declared[name].upper) for name in free]).T / _SCALE_PER_MM
    first = np.array([start.values()[name] for name in free]) / _SCALE_PER_MM
    solution = least_squares(
        misses, first, bounds=(bounds[0], bounds[1]), x_scale=1.0, xtol=1e-12, ftol=1e-12, gtol=1e-12
    )
    model = changed(solution.x)
    spare = int(counts.sum()) - len(free)
    residual_sd = np.sqrt(2 * solution.cost / spare) * _SCALE_PER_MM if spare else np.inf
    spread = residual_sd if sd_per_mm is None else sd_per_mm
    reach = float(stdtrit(max(spare, 1), 0.975) if sd_per_mm is None else ndtri(0.975))
    slopes = np.asarray(solution.jac)
    covariance = np.linalg.pinv(slopes.T @ slopes)
    estimates = {}
    for name, at_bound, variance in zip(free, solution.active_mask, np.diag(covariance), strict=True):
        value, sd = model.values()[name], float(spread * np.sqrt(variance))
        known = bool(not at_bound and sd < max(abs(value), _SCALE_PER_MM))
        estimates[name] = Estimate(value, sd, value - reach * sd, value + reach * sd, "1/mm", known)
    residual = np.where(counts, measured - model.curvatures(depth, behind), np.nan)
    return ShapeFit(model, estimates, residual)
