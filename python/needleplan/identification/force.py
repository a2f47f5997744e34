"""`identify force`: a model of the axial force over depth, by a least-squares fit, and a joint filter to compare."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Literal

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.estimation import JointForce
from needleplan.identification._between_trials import with_scatter
from needleplan.identification._force_faults import without_faults
from needleplan.identification._force_figure import draw_force
from needleplan.identification._force_record import force_drops, has_retraction, starting_force
from needleplan.identification._identification import Finding, Identification, averaged, trials_by_role, undetermined
from needleplan.identification._passes import FilterRun, identify_by_passes, mean_absolute_error
from needleplan.identification._relaxing_force import identify_relaxing
from needleplan.models import Fit, FitStatus, Model, fit, residual_findings
from needleplan.models.force import DepthForce, ForceModel1, ForceModel2
from needleplan.signals import Array, MovingAverage, Record

__all__ = ["fit_force", "identify", "settled"]

# Largest depth (mm) of all records up to which a force-depth model is refused.
_LEAST_DEPTH_MM = 5.0

# A remark reports a puncture if the force drops by this share of its range within this increase of the depth (mm).
# After a force peak of the model itself, the force falls over 5 mm or more.
_DROP, _DROP_MM = 0.15, 2.0

# Lower bound of f1 in units of -f2: g at the surface is at least 1 % of g at large depth.
_EDGE = 1.01


def identify(
    records: object,
    *,
    start: DepthForce | None = None,
    average: int = 5,
    starts: int = 4,
    filtered: bool = True,
    model: Literal["depth", "relaxing"] = "depth",
) -> Identification:
    """Identify a model of the axial force from insertions.

    Parameters
    ----------
    records : Record, table of columns such as a DataFrame, path of a data file, or list of these
        Trials with time_s, depth_mm and force_n, and velocity_mm_s if measured. Trials with the role holdout validate
        the fit; trials of noise give the noise of the sensor.
    start
        Initial model. The default is a Model I with parameters from the data. A Model II keeps its f2 and alpha.
    average
        Number of samples that the force sensor averages; 1: no average. The simulated force is averaged in the same
        way, and samples around reversals are masked.
    starts
        Number of starting points of the fit.
    filtered
        Whether the joint filter runs too, from the same initial model. The filter is skipped if the initial model is
        not proper.
    model
        Family of models: "depth", the models of chapter 2 of the thesis, or "relaxing", an elastic tissue with
        capsules, layers and Maxwell branches (`RelaxingForce`), for which `start`, `starts` and `filtered` have no
        effect.

    Returns
    -------
    Identification
        The model is a `DepthForce` or a `RelaxingForce`; None if the fit diverged, or a `DepthForce` is not proper (g >
        0 at all depths).

    Raises
    ------
    DataError
        No trial has the role train, a column is missing, or the records are too shallow.
    """
    trials = trials_by_role(records, noise_is_used=True, faults_are_named=True)
    holdout, noise = trials.holdout, trials.noise
    train, faults = without_faults(trials.train)
    deepest = max(float(np.max(record["depth_mm"])) for record in train)
    if not deepest > _LEAST_DEPTH_MM:
        rule = f"goes to {deepest:g} mm; a force-depth model needs more than {_LEAST_DEPTH_MM:g} mm"
        raise DataError(Mistake("depth_mm", "", rule))
    sensor = MovingAverage(average)
    if model == "relaxing":
        return identify_relaxing(trials, train, faults, sensor, partial(settled, samples=sensor.samples))
    begin = start or starting_force(train)
    fitted_together = fit_force(begin, train, sensor, starts)
    joint = with_scatter(
        fitted_together, train, smooth=sensor.apply, mask=partial(settled, samples=sensor.samples),
        bounds=_bounds(fitted_together.model),
    )  # fmt: skip
    result = joint.fit
    run = identify_by_passes(JointForce(begin), begin, train, smooth=sensor) if filtered and begin.proper else None
    fitted = result.model
    assert isinstance(fitted, DepthForce)
    remarks = [
        *trials.remarks,
        *faults,
        *joint.remarks,
        *_limits(result, fitted, train),
        *_punctures(train, sensor.samples),
        averaged(average),
    ]
    return Identification(
        "force", fitted if result.status is not FitStatus.DIVERGED and fitted.proper else None, dict(result.estimates),
        tuple(_scores(result, run, train, holdout, sensor)),
        (*_findings(result, run, train, noise, sensor), *residual_findings(result, train)), tuple(remarks),
        partial(
            draw_force, model=fitted, records=[*train, *holdout], sensor=sensor,
            counts=partial(settled, samples=sensor.samples),
        ),
    )  # fmt: skip


def _punctures(train: Sequence[Record], samples: int) -> list[str]:
    """Return a remark for every trial in which the force drops faster than in the model, as at a puncture.

    `samples` is the number of samples that the force sensor averages.
    """
    remarks = []
    for record in train:
        inward = record.select(np.asarray(np.logical_and(settled(record, samples), record.motion().direction > 0)))
        force = inward["force_n"][np.isfinite(inward["force_n"])]
        if not force.size or not np.ptp(force):
            continue
        drops = force_drops(inward, least_n=_DROP * float(np.ptp(force)), within_mm=_DROP_MM)
        if drops:
            where = ", ".join(f"{drop.drop_n:.2g} N at {drop.peak_mm:.1f} mm" for drop in drops[:5])
            more = f" and {len(drops) - 5} more" * (len(drops) > 5)
            remarks.append(
                f"{record.trial}: the force drops at once, by {where}{more}, as at the puncture of a membrane. The "
                "model has no punctures, so its parameters are biased: identify from depths without a puncture, or "
                "with --model relaxing, which has capsules"
            )
    return remarks


def fit_force(begin: DepthForce, train: Sequence[Record], sensor: MovingAverage, starts: int = 4) -> Fit:
    """Return the best least-squares fit from `starts` starting points, the first of which is `begin`.

    `sensor` averages the simulated force. If a fit of Model I converges to g = 0 at the surface, the fit is repeated
    with f2 fixed instead of beta: then the bound f1 > -f2 of the single parameter f1 keeps g above 0. The result is a
    Model II in which alpha was fitted too.
    """
    mask = partial(settled, samples=sensor.samples)

    def fitted(model: DepthForce, free: tuple[str, ...] | None) -> Fit:
        return fit(
            model, train, free=free, bounds=_bounds(model), smooth=sensor.apply, mask=mask, starts=starts, spread=0.7
        )

    result = fitted(begin, None)
    model = result.model
    if isinstance(model, ForceModel1) and model.f1 + model.f2 < (_EDGE - 1) * model.f1:
        inside = {**model.values(), "f1": max(model.f1, -1.1 * model.f2)}
        return fitted(ForceModel2(**inside), ("sigma0", "sigma1", "sigma2", "f1", "alpha", "beta"))
    return result


def _bounds(model: Model) -> dict[str, tuple[float, float]]:
    """Return bounds of a fit that keep g above 0; they limit f1 of Model II."""
    known = model.parameters()["f1"]
    return {"f1": (max(-_EDGE * model.f2, known.lower), known.upper)} if isinstance(model, ForceModel2) else {}


def settled(record: Record, samples: int) -> Array:
    """Return a mask, shape (samples,), that is False near reversals, because the average there mixes both directions.

    Masked are the sample before a reversal and `samples` samples after it; nothing is masked if `samples` is 1.
    """
    direction = record.motion().direction
    keep = np.ones(direction.size, bool)
    if samples > 1:
        for turn in np.flatnonzero(np.diff(direction) * direction[:-1] < 0):
            keep[max(turn, 0) : turn + 1 + samples] = False
    return np.asarray(keep)


def _scores(
    result: Fit, run: FilterRun | None, train: Sequence[Record], holdout: Sequence[Record], sensor: MovingAverage
) -> list[tuple[str, float, str]]:
    rows: list[tuple[str, float, str]] = [
        ("RMSE of the fit", result.rmse, "N"),
        ("MAE of the open loop", mean_absolute_error(result.model, train, smooth=sensor), "N"),
    ]
    if holdout:
        rows.append(("MAE of the open loop, held out", mean_absolute_error(result.model, holdout, smooth=sensor), "N"))
    if run is not None:
        last = (run.innovation_rmse[-1], run.replay_mae[-1]) if run.ok else (float("nan"), float("inf"))
        rows += [
            ("joint filter: RMSE of the innovations", last[0], "N"),
            ("joint filter: MAE of the open loop", last[1], "N"),
        ]
    return [*rows, ("samples", result.samples, ""), ("masked samples", result.masked, "")]


def _findings(
    result: Fit, run: FilterRun | None, train: Sequence[Record], noise: Sequence[Record], sensor: MovingAverage
) -> list[Finding]:
    findings = []
    if run is not None:
        batch = mean_absolute_error(result.model, train, smooth=sensor)
        alone = run.replay_mae[-1] if run.ok else float("inf")
        agree = alone < 1.5 * batch + 1e-4
        says = "the joint filter is as accurate as the fit" if agree else (
            f"the joint filter is less accurate, {1e3 * alone:.1f} mN in the open loop instead of {1e3 * batch:.1f} mN:"
            " prefer the fit"
        )  # fmt: skip
        findings.append(Finding("joint filter beside the fit", alone / batch if batch else 1.0, None, says))
    if noise:
        sd = float(np.nanstd(np.concatenate([record["force_n"] - np.nanmean(record["force_n"]) for record in noise])))
        ratio = result.rmse / sd if sd else float("inf")
        says = "the residual is the noise of the sensor" if ratio < 1.2 else "the residual exceeds the sensor's noise"
        findings.append(Finding("residuals over the sensor's noise", ratio, None, says))
    first, second = _halves(result, train)
    says = "the error does not depend on the depth" if max(first, second) < 2 * min(first, second) else (
        f"RMSE {1e3 * first:.1f} mN in the shallower half of the samples, {1e3 * second:.1f} mN in the deeper half"
    )  # fmt: skip
    findings.append(Finding("RMSE deep over shallow", second / first if first else 1.0, None, says))
    return findings


def _halves(result: Fit, train: Sequence[Record]) -> tuple[float, float]:
    """Return the RMSE (N) of the fit in the shallower and in the deeper half of the samples."""
    left = np.concatenate(result.residuals)
    depth = np.concatenate([record["depth_mm"] for record in train])
    good = np.isfinite(left)
    deep = depth > np.median(depth[good])
    return tuple(float(np.sqrt(np.mean(left[good & half] ** 2))) for half in (~deep, deep))  # type: ignore[return-value]


def _limits(result: Fit, model: DepthForce, train: Sequence[Record]) -> list[str]:
    """Return remarks about parameters that the data do not determine, the fixed scale, and different speeds."""
    remarks = undetermined(result.estimates)
    remarks += result.trades
    if not has_retraction(train):
        remarks.append(
            "there is no retraction: the data determine the sum beta g + sigma2, but hardly its two terms; do not "
            "predict a retraction with this model"
        )
    if not result.ok:
        remarks.append(
            f"the fit ended with: {result.status}; the force may be fitted well, but the parameters are one set of many"
        )
    if model.f1 + model.f2 < 1.02 * (_EDGE - 1) * model.f1:
        remarks.append(
            "g at the surface is at its lower bound: the record has no force peak of the shape of this model, and only "
            "the rise of the force is fitted"
        )
    fixed = "beta" if "beta" not in result.free else "f2"
    remarks.append(
        f"{fixed} = {getattr(model, fixed):g} is not measured: it fixes the scale of z, and so of beta, "
        "f1, f2, sigma0 and sigma1"
    )
    speeds = [float(np.percentile(np.abs(record.motion().velocity_mm_s), 90)) for record in train]
    if max(speeds) > 1.1 * min(speeds):
        remarks.append(
            f"the trials differ in speed, {min(speeds):.1f} to {max(speeds):.1f} mm/s, but this model does not depend "
            "on the speed: identify each speed separately"
        )
    return remarks
