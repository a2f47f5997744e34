"""Fits for `identify deflection`: curvature of each record, and parameters from the axial force."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from needleplan.errors import DataError, Mistake
from needleplan.models import Estimate, Fit, InsertionForce, NeedleShaft, TipPath, fit, simulate
from needleplan.models.deflection import AxialOffset, ElasticTissue, march
from needleplan.signals import Array, Motion, Record

__all__ = ["PathFit", "axial_estimates", "beyond", "depth_factor", "path_fit"]

# Shortest range of depth (mm) that determines a curvature.
_SHORTEST_MM = 10.0

# Cutting force (N) at which the depth factor is computed; the factor hardly depends on it.
_FORCE_N = 0.05


def beyond(record: Record, skip_mm: float) -> Array:
    """Return a mask of the samples that a fit of the path uses, shape (samples,).

    A sample is fitted if the needle moves in, is deeper than `skip_mm`, and was never deeper in an earlier sample.
    """
    motion = record.motion()
    deepest = np.maximum.accumulate(motion.depth_mm)
    return np.asarray((motion.velocity_mm_s > 0) & (motion.depth_mm >= deepest) & (motion.depth_mm > skip_mm))


@dataclass(frozen=True)
class PathFit:
    """A record with its fitted path. `curvature` (1/mm) is positive if the path bends to +y at roll angle 0."""

    record: Record
    fit: Fit
    curvature: Estimate
    turned: bool
    """Whether the cosine of the roll angle varies by more than 0.5 in the fitted samples; kf is then fitted too."""

    counts: Array
    """Mask of the fitted samples, shape (samples,)."""

    @property
    def model(self) -> TipPath:
        """The fitted path law."""
        assert isinstance(self.fit.model, TipPath)
        return self.fit.model


def path_fit(record: Record, start: TipPath, skip_mm: float) -> PathFit:
    """Fit cutting force (and thus curvature), slope and offset to one record, and kf too if the base was turned.

    `start` holds the fixed parameters. The samples that `beyond` selects and whose y_mm is finite are fitted. Raises
    DataError if they are fewer than 5 or cover less than 10 mm, if y_mm is constant, or if a column is missing.
    """
    motion, measured = record.motion(), record["y_mm"]
    counts = np.logical_and(beyond(record, skip_mm), np.isfinite(measured))
    depth = motion.depth_mm[counts]
    if depth.size < 5 or float(np.ptp(depth)) < _SHORTEST_MM:
        seen = f"{float(np.ptp(depth)) if depth.size else 0.0:.3g} mm, {depth.size} samples of the insertion"
        rule = f"too short beyond {skip_mm:g} mm: at least {_SHORTEST_MM:g} mm are needed (depth in mm?)"
        raise DataError(Mistake("depth_mm", seen, rule), record.trial)
    unit = replace(start, cutting_force=0.01, side=1.0, slope=0.0, offset=0.0)
    shape = simulate(unit, motion).output[counts]
    size, slope, offset = np.linalg.lstsq(
        np.column_stack([shape, depth - start.tracked, np.ones_like(depth)]), measured[counts], rcond=None
    )[0]
    if not np.ptp(measured[counts]):
        rule = "is constant to the last bit: a working tracker does not measure that; check the tracker"
        raise DataError(Mistake("y_mm", f"{measured[counts][0]:g}", rule), record.trial)
    begin = _within(replace(unit, side=1.0 if size >= 0 else -1.0), 0.01 * abs(size), slope, offset)
    turned = bool(np.ptp(np.cos(motion.angle_rad[counts])) > 0.5)
    free = ["cutting_force", "slope", "offset", *(["stiffness"] if turned else [])]
    result = fit(begin, record, free=free, mask=lambda _: np.asarray(counts))
    return PathFit(record, result, _curvature(result), turned, counts)


def depth_factor(path: PathFit, needle: NeedleShaft, tissue: ElasticTissue) -> tuple[float, float]:
    """Return the depth factor g of a record and its standard deviation.

    g is the radius of the path of a needle of finite length, divided by the radius from the path law. The insertion of
    the needle, with all axial terms, is simulated over the depths of the record, and the path law is fitted to the
    simulated path. The rise of the cutting force at the entry is unknown: the simulation is made for four assumed
    rises, and mean and standard deviation of the four factors are returned.
    """
    counted = path.record["depth_mm"][path.counts]
    depth = np.linspace(0.0, min(float(counted.max()), 0.95 * needle.length_mm), 81)
    reach = depth / path.model.entry
    rise = np.stack([
        1 - (1 + reach) * np.exp(-reach), 1 - (1 + reach / 2) * np.exp(-reach / 2),
        depth > 10.0, np.minimum(depth / 20, 1),
    ])  # fmt: skip
    speed = float(np.median(path.record.motion().velocity_mm_s[path.counts]))
    inserted = march(
        needle, tissue, _FORCE_N * rise, float(depth[1]), speed, behind_tip_mm=path.model.tracked
    ).tracked_mm
    law = replace(
        path.model, cutting_force=_FORCE_N, stiffness=tissue.stiffness_n_mm2, bending=needle.bending_stiffness_n_mm2,
        side=1.0, slope=0.0, offset=0.0, depth_factor=1.0,
    )  # fmt: skip
    shape = simulate(law, Motion.sampled(depth, depth)).output
    used = depth >= counted.min()
    columns = np.column_stack([shape, depth, np.ones_like(depth)])[used]
    sizes = np.linalg.lstsq(columns, inserted.T[used], rcond=None)[0][0]
    factors = 1 / sizes
    return float(factors.mean()), float(factors.std(ddof=1))


def _within(model: TipPath, cutting_force: float, slope: float, offset: float) -> TipPath:
    inside: dict[str, float] = {}
    limits = model.parameters()
    values: dict[str, float] = {"cutting_force": cutting_force, "slope": slope, "offset": offset}
    for name, value in values.items():
        inside[name] = float(np.clip(value, limits[name].lower, limits[name].upper))
    return model.with_values(**inside)


def _curvature(result: Fit) -> Estimate:
    """Return the signed curvature Fc cos a/(EI lam) of a fit with its 95 % interval.

    lam is proportional to kf^(1/4), so the error of kf contributes if kf was fitted.
    """
    model = result.model
    assert isinstance(model, TipPath)
    force, value = result.estimates["cutting_force"], model.curvature_1_mm
    where = {name: index for index, name in enumerate(result.free)}
    part = np.zeros(len(where))
    part[where["cutting_force"]] = 1.0
    if "stiffness" in where:
        part[where["stiffness"]] = -0.25
    relative = math.sqrt(max(float(part @ result.covariance @ part), 0.0))
    if "stiffness" in where:
        low, high = value - _NORMAL * relative * abs(value), value + _NORMAL * relative * abs(value)
    else:
        ends = (value * force.low / force.value, value * force.high / force.value)
        low, high = min(ends), max(ends)
    return Estimate(value, relative * abs(value), low, high, "1/mm", relative < 1)


# Half width of a 95 % interval in standard deviations.
_NORMAL = float(ndtri(0.975))
# Number of iterations of the stiffness kf and the depth factor g, which depends on kf.
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
    """Fit the axial force, and return the estimates by name and the fit.

    Without an `offset`, the estimates are friction and axial_offset. With a measured `offset`, they are friction,
    cutting_force and stiffness. `cutting_force` and `curvature` are the estimates from the deflection at the assumed
    stiffness kf; `factor` returns the depth factor g and its standard deviation for a kf. Samples above `skip_mm` are
    left out. Raises DataError if the records cannot be fitted.
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
    """Return the stiffness kf = 4 EI (Fc cos a/(EI g |curvature|))^4, clipped to the limits of the parameter.

    The relative error of kf is four times the relative error of the fraction. If the force is not positive or the
    curvature is 0, the value is NaN and not identified.
    """
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
