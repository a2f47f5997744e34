"""Several insertions as a sample of all insertions: mean path, scatter between insertions, predicted tip.

The parameters t_i of insertion i (offset, heading, coefficients of the curvature) are estimated with the covariance
V_i. They scatter between insertions: t_i = t + b_i with cov(b_i) = T, T diagonal. T is estimated by moments
(DerSimonian and Laird), and t by generalised least squares::

    W_i = (V_i + T)^-1,    t = (sum W_i)^-1 sum W_i t_i

The predicted tip of the next insertion at the depth s is y(s; t). Its region is that of the Student distribution with
n - 1 degrees of freedom around it, from the scatter of the n fitted paths at this depth. The region needs no estimate
of T, which few insertions hardly determine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from needleplan.identification._insertion_path import EntryPath, PathShape, trace
from needleplan.models import Estimate
from needleplan.signals import Array

__all__ = ["LeftOutTip", "MeanPath", "TipPrediction", "mean_path", "predict_tip", "predicted"]

# Probability of the region of the predicted tip, and of the intervals of the parameters.
_LEVEL = 0.95


@dataclass(frozen=True)
class LeftOutTip:
    """Check of the prediction by one insertion: its tip is predicted from all other insertions.

    `y_error_mm` and `z_error_mm` are predicted minus measured; `z_error_mm` is None without the other plane. `inside`
    is whether the tip is in the 95 % region; None if one other insertion is left, which determines no region.
    """

    name: str
    y_error_mm: float
    z_error_mm: float | None
    inside: bool | None

    @property
    def distance_mm(self) -> float:
        """Distance (mm) of the predicted tip from the measured tip, in 3D if both planes are known."""
        return float(np.hypot(self.y_error_mm, self.z_error_mm or 0.0))


@dataclass(frozen=True)
class TipPrediction:
    """The predicted tip of the next insertion at a depth (mm along the path), in the frame of the records.

    `y_region_mm` and `z_region_mm` are the sides of a rectangle that contains the tip with a probability of 95 %; None
    for a single insertion. `z_mm` and `z_region_mm` are None if the records have one plane. `left_out` holds the check
    by each insertion; it is empty for a single insertion.
    """

    depth_mm: float
    x_mm: float
    y_mm: float
    z_mm: float | None
    y_region_mm: tuple[float, float] | None
    z_region_mm: tuple[float, float] | None
    left_out: tuple[LeftOutTip, ...]

    @property
    def mean_error_mm(self) -> float | None:
        """Mean distance (mm) of the predicted from the measured tip of the insertions left out; None without any."""
        return float(np.mean([each.distance_mm for each in self.left_out])) if self.left_out else None

    def lines(self) -> list[str]:
        """Return the lines that `needleplan identify` prints."""
        found = [f"predicted tip at a depth of {self.depth_mm:.4g} mm: x {self.x_mm:.2f} mm"]
        for axis, value, region in (("y", self.y_mm, self.y_region_mm), ("z", self.z_mm, self.z_region_mm)):
            if value is not None:
                reach = f" (95 % region {region[0]:.2f} to {region[1]:.2f})" if region else ""
                found.append(f"  {axis} {value:.2f} mm{reach}")
        if self.left_out:
            known = [each.inside for each in self.left_out if each.inside is not None]
            where = f"; {sum(known)} of {len(known)} in the region predicted without them" if known else ""
            largest = max(each.distance_mm for each in self.left_out)
            found.append(
                f"  each insertion predicted from the others: mean error {self.mean_error_mm:.2f} mm, "
                f"largest {largest:.2f} mm{where}"
            )
        else:
            found.append("  no region and no check: one insertion does not determine the scatter between insertions")
        return found


@dataclass(frozen=True)
class MeanPath:
    """Mean path of several insertions.

    `values` are as in `EntryPath` and `covariance` is the covariance of their errors. `between_sd` holds the standard
    deviations of the fitted values between insertions, shape (2 + size,), which contain the errors of the fits; NaN
    for a single insertion. `degrees` is the number of degrees of freedom.
    """

    shape: PathShape
    x_mm: float
    values: Array
    covariance: Array
    between_sd: Array
    degrees: int

    def tip(self, along_mm: float) -> tuple[float, float]:
        """Return x and y (mm) at a position along the path."""
        found = trace(self.shape, self.x_mm, self.values, np.array([along_mm]))
        return float(found[0, 0]), float(found[1, 0])

    def estimate(self, number: int, unit: str) -> Estimate:
        """Return the estimate of the parameter `number` with its 95 % interval and the scatter between insertions."""
        found = self.combination(np.eye(self.values.size)[number], unit)
        between = float(self.between_sd[number])
        return replace(found, between_sd=None if np.isnan(between) else between)

    def combination(self, weights: Array, unit: str) -> Estimate:
        """Return a weighted sum of the parameters with its 95 % interval, without the scatter between insertions."""
        value, sd = float(weights @ self.values), float(np.sqrt(weights @ self.covariance @ weights))
        quantile = stats.t.ppf((1 + _LEVEL) / 2, self.degrees) if self.degrees else stats.norm.ppf((1 + _LEVEL) / 2)
        reach = float(quantile) * sd
        return Estimate(value, sd, value - reach, value + reach, unit, True)


def mean_path(paths: Sequence[EntryPath]) -> MeanPath:
    """Return the mean path of one or more insertions whose paths have the same shape.

    The covariance is scaled up if the insertions scatter more than V_i + T predicts (Hartung and Knapp).
    """
    values = np.array([each.values for each in paths])
    inner = np.array([each.covariance for each in paths])
    entry = float(np.mean([each.x_mm for each in paths]))
    shape = paths[0].shape
    if len(paths) == 1:
        return MeanPath(shape, entry, values[0], inner[0], np.full(values.shape[1], np.nan), 0)
    between = np.array([_between(values[:, k], inner[:, k, k]) for k in range(values.shape[1])])
    # Scaled to unit variances, because heading, offset and curvature differ by many orders of magnitude.
    size = np.sqrt(np.mean(np.diagonal(inner, axis1=1, axis2=2), axis=0) + between**2)
    weights = np.linalg.inv((inner + np.diag(between**2)) / np.outer(size, size))
    spread = np.linalg.inv(weights.sum(axis=0))
    mean = spread @ np.einsum("ijk,ik->j", weights, values / size)
    away = values / size - mean
    degrees = len(paths) - 1
    factor = float(np.einsum("ij,ijk,ik->", away, weights, away)) / (degrees * values.shape[1])
    covariance = spread * max(factor, 1.0) * np.outer(size, size)
    return MeanPath(shape, entry, mean * size, covariance, values.std(axis=0, ddof=1), degrees)


def _between(values: Array, variances: Array) -> float:
    """Return the standard deviation between insertions of one parameter (DerSimonian and Laird)."""
    weight = 1 / variances
    common = float(weight @ values / weight.sum())
    q = float(weight @ (values - common) ** 2)
    spare = float(weight.sum() - (weight**2).sum() / weight.sum())
    return float(np.sqrt(max(0.0, (q - (len(values) - 1)) / spare)))


def predict_tip(paths: Sequence[EntryPath], across: Sequence[EntryPath], along_mm: float) -> TipPrediction:
    """Return the predicted tip at a position along the path, checked by leaving one insertion out.

    `paths` are the insertions in the plane of bending, `across` the same insertions in the other plane, or empty.
    """
    planes = [each for each in (paths, across) if each]
    level = _LEVEL ** (1 / len(planes))
    found = [predicted(each, along_mm, level) for each in planes]
    left_out = []
    for number, path in enumerate(paths if len(paths) > 1 else ()):
        errors, inside = [], []
        for plane in planes:
            middle, reach = predicted([*plane[:number], *plane[number + 1 :]], along_mm, level)
            errors.append(middle - plane[number].measured(along_mm))
            inside.append(abs(errors[-1]) <= reach if reach is not None else None)
        outcome = None if None in inside else all(inside)
        left_out.append(LeftOutTip(path.name, errors[0], errors[1] if across else None, outcome))
    sides = [None if reach is None else (middle - reach, middle + reach) for middle, reach in found]
    x, _ = mean_path(paths).tip(along_mm)
    return TipPrediction(
        along_mm, x, found[0][0], found[1][0] if across else None, sides[0], sides[1] if across else None,
        tuple(left_out),
    )  # fmt: skip


def predicted(paths: Sequence[EntryPath], along_mm: float, level: float) -> tuple[float, float | None]:
    """Return the predicted y (mm) and the half width (mm) of its region, which is None for a single insertion.

    The variance is that of the fitted tips, which contains the errors of the fits, plus the error of the mean.
    """
    middle = mean_path(paths).tip(along_mm)[1]
    if len(paths) == 1:
        return middle, None
    degrees = len(paths) - 1
    scatter = sum((each.tip(along_mm) - middle) ** 2 for each in paths) / degrees
    reach = float(stats.t.ppf((1 + level) / 2, degrees)) * np.sqrt(scatter * (1 + 1 / len(paths)))
    return middle, float(reach)
