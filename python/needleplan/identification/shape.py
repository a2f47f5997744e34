"""`identify shape`: intrinsic curvature and curvature at the entry of a needle with curvature sensors.

Each trial gives the mean curvatures over the last millimetre of its depth. `fit_shape` fits kappa_c and omega_init to
them, equation (5) of docs/explanation/needle-shape.md. Several trials give the mean with the scatter between trials.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.identification._identification import Identification, trials_by_role
from needleplan.models import Estimate, LayeredShape
from needleplan.models.deflection import FibreSensors, fit_shape
from needleplan.models.trials import combine
from needleplan.signals import Array, Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["identify"]

# Length (mm) of the end of an insertion over which the curvatures are averaged.
_AT_END_MM = 1.0
# Curvature (1/mm) at which the fit begins.
_FIRST_PER_MM = 1e-3
# Mean curvature (1/mm) of a sensor outside of the tissue from which a remark names it: five standard deviations of the
# constant error of a sensor (`fibre_bias_sd_per_mm` of the tip filter).
_OUTSIDE_PER_MM = 5e-4


def identify(records: object, *, fibre: FibreSensors | None = None, boundary_mm: float | None = None) -> Identification:
    """Identify the shape of a needle in one or two layers from the curvatures of its sensors.

    Parameters
    ----------
    records : Record, table of columns such as a DataFrame, path of a data file, or list of these
        Trials with `depth_mm` and the columns of the sensors, such as `fbg1_y_per_mm`.
    fibre
        Curvature sensors of the needle.
    boundary_mm
        Length of the needle up to the second layer (mm). None: one layer.

    Returns
    -------
    Identification
        The model is a `LayeredShape`.

    Raises
    ------
    DataError
        A column is missing, a curvature is implausible, or too few sensors are in the tissue.
    ModelError
        The boundary is out of range.
    """
    if fibre is None:
        raise DataError(Mistake("--sensors", "", "is missing: give the distances of the sensors from the tip, MM,MM"))
    trials = trials_by_role(records)
    start, free = LayeredShape(_FIRST_PER_MM, _FIRST_PER_MM), ["intrinsic_per_mm", "start_n_per_mm", "start_b_per_mm"]
    if boundary_mm is not None:
        start = start.with_values(boundary_mm=boundary_mm, second_per_mm=_FIRST_PER_MM)
        free.append("second_per_mm")
    ends = [_end(record, fibre) for record in trials.train]
    fits = [fit_shape(start, [depth], fibre.from_tip_mm, seen[None], free=free) for depth, seen in ends]
    estimates = {name: _mean([fit.estimates[name] for fit in fits]) for name in free}
    model = start.with_values(**{name: estimate.value for name, estimate in estimates.items()})
    depth = float(np.mean([depth for depth, _ in ends]))
    tip = model.shape(depth, depth).position_mm[0]
    scores = [("RMS of the residuals", float(np.sqrt(np.mean([fit.rms_per_mm**2 for fit in fits]))), "1/mm")]
    scores += [(f"tip {axis} at {depth:.4g} mm", float(value), "mm") for axis, value in zip("xyz", tip, strict=True)]
    remarks = [*trials.remarks]
    remarks += [
        f"{name}: the data do not determine it" for name, estimate in estimates.items() if not estimate.identified
    ]
    remarks += [
        f"the sensor {place:g} mm from the tip is not in the tissue in any trial, and was not used"
        for place in fibre.from_tip_mm
        if place > max(depth for depth, _ in ends)
    ]
    remarks += _outside_remarks(trials.train, fibre)
    if boundary_mm is not None and all(boundary_mm >= depth - fibre.from_tip_mm[0] for depth, _ in ends):
        remarks.append("no sensor is in the second layer: its constant comes from the shape of the first layer alone")
    return Identification(
        "shape", model, estimates, tuple(scores), (), tuple(remarks),
        partial(_draw, ends=ends, sensors=fibre, model=model), fibre=fibre,
    )  # fmt: skip


def _end(record: Record, sensors: FibreSensors) -> tuple[float, Array]:
    """Return the largest depth (mm) of a trial and the mean curvatures there (1/mm), shape (sensors, 2)."""
    if "depth_mm" not in record.columns:
        raise DataError(Mistake("depth_mm", "", "is missing"), record.trial)
    measured, depth = sensors.measured(record), record["depth_mm"]
    deepest = float(np.nanmax(depth))
    near = measured[depth > deepest - _AT_END_MM]
    count = np.isfinite(near).sum(axis=0)
    return deepest, np.where(count, np.nansum(near, axis=0) / np.maximum(count, 1), np.nan)


def _outside_remarks(records: Sequence[Record], sensors: FibreSensors) -> Iterator[str]:
    """Yield a remark for each sensor that measures a curvature while it is outside of the tissue."""
    for number, place in enumerate(sensors.from_tip_mm):
        readings = [
            sensors.measured(record)[record["depth_mm"] < place - sensors.gauge_mm / 2, number] for record in records
        ]
        outside = np.concatenate(readings)
        known = outside[np.isfinite(outside).all(axis=1)]
        size = float(np.linalg.norm(known.mean(axis=0))) if len(known) else 0.0
        if size > _OUTSIDE_PER_MM:
            yield (
                f"the sensor {place:g} mm from the tip measures {1e3 * size:.2g} 1/m outside of the tissue: "
                "does it drift, as with temperature, or is the needle bent there?"
            )


def _mean(estimates: Sequence[Estimate]) -> Estimate:
    """Return the mean over trials with its 95 % interval; the estimate itself for one trial."""
    if len(estimates) == 1:
        return estimates[0]
    mean = combine([estimate.value for estimate in estimates], [estimate.sd for estimate in estimates])
    return mean.estimate("1/mm", identified=all(estimate.identified for estimate in estimates))


def _draw(figure: Figure, ends: Sequence[tuple[float, Array]], sensors: FibreSensors, model: LayeredShape) -> None:
    """Draw measured and modelled curvatures, and the shape at the mean depth."""
    depth = float(np.mean([depth for depth, _ in ends]))
    shape = model.shape(depth, np.linspace(0.0, depth, 201))
    above, below = figure.subplots(2, 1, height_ratios=(2, 1))  # curvatures above the shape, which is long and thin
    for axis, name in enumerate("yz"):
        (line,) = above.plot(shape.place_mm, 1e3 * shape.curvature_per_mm[:, axis], label=f"along {name}")
        for deepest, seen in ends:
            above.plot(deepest - np.array(sensors.from_tip_mm), 1e3 * seen[:, axis], "o", color=line.get_color())
        below.plot(shape.position_mm[:, 0], shape.position_mm[:, 1 + axis], label=name)
    above.set(xlabel="distance from the entry (mm)", ylabel="curvature (1/m)", title="sensors and model")
    below.set(xlabel="x (mm)", ylabel="y, z (mm)", title="shape", aspect="equal")
    above.legend()
    below.legend()
