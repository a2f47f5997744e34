"""Several insertions as a sample of all insertions: mean path, scatter between insertions, predicted tip.

The parameters of insertion i (offset, heading, coefficients of the curvature) are estimated with their covariance. The
mean of each parameter, or of a sum of parameters, is that of `trials.combine`. The predicted tip of the next insertion
at a depth is the mean of the fitted tips at this depth, and its region is the range of the next trial.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.identification._insertion_path import EntryPath, PathShape, trace
from needleplan.models import Estimate
from needleplan.models.trials import combine
from needleplan.signals import Array

__all__ = ["LeftOutTip", "MeanPath", "TipPrediction", "mean_path", "predict_tip", "predicted"]

# Probability of the region of the predicted tip.
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
        found = trace(self.shape, self.x_mm, self.values, np.array([along_mm]))
        return float(found[0, 0]), float(found[1, 0])

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
    """Return the predicted y (mm) and the half width (mm) of its region, which is None for a single insertion."""
    mean = combine([path.tip(along_mm) for path in paths])
    region = mean.next_trial(level)
    return mean.value, None if region is None else region[1] - mean.value
