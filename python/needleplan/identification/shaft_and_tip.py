"""`identify shaft-and-tip`: friction of the shaft and cutting force of the tip, the base model of a diagnosis.

`ShaftAndTip` is fitted to each trial. The result is the mean of the fit coordinates over the trials, with the scatter
between them (`needleplan.models.trials`), or the fit itself for one trial.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.identification._force_faults import without_faults
from needleplan.identification._force_figure import draw_force
from needleplan.identification._force_record import has_retraction
from needleplan.identification._identification import Finding, Identification, averaged, trials_by_role, undetermined
from needleplan.identification._passes import mean_absolute_error
from needleplan.identification.force import settled
from needleplan.models import Estimate, Fit, FitStatus, ShaftAndTip, fit, residual_findings
from needleplan.models.trials import agreement_of, mean_estimate
from needleplan.signals import MovingAverage, Record

__all__ = ["identify"]

# Largest depth (mm) of all records up to which the model is refused.
_LEAST_DEPTH_MM = 5.0
# Initial depth over which the cutting force rises, and initial travel over which friction reverses (mm).
_ONSET_MM, _PRESLIDING_MM = 4.0, 0.1
# Smallest share of the largest force that each of friction and cutting has in the initial model.
_LEAST_SHARE = 0.05


def identify(records: object, *, average: int = 1, starts: int = 2) -> Identification:
    """Identify friction of the shaft, cutting force, its onset, and the travel over which friction reverses.

    Parameters
    ----------
    records : Record, table of columns such as a DataFrame, path of a data file, or list of these
        Trials with time_s, depth_mm and force_n, and velocity_mm_s if measured; with a retraction, or friction and
        cutting are hardly separable. Trials with the role holdout validate the model; trials of noise give the noise of
        the sensor.
    average : int
        Number of samples that the force sensor averages; 1: no average.
    starts : int
        Number of starting points of each fit.

    Returns
    -------
    Identification
        The model is a `ShaftAndTip`; None if the fit of a trial diverged. `between_sd` of the estimates is the scatter
        between the trials.

    Raises
    ------
    DataError
        No trial has the role train, a column is missing, or the records are too shallow.

    Examples
    --------
    >>> import numpy as np
    >>> import needleplan as npl
    >>> from needleplan.identification import shaft_and_tip
    >>> from needleplan.signals import Record, insertion_cycles
    >>> true = npl.models.ShaftAndTip(friction=0.01, cutting=0.5, onset_mm=3.0, presliding_mm=0.5)
    >>> motion = insertion_cycles(50.0, 5.0, rate_hz=50.0)
    >>> noise = np.random.default_rng(0).normal(0.0, 0.02, len(motion))
    >>> columns = {"time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s}
    >>> record = Record({**columns, "force_n": npl.models.simulate(true, motion).output + noise}, "first")
    >>> cutting = shaft_and_tip.identify([record]).estimates["cutting"]
    >>> cutting.low < 0.5 < cutting.high
    True
    """
    trials = trials_by_role(records, noise_is_used=True, faults_are_named=True)
    train, faults = without_faults(trials.train)
    deepest = max(float(np.max(record["depth_mm"])) for record in train)
    if not deepest > _LEAST_DEPTH_MM:
        rule = f"goes to {deepest:g} mm; the model needs more than {_LEAST_DEPTH_MM:g} mm"
        raise DataError(Mistake("depth_mm", "", rule))
    sensor = MovingAverage(average)
    mask = partial(settled, samples=sensor.samples)
    fits = [fit(_start(record), record, smooth=sensor.apply, mask=mask, starts=starts, spread=0.7) for record in train]
    estimates = _means(fits)
    good = all(trial_fit.status is not FitStatus.DIVERGED for trial_fit in fits)
    model = ShaftAndTip(**{name: estimate.value for name, estimate in estimates.items()})  # type: ignore[arg-type]
    scores = [("RMSE of the fits", float(np.sqrt(np.mean([trial_fit.rmse**2 for trial_fit in fits]))), "N")]
    scores += [("MAE of the mean model", mean_absolute_error(model, train, smooth=sensor), "N")]
    if trials.holdout:
        scores += [("MAE of the mean model, held out", mean_absolute_error(model, trials.holdout, smooth=sensor), "N")]
    findings = [*_agreement(fits), *_beside_noise(fits, trials.noise)]
    if len(train) == 1:
        findings += residual_findings(fits[0], train)
    remarks = (*trials.remarks, *faults, *_limits(fits, estimates, train), averaged(average))
    return Identification(
        "shaft-and-tip", model if good else None, estimates, tuple(scores), tuple(findings), remarks,
        partial(draw_force, model=model, records=[*train, *trials.holdout], sensor=sensor, counts=mask),
    )  # fmt: skip


def _start(record: Record) -> ShaftAndTip:
    """Return the initial model: friction from the force on the way out, cutting force from the rest on the way in."""
    force, depth = record["force_n"], record["depth_mm"]
    known = np.isfinite(force)
    largest, deepest = max(float(np.max(force[known])), 1e-3), float(np.max(depth[known]))
    back = max(-float(np.min(force[known])), 0.0) if has_retraction([record]) else largest / 2
    shaft = float(np.clip(back, _LEAST_SHARE * largest, (1 - _LEAST_SHARE) * largest))
    limits = ShaftAndTip.parameters()
    friction, cutting = (
        float(np.clip(value, limits[name].lower, limits[name].upper))
        for name, value in (("friction", shaft / deepest), ("cutting", largest - shaft))
    )
    return ShaftAndTip(friction=friction, cutting=cutting, onset_mm=_ONSET_MM, presliding_mm=_PRESLIDING_MM)


def _means(fits: Sequence[Fit]) -> dict[str, Estimate]:
    """Return the mean of each parameter over the fits of the trials; the estimates of the fit itself for one trial."""
    if len(fits) == 1:
        return dict(fits[0].estimates)
    return {
        name: mean_estimate(
            parameter,
            [trial_fit.estimates[name].value for trial_fit in fits],
            [trial_fit.estimates[name].sd for trial_fit in fits],
        )
        for name, parameter in _PARAMETERS.items()
    }


_PARAMETERS = ShaftAndTip.parameters()


def _agreement(fits: Sequence[Fit]) -> list[Finding]:
    """Return a finding for each parameter on whether the trials agree (Cochran's Q), in its fit coordinate."""
    findings = []
    for name, parameter in _PARAMETERS.items():
        known = [trial_fit.estimates[name] for trial_fit in fits if np.isfinite(trial_fit.estimates[name].sd)]
        if len(known) < 2:
            continue
        coordinates = [parameter.coordinate(estimate.value) for estimate in known]
        test = agreement_of(coordinates, [estimate.sd / parameter.slope(estimate.value) for estimate in known])
        says = f"{name} is the same in all trials" if test.agree else f"{name} differs from trial to trial"
        findings.append(Finding(f"agreement of trials, {name}", test.q, test.p_value, says))
    return findings


def _beside_noise(fits: Sequence[Fit], noise: Sequence[Record]) -> list[Finding]:
    """Return the finding on whether the residuals are the noise of the sensor; none without records of noise."""
    if not noise:
        return []
    sd = float(np.sqrt(np.mean([np.nanvar(record["force_n"]) for record in noise])))
    ratio = float(np.sqrt(np.mean([trial_fit.rmse**2 for trial_fit in fits]))) / sd if sd else float("inf")
    says = "the residual is the noise of the sensor" if ratio < 1.2 else (
        "the residual exceeds the sensor's noise: `needleplan diagnose` finds what the model lacks"
    )  # fmt: skip
    return [Finding("residuals over the sensor's noise", ratio, None, says)]


def _limits(fits: Sequence[Fit], estimates: dict[str, Estimate], train: Sequence[Record]) -> list[str]:
    """Return remarks on parameters that the data do not determine, fits that ended early, and missing retractions."""
    remarks = undetermined(estimates)
    names = [record.trial or "the trial" for record in train]
    remarks += [f"{name}: {trade}" for name, trial_fit in zip(names, fits, strict=True) for trade in trial_fit.trades]
    remarks += [
        f"{name}: the fit ended with: {trial_fit.status}"
        for name, trial_fit in zip(names, fits, strict=True)
        if trial_fit.status is not FitStatus.CONVERGED
    ]
    if not has_retraction(train):
        remarks.append("there is no retraction: friction and cutting force are hardly separable; record one")
    return remarks
