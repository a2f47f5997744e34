"""`identify deflection`: needle and tissue from records of lateral deflection, and axial force if measured.

An insertion without a flip of the bevel determines one number, the curvature, besides the offset and the slope of the
track: the stiffness of needle and tissue, the cutting force and the pre-bend all produce a parabola. The identification
therefore has three steps:

1. The curvature of every record is fitted by `TipPath`, without the entry. The result is the mean over the records; its
   interval contains the scatter between the records (`needleplan.models.trials`).
2. The cutting force Fc follows from the curvature and a *given* tissue stiffness kf, for a needle of finite length. Its
   interval contains the unknown rise of the force at the entry, which changes Fc by a tenth at 80 mm. kf itself is
   identified only if the base was turned within a record (a flip), or from the axial force with a *given* offset.
3. From an axial force, the friction vf follows from the increase with depth times velocity, and the offset F0 is the
   rest after the subtraction of Fc. An error of kf also affects F0, because Fc is proportional to kf^(1/4).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from needleplan.errors import DataError
from needleplan.identification import curvature as whole_path
from needleplan.identification._bent_path import (
    PathFit,
    axial_estimates,
    beyond,
    depth_factor,
    path_fit,
)
from needleplan.identification._entry_population import TipPrediction
from needleplan.identification._identification import Finding, Identification, trials_by_role
from needleplan.models import Estimate, Fit, NeedleShaft, TipPath, findings_of, fit, simulate
from needleplan.models.deflection import AxialOffset, ElasticTissue
from needleplan.models.trials import agreement_of, combine, mean_estimate
from needleplan.plotting.canvas import BLACK, BLUE, GREEN, GREY, ORANGE, SKY, VERMILLION, title
from needleplan.signals import Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["NEEDLE", "TISSUE", "identify"]

_COLOURS = (BLUE, ORANGE, GREEN, VERMILLION, SKY, BLACK)

# Default needle: the 22-gauge needle of chapter 5 of the thesis.
NEEDLE = NeedleShaft(0.718, 0.413, 203.0, math.radians(24.8))

# Depth (mm) above which the path law does not hold, because the cutting force still rises.
_SKIP_MM = 20.0

# Default tissue: the soft gel of chapter 5 of the thesis.
TISSUE = ElasticTissue(3.87e-3, 123.9e-6)


def identify(
    records: object,
    *,
    needle: NeedleShaft | None = None,
    tissue: ElasticTissue | None = None,
    axial_offset: AxialOffset | None = None,
    tracked_mm: float = 0.0,
    skip_mm: float | None = None,
    at_mm: float | None = None,
    other_series: Sequence[Sequence[Record]] = (),
) -> Identification:
    """Identify curvature and cutting force and, if the records determine them, kf, F0 and friction.

    Parameters
    ----------
    records : Record, table of columns such as a DataFrame, path of a data file, or list of these
        Trials with depth_mm and y_mm in the plane of bending, and force_n and angle_rad if measured. Trials with the
        role holdout validate the model.
    needle
        Dimensions of the needle. The default is the needle of chapter 5.
    tissue
        Stiffness and density of friction of the tissue. The default is the soft gel of chapter 5.
    axial_offset
        F0, measured with the same needle without a bevel; None if unknown.
    tracked_mm
        Distance (mm) of the tracked point behind the tip.
    skip_mm
        Depth (mm) above which samples are left out. None: 20 mm for the path law, which does not hold at the entry, and
        0 for the predicted tip, as in `identify curvature`.
    at_mm
        Length of the path (mm) at which the tip of the next insertion is predicted, as in `identify curvature`. None:
        the length that all training trials reach.
    other_series
        Insertions of other series, as in `identify curvature`.

    Returns
    -------
    Identification
        The model is a `TipPath`.

    Raises
    ------
    DataError
        No trial has the role train, or no record can be used.
    """
    trials, law_mm = trials_by_role(records), _SKIP_MM if skip_mm is None else skip_mm
    shaft, gel = needle or NEEDLE, tissue or TISSUE
    start = replace(TipPath.of(shaft, gel.stiffness_n_mm2, 0.05), tracked=tracked_mm)
    paths, remarks = _paths(trials.train, start, law_mm)
    curvature = _mean([path.curvature for path in paths])
    estimates = {"curvature": curvature}
    findings = [_bends_evenly(paths), *_agreement([path.curvature for path in paths])]
    turned = [path.fit.estimates["stiffness"] for path in paths if path.turned]
    if turned:
        values, sds = [estimate.value for estimate in turned], [estimate.sd for estimate in turned]
        several = len(turned) > 1
        estimates["stiffness"] = mean_estimate(TipPath.parameters()["stiffness"], values, sds) if several else turned[0]
        start = replace(start, stiffness=estimates["stiffness"].value)

    def factor(stiffness_n_mm2: float) -> tuple[float, float]:
        return depth_factor(paths[0], shaft, replace(gel, stiffness_n_mm2=stiffness_n_mm2))

    g, sd = factor(start.stiffness)
    pose = {name: _mean([path.fit.estimates[name] for path in paths], identified=True) for name in ("slope", "offset")}
    start = replace(start, **{name: estimate.value for name, estimate in pose.items()})
    model = _model(replace(start, depth_factor=g), curvature)
    estimates |= {"cutting_force": _force(model, curvature, sd / g), **pose}
    with_force = [path.record for path in paths if "force_n" in path.record.columns]
    axial: Fit | None = None
    if with_force:
        more, axial = axial_estimates(
            with_force, model, estimates["cutting_force"], curvature, factor, law_mm, axial_offset
        )
        estimates |= more
        if "stiffness" in more and more["stiffness"].identified:
            value = more["stiffness"].value
            model = _model(replace(start, stiffness=value, depth_factor=factor(value)[0]), curvature)
    remarks = [*trials.remarks, *remarks]
    remarks += _what_it_rests_on(needle, tissue, bool(turned), bool(with_force), axial_offset, curvature)
    scores = (
        ("RMSE", math.sqrt(np.mean([path.fit.rmse**2 for path in paths])), "mm"),
        *_held_out(trials.holdout, model, law_mm),
    )
    left = findings_of([path.fit.residuals[0] for path in paths], [path.record.motion() for path in paths], "mm")
    figure = partial(_draw, paths=paths, axial=axial, records=with_force, skip_mm=law_mm)
    prediction = _prediction(paths, tracked_mm, skip_mm or 0.0, at_mm, other_series)
    return Identification(
        "deflection", model, estimates, scores, (*findings, *left), tuple(remarks), figure, prediction
    )


def _prediction(
    paths: Sequence[PathFit], tracked_mm: float, skip_mm: float, at_mm: float | None, other: Sequence[Sequence[Record]]
) -> TipPrediction | None:
    """Return the predicted tip as in `identify curvature`; None if the base was turned or the tip was not tracked."""
    if tracked_mm or any(path.turned for path in paths):
        return None
    records = [path.record for path in paths]
    return whole_path.identify(records, segments=1, skip_mm=skip_mm, at_mm=at_mm, other_series=other).prediction


def _paths(records: Sequence[Record], start: TipPath, skip_mm: float) -> tuple[list[PathFit], list[str]]:
    paths, mistakes = [], []
    for record in records:
        try:
            paths.append(path_fit(record, start, skip_mm))
        except DataError as error:
            mistakes.append((record.trial, error))
    if len(records) == len(mistakes) == 1:
        raise mistakes[0][1]
    if not paths:
        named = [
            replace(mistake, key=f"{trial}, {mistake.key}") for trial, error in mistakes for mistake in error.mistakes
        ]
        raise DataError(named)
    remarks = [f"left out, {trial or 'a record'}: {error.mistakes[0]}" for trial, error in mistakes]
    masked = sum(path.fit.masked for path in paths)
    total = sum(len(path.record) for path in paths)
    remarks.append(
        f"{masked} of {total} samples are left out: in the first {skip_mm:g} mm, at rest, or not at a new depth"
    )
    return paths, remarks


def _mean(estimates: Sequence[Estimate], *, identified: bool | None = None) -> Estimate:
    """Return the mean over the records with its 95 % interval; the estimate itself for one record."""
    if len(estimates) == 1:
        return estimates[0]
    mean = combine([estimate.value for estimate in estimates], [estimate.sd for estimate in estimates])
    return mean.estimate(estimates[0].unit, identified=identified)


def _agreement(curvatures: Sequence[Estimate]) -> list[Finding]:
    """Return the finding on whether the records have one curvature; none for one record."""
    if len(curvatures) == 1:
        return []
    test = agreement_of([curvature.value for curvature in curvatures], [curvature.sd for curvature in curvatures])
    agree = "agree" if test.agree else "disagree by more than their noise"
    return [Finding("agreement of records", test.q, test.p_value, f"curvatures of {len(curvatures)} records {agree}")]


def _model(start: TipPath, curvature: Estimate) -> TipPath:
    """Return the path law with the given curvature. The cutting force is clipped to the limits of the parameter."""
    side = 1.0 if curvature.value >= 0 else -1.0
    limits = start.parameters()["cutting_force"]
    force = abs(curvature.value) * start.bending * start.decay_1_mm * start.depth_factor / math.cos(start.bevel)
    return replace(start, cutting_force=float(np.clip(force, limits.lower, limits.upper)), side=side)


def _force(model: TipPath, curvature: Estimate, factor_error: float) -> Estimate:
    """Return the cutting force Fc = EI lam g |curvature|/cos a (N). `factor_error` is the relative error of g.

    The interval contains the error of g.
    """
    scale = model.bending * model.decay_1_mm * model.depth_factor / math.cos(model.bevel)
    value, half_width = abs(curvature.value) * scale, (curvature.high - curvature.low) / 2 * scale
    reach = math.hypot(half_width, float(stats.norm.ppf(0.975)) * factor_error * value)
    sd = math.hypot(curvature.sd * scale, factor_error * value)
    return Estimate(value, sd, max(value - reach, 0.0), value + reach, "N", curvature.identified)


def _bends_evenly(paths: Sequence[PathFit]) -> Finding:
    """Test whether the curvature changes with depth, by the correlation of the residuals with the cube of the depth."""
    chi_square = 0.0
    for path in paths:
        left = path.fit.residuals[0]
        counts = np.isfinite(left)
        depth = path.record["depth_mm"][counts]
        place = (depth - depth.mean()) / np.ptp(depth)
        cube = place**3 - np.polyval(np.polyfit(place, place**3, 2), place)
        score = cube * left[counts]
        most = round(3 * score.size ** (1 / 3))
        spread = score @ score + sum(
            2 * (1 - lag / (most + 1)) * (score[lag:] @ score[:-lag]) for lag in range(1, min(most, score.size - 1) + 1)
        )
        chi_square += float(score.sum() ** 2 / max(spread, 1e-300))
    p_value = float(stats.chi2.sf(chi_square, len(paths)))
    says = (
        "no change of the curvature with depth was found"
        if p_value > 0.05
        else (
            "the curvature changes with depth: a layer, a drift of the force, an effect of the base, or tissue memory"
        )
    )
    return Finding("one curvature over the depth", chi_square, p_value, says)


def _held_out(records: Sequence[Record], model: TipPath, skip_mm: float) -> list[tuple[str, float, str]]:
    squares: list[float] = []
    for record in records:
        line = fit(model, record, free=["slope", "offset"], mask=lambda masked: beyond(masked, skip_mm))
        squares += line.residuals[0][np.isfinite(line.residuals[0])].tolist()
    if not squares:
        return []
    name = f"RMSE on {len(records)} held-out records, their own slope and offset"
    return [(name, float(np.sqrt(np.mean(np.square(squares)))), "mm")]


def _what_it_rests_on(
    needle: NeedleShaft | None,
    tissue: ElasticTissue | None,
    turned: bool,
    with_force: bool,
    axial_offset: AxialOffset | None,
    curvature: Estimate,
) -> list[str]:
    remarks = []
    if needle is None:
        remarks.append(
            "no needle given: the 22-gauge needle of chapter 5 is assumed; only the curvature does not depend on it"
        )
    if turned:
        remarks.append(
            "kf is from the jump and turn of the path at a flip, a prediction of the model without experimental test"
        )
    elif not (with_force and axial_offset):
        given = "given" if tissue else "of the soft gel of chapter 5, assumed"
        remarks.append(
            f"kf is {given}, not identified: a record without a flip determines only curvature, slope and offset; "
            "cutting force and F0 are proportional to kf^(1/4)"
        )
    if not with_force:
        remarks.append("no axial force: F0 and vf are not identified")
    if not curvature.identified:
        remarks.append("the curvature cannot be told from zero: a straight path is possible")
    remarks.append(
        "the intervals hold for noise that is correlated over few samples; for a distorted tracker use identify "
        "curvature"
    )
    return remarks


def _draw(
    figure: Figure, paths: Sequence[PathFit], axial: Fit | None, records: Sequence[Record], skip_mm: float
) -> None:
    """Draw measured and fitted deflection, the residual, and, if `axial` is given, measured and fitted axial force."""
    panels = figure.subplots(3 if axial else 2, 1, sharex=True, squeeze=False)[:, 0]
    for path, colour in zip(paths, _COLOURS * len(paths), strict=False):
        motion, y = path.record.motion(), path.record["y_mm"]
        panels[0].plot(motion.depth_mm, y, ".", color=colour, markersize=2, alpha=0.5, rasterized=True)
        fitted = np.where(motion.depth_mm >= skip_mm, simulate(path.model, motion).output, np.nan)
        panels[0].plot(motion.depth_mm, fitted, color=colour, label=path.record.trial or "fitted")
        panels[1].plot(motion.depth_mm, 1000 * path.fit.residuals[0], ".", color=colour, markersize=2)
    for axes in panels:
        axes.axvspan(0, skip_mm, color="#f0f0f0", zorder=0)
    panels[1].axhline(0, color=GREY, linewidth=0.8)
    panels[0].set_ylabel("deflection (mm)")
    panels[1].set_ylabel("residual (µm)")
    title(panels[0], "Deflection: measured (points), fitted (lines); the entry (grey) is left out")
    title(panels[1], "Deflection, measured minus fitted")
    if len(paths) <= len(_COLOURS):
        panels[0].legend(frameon=False, fontsize=8, loc="upper left")
    if axial:
        for record, colour in zip(records, _COLOURS * len(records), strict=False):
            motion = record.motion()
            panels[2].plot(motion.depth_mm, record["force_n"], ".", color=colour, markersize=2, alpha=0.5)
            order = np.argsort(motion.depth_mm)
            panels[2].plot(motion.depth_mm[order], simulate(axial.model, motion).output[order], color=colour)
        panels[2].set_ylabel("axial force (N)")
        title(panels[2], "Axial force: measured (points), fitted (lines)")
    panels[-1].set_xlabel("depth (mm)")
    panels[-1].set_xlim(left=0)
