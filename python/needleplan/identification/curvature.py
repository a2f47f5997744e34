"""`identify curvature`: entry pose and curvature of insertions from tip positions, and the predicted tip.

Further results are the agreement of trials and the change of the curvature with depth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.identification._curvature_figure import draw
from needleplan.identification._curvature_trial import CurvatureTrial, insertion_of
from needleplan.identification._entry_population import MeanPath, mean_path, predict_tip, tips_of
from needleplan.identification._fitted_arcs import TrackerNoise
from needleplan.identification._frames import frame_remarks, odd_remarks
from needleplan.identification._identification import Identification, trials_by_role
from needleplan.identification._insertion_path import EntryPath
from needleplan.identification._series_order import in_order, require_different
from needleplan.identification._shape_choice import curvature_estimates, model_of, shaped_paths
from needleplan.models import Estimate, Finding, findings_of
from needleplan.models.trials import TrialAgreement, TrialMean, agreement_of, combine
from needleplan.signals import Array, Record, require_one_frame

__all__ = ["CurvatureTrial", "identify", "insertion_of"]

# Largest number of layers that a model file holds.
_MOST_LAYERS = 4


def identify(
    records: object,
    *,
    segments: int = 2,
    plane: str = "xy",
    skip_mm: float = 0.0,
    noise: TrackerNoise = TrackerNoise.CORRELATED,
    correlation_mm: float | None = None,
    at_mm: float | None = None,
    layers: int | None = None,
    other_series: Sequence[Sequence[Record]] = (),
) -> Identification:
    """Identify the curvature of insertions without rotation from tip positions.

    Parameters
    ----------
    records : Record, table of columns such as a DataFrame, path of a data file, or list of these
        Insertions with time_s, x_mm (along the insertion; depth_mm if there is none) and y_mm, or z_mm for the plane
        xz. Trials with the role holdout validate the estimate. Trials of noise are left out. The insertions
        are a series: give them in the order of their times, unless their files have the times.
    segments
        Number of equal parts of each path with a curvature each, to test for a change with depth: 1 to 10.
    plane
        xy or xz.
    skip_mm
        Depth (mm) above which samples are left out.
    noise
        Assumption about the noise of the tracker.
    correlation_mm
        Correlation length of the noise along the path, if known.
    at_mm
        Length of the path (mm) at which the tip of the next insertion is predicted. None: the length that all
        training trials reach.
    layers
        Number of layers of equal depth with a curvature each, 1 to 4. None: insertions that are left out choose among
        one to three layers and a smooth curvature; fewer than three insertions have one curvature.
    other_series
        Insertions of other series, in the same frame: other days, or after needle, guide or tissue were set up again.
        They are not identified; their scatter and their means count for the regions of the predicted tip.

    Returns
    -------
    Identification
        The model is a `Bicycle`, or a `BicycleByDepth` if the curvature depends on the depth. The estimates
        `curvature_per_mm` (1/mm), `heading_rad` and `offset_mm` are means over the training trials, with the scatter
        between trials. `prediction` is the predicted tip.

    Raises
    ------
    DataError
        No trial has the role train, a record lacks a column or has too few points, or an option is out of range.
    """
    if at_mm is not None and not 0 < at_mm < np.inf:
        raise DataError(Mistake("at_mm", f"{at_mm:g}", "must be a length above 0 mm"))
    if layers is not None and not 1 <= layers <= _MOST_LAYERS:
        raise DataError(Mistake("layers", f"{layers}", f"must be 1 to {_MOST_LAYERS}, or None"))
    if plane not in ("xy", "xz") or not 1 <= segments <= 10:
        raise DataError(Mistake("plane, segments", f"{plane}, {segments}", "must be xy or xz, and 1 to 10"))
    trials = trials_by_role(records)
    train, ordering = in_order(trials.train)
    every = [*train, *trials.holdout, *(record for series in other_series for record in series)]
    require_one_frame(every)
    require_different(every)
    options = {"segments": segments, "plane": plane, "skip_mm": skip_mm, "noise": noise}
    insertions, held = (
        [insertion_of(record, correlation_mm=correlation_mm, **options) for record in some]  # type: ignore[arg-type]
        for some in (train, trials.holdout)
    )
    bends, sds = (
        [trial.whole.curvature_per_mm for trial in insertions],
        [trial.whole.interval_sd_per_mm for trial in insertions],
    )
    together, test = combine(bends, sds), agreement_of(bends, sds) if len(insertions) > 1 else None
    choice = shaped_paths(insertions, layers)
    paths, across = choice.paths, _across(insertions)
    mean = mean_path(paths)
    estimates = _estimates(mean, mean_path(across) if across else None)
    depth = min(path.deepest_mm for path in paths) if at_mm is None else at_mm
    tips = [_tips(some, depth, bool(across), plane=plane, skip_mm=skip_mm) for some in other_series]
    prediction = predict_tip(paths, across, depth, tips)
    remarks = [*trials.remarks, *ordering, *(remark for trial in (*insertions, *held) for remark in trial.remarks)]
    remarks += [*frame_remarks(insertions), *odd_remarks(insertions), *_remarks(insertions, test, estimates)]
    remarks += [choice.remark] * bool(choice.remark)
    if depth > 1.001 * min(path.deepest_mm for path in paths):
        remarks.append(f"the predicted tip at {depth:.4g} mm is deeper than a trial reached: it is an extrapolation")
    judged = [_validated(trial, together) for trial in held]
    left = findings_of(
        [trial.path.fitted.distances_mm for trial in insertions], [trial.motion for trial in insertions], "mm"
    )
    return Identification(
        "curvature", model_of(mean), estimates,
        (*_scores([*insertions, *held], together),
         *((f"left out, RMS: {name}", rms, "mm") for name, rms in choice.scores)),
        (*_findings(insertions, test), *judged, *left), tuple(remarks),
        partial(draw, found=[*insertions, *held], plane=plane, mean=mean, prediction=prediction), prediction,
    )  # fmt: skip


def _tips(records: Sequence[Record], depth_mm: float, both: bool, *, plane: str, skip_mm: float) -> Array:
    """Return the tips (mm) of another series at a depth, shape (n, 1), or (n, 2) for `both` planes.

    Raises DataError if there is no insertion, or the other plane was not tracked.
    """
    insertions = [insertion_of(record, segments=1, plane=plane, skip_mm=skip_mm) for record in records]
    across = _across(insertions)
    if both and not across:
        raise DataError(Mistake("other_series", "", "must be tracked in both planes, as the other insertions are"))
    return tips_of([[trial.path for trial in insertions], across][: 1 + both], depth_mm)


def _across(insertions: Sequence[CurvatureTrial]) -> list[EntryPath]:
    """Return the paths of the trials in the other plane, or [] if a trial was not tracked there."""
    paths = [path for trial in insertions if (path := trial.other_path())]
    return paths if len(paths) == len(insertions) else []


def _estimates(mean: MeanPath, across: MeanPath | None) -> dict[str, Estimate]:
    """Return the estimates of the mean path by name; `elevation_rad` is the heading in the other plane."""
    estimates = curvature_estimates(mean)
    estimates |= {"heading_rad": mean.estimate(1, "rad"), "offset_mm": mean.estimate(0, "mm")}
    return estimates | ({"elevation_rad": across.estimate(1, "rad")} if across else {})


def _scores(insertions: Sequence[CurvatureTrial], together: TrialMean) -> list[tuple[str, float, str]]:
    scores: list[tuple[str, float, str]] = []
    for trial in insertions:
        name = trial.name or "trial"
        scores += [
            (f"{name}: curvature", trial.whole.curvature_per_mm, "1/mm"),
            (f"{name}: lower end", trial.whole.low_per_mm, "1/mm"),
            (f"{name}: upper end", trial.whole.high_per_mm, "1/mm"),
            (f"{name}: radius", trial.whole.radius_mm, "mm"),
            (f"{name}: RMS distance", trial.whole.rms_mm, "mm"),
        ]
        scores += [
            (f"{name}: curvature {part.low_mm:.0f} to {part.high_mm:.0f} mm", part.curvature_per_mm, "1/mm")
            for part in trial.segments
        ]
    if together.between_sd is not None:
        scores.append(("scatter between trials", together.between_sd, "1/mm"))
    return scores


def _findings(insertions: Sequence[CurvatureTrial], test: TrialAgreement | None) -> list[Finding]:
    findings = []
    if test:
        says = (
            "the intervals of the trials agree with one curvature"
            if test.agree
            else "the trials do not have one curvature: they differ by more than their intervals"
        )
        findings.append(Finding("agreement of trials", test.q, test.p_value, says))
    for trial in insertions:
        for number, change in enumerate(trial.changes):
            place = trial.segments[number].high_mm
            says = f"the curvature changes at {place:.0f} mm by {change.value_per_mm:.2g} 1/mm"
            if change.p_value >= 0.05:
                says = f"no change of the curvature at {place:.0f} mm was found"
            findings.append(Finding(f"change, {trial.name}".rstrip(", "), change.value_per_mm, change.p_value, says))
    return findings


def _validated(held: CurvatureTrial, together: TrialMean) -> Finding:
    """Test whether the arc through a held-out trial has the curvature of the arcs through the others.

    Arcs are compared, since the curvature at the entry alone says little of a path whose curvature changes with depth.
    The test accounts for the error of the mean and for the scatter of a further trial.
    """
    score, p_value = together.further_trial(held.whole.curvature_per_mm, held.whole.interval_sd_per_mm)
    says = "its curvature agrees with the others" if p_value >= 0.05 else "its curvature contradicts the others"
    return Finding(f"held out, {held.name}".rstrip(", "), score, p_value, says)


def _remarks(
    insertions: Sequence[CurvatureTrial], test: TrialAgreement | None, estimates: Mapping[str, Estimate]
) -> list[str]:
    remarks = []
    if not any(estimate.identified for name, estimate in estimates.items() if name.startswith("curvature")):
        remarks.append("the interval of the curvature contains zero: a straight path is possible")
    if test is None:
        remarks.append("one insertion does not determine the scatter between insertions: repeat it")
    elif not test.agree:
        remarks.append("the interval is for the mean curvature of the insertions; the next one may lie outside of it")
    far = [
        trial.name
        for trial in insertions
        if trial.whole.correlation_mm > 0.2 * (trial.whole.high_mm - trial.whole.low_mm)
    ]
    if far:
        remarks.append(
            f"errors are correlated over more than a fifth of the path in {len(far)} trials ({', '.join(far)}): the "
            "path may not be an arc, or the field of the tracker may be distorted"
        )
    return remarks
