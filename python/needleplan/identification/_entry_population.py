"""Several insertions as a sample of all insertions: mean path, scatter between insertions, predicted tip.

The parameters of insertion i (offset, heading, coefficients of the curvature) are estimated with their covariance. The
mean of each parameter, or of a sum of parameters, is that of `trials.combine`. The tip of the next insertion at a depth
follows from the fitted tips at this depth, in their order: `population.next_insertion`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.identification._insertion_path import EntryPath, PathShape, trace
from needleplan.identification.population import deviation_mm, new_series, next_insertion, setup_mm, typical_scatter
from needleplan.models import Estimate
from needleplan.models.trials import combine
from needleplan.signals import Array

__all__ = ["LeftOutTip", "MeanPath", "TipPrediction", "mean_path", "predict_tip", "tips_of"]

# Probability of a drift above which the insertions are said to drift.
_DRIFTS = 0.5


@dataclass(frozen=True)
class LeftOutTip:
    """Check of the prediction by one insertion: its tip is predicted from the insertions before it.

    `y_error_mm` and `z_error_mm` are predicted minus measured; `z_error_mm` is None without the other plane. `inside`
    is whether the tip is in the 95 % region.
    """

    name: str
    y_error_mm: float
    z_error_mm: float | None
    inside: bool

    @property
    def distance_mm(self) -> float:
        """Distance (mm) of the predicted tip from the measured tip, in 3D if both planes are known."""
        return float(np.hypot(self.y_error_mm, self.z_error_mm or 0.0))


@dataclass(frozen=True)
class TipPrediction:
    """The predicted tip of the next insertion at a depth (mm along the path), in the frame of the records.

    - `y_region_mm`, `z_region_mm`: sides of a rectangle that contains the tip of the next insertion of this series with
      a probability of 95 %.
    - `y_new_series_mm`, `z_new_series_mm`: the same for an insertion after needle, guide or tissue were set up again.
    - `drift`: probability that the tips of the series drift, in the order in which the insertions were given.
    - `checked`: number of insertions whose errors set the size of the region; 0: the law of the population sets it.
    - `left_out`: check by each insertion but the first.

    All values of z are None if the records have one plane.
    """

    depth_mm: float
    x_mm: float
    y_mm: float
    z_mm: float | None
    y_region_mm: tuple[float, float]
    z_region_mm: tuple[float, float] | None
    y_new_series_mm: tuple[float, float]
    z_new_series_mm: tuple[float, float] | None
    drift: float
    checked: int
    left_out: tuple[LeftOutTip, ...]

    @property
    def mean_error_mm(self) -> float | None:
        """Mean distance (mm) of the predicted from the measured tip of the checks; None for a single insertion."""
        return float(np.mean([check.distance_mm for check in self.left_out])) if self.left_out else None

    def lines(self) -> list[str]:
        """Return the lines that `needleplan identify` prints."""
        lines = [f"predicted tip at a depth of {self.depth_mm:.4g} mm: x {self.x_mm:.2f} mm"]
        for axis, value, region, other in (
            ("y", self.y_mm, self.y_region_mm, self.y_new_series_mm),
            ("z", self.z_mm, self.z_region_mm, self.z_new_series_mm),
        ):
            if value is not None and region is not None and other is not None:
                lines.append(
                    f"  {axis} {value:.2f} mm (95 % region: next insertion of this series {region[0]:.2f} to "
                    f"{region[1]:.2f}, of a new series {other[0]:.2f} to {other[1]:.2f})"
                )
        if not self.left_out:
            return [*lines, "  one insertion does not determine the scatter: the region is that of usual insertions"]
        says = (
            "the insertions drift, so that the last ones count most: keep their order, or set up again"
            if self.drift > _DRIFTS
            else "no drift was found"
        )
        lines.append(f"  order of the {len(self.left_out) + 1} insertions: {says} (probability {self.drift:.0%})")
        if self.checked:
            lines.append(f"  the errors of {self.checked} predicted insertions set the size of the region")
        largest = max(check.distance_mm for check in self.left_out)
        inside = sum(check.inside for check in self.left_out)
        lines.append(
            f"  each insertion predicted from those before it: mean error {self.mean_error_mm:.2f} mm, largest "
            f"{largest:.2f} mm; {inside} of {len(self.left_out)} in the region"
        )
        return lines


@dataclass(frozen=True)
class MeanPath:
    """Mean path of several insertions whose paths have the same shape.

    `fitted` holds the values of the n insertions as in `EntryPath`, shape (n, 2 + size), and `covariances` the
    covariances of their errors, shape (n, 2 + size, 2 + size). `x_mm` is the mean x of the entries.
    """

    shape: PathShape
    x_mm: float
    fitted: Array
    covariances: Array

    @property
    def values(self) -> Array:
        """Mean of each parameter, shape (2 + size,)."""
        return np.array([self.combination(row, "").value for row in np.eye(self.fitted.shape[1])])

    def tip(self, along_mm: float) -> tuple[float, float]:
        """Return x and y (mm) at a position along the path."""
        point = trace(self.shape, self.x_mm, self.values, np.array([along_mm]))
        return float(point[0, 0]), float(point[1, 0])

    def estimate(self, number: int, unit: str) -> Estimate:
        """Return the estimate of the parameter `number` with its 95 % interval and the scatter between insertions."""
        return self.combination(np.eye(self.fitted.shape[1])[number], unit)

    def combination(self, weights: Array, unit: str) -> Estimate:
        """Return a weighted sum of the parameters with its 95 % interval and the scatter between insertions."""
        within = np.sqrt(np.einsum("j,ijk,k->i", weights, self.covariances, weights))
        return combine(self.fitted @ weights, within).estimate(unit, identified=True)


def mean_path(paths: Sequence[EntryPath]) -> MeanPath:
    """Return the mean path of one or more insertions whose paths have the same shape."""
    values, covariances = np.array([path.values for path in paths]), np.array([path.covariance for path in paths])
    return MeanPath(paths[0].shape, float(np.mean([path.x_mm for path in paths])), values, covariances)


def predict_tip(
    paths: Sequence[EntryPath], across: Sequence[EntryPath], along_mm: float, others: Sequence[Array] = ()
) -> TipPrediction:
    """Return the predicted tip at a position along the path, checked by each insertion from those before it.

    `paths` are the insertions in the plane of bending in their order, `across` the same insertions in the other plane,
    or empty. `others` holds the tips (mm) of other series at this position, shape (n, planes) each.
    """
    planes = [plane for plane in (paths, across) if plane]
    tips = tips_of(planes, along_mm)
    scatter = typical_scatter(others, deviation_mm(along_mm))
    forecast = next_insertion(tips, scatter)
    other = new_series([*others, tips], forecast, setup_mm(along_mm))
    left_out = []
    for number in range(1, len(paths)):
        earlier = next_insertion(tips[:number], scatter)
        measured = np.array([plane[number].measured(along_mm) for plane in planes])
        errors = (earlier.values - measured).tolist()
        inside = bool(((earlier.low <= measured) & (measured <= earlier.high)).all())
        left_out.append(LeftOutTip(paths[number].name, errors[0], errors[1] if across else None, inside))
    x, _ = mean_path(paths).tip(along_mm)
    values, regions, wide = forecast.values.tolist(), forecast.regions, other.regions
    return TipPrediction(
        along_mm, x, values[0], values[1] if across else None, regions[0], regions[1] if across else None,
        wide[0], wide[1] if across else None, forecast.drift, forecast.checked, tuple(left_out),
    )  # fmt: skip


def tips_of(planes: Sequence[Sequence[EntryPath]], along_mm: float) -> Array:
    """Return the fitted tips (mm) of n insertions at a position along the path, shape (n, planes)."""
    return np.array([[path.tip(along_mm) for path in plane] for plane in planes]).T
