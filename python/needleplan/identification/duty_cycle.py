"""`identify duty-cycle`: what a needle that turns while it is inserted keeps of its curvature.

A robot that turns the needle all the time inserts it along a nearly straight path; one that turns it during a share d
of the inserted length, and holds the bevel otherwise, along an arc in between. The curvature falls about linearly with
the duty cycle d (Minhas et al., "Modeling of needle steering via duty-cycled spinning", EMBC 2007). Friction, torsion
and a bent tip leave a part even at d = 1:

    k(d) = A (1 - d) + B d.

A is the curvature without turning, B that at d = 1. The curvature of insertion i has the error e_i of its path and the
scatter u between insertions,

    k_i = A (1 - d_i) + B d_i + u_i + e_i,    u_i ~ N(0, t^2),    e_i ~ N(0, s_i^2),

a regression over trials (`trials.regress`), whose intervals are those of Student with n - 2 degrees of freedom.

The planner needs the share of the curvature that is left, q(D) = 1 - D + D B / A, at the duty cycle D that the robot
will use. The interval of the ratio is Fieller's: all q with (B - q A)^2 <= T^2 Var(B - q A), T the quantile. It is
bounded only if A is surely not zero; otherwise q is not identified.

A third regressor d (1 - d) tests whether the fall is linear, if there are three duty cycles and four insertions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from needleplan.errors import DataError, Mistake
from needleplan.identification._curvature_trial import CurvatureTrial, insertion_of
from needleplan.identification._identification import Identification, trials_by_role
from needleplan.models import Bicycle, Estimate, Finding
from needleplan.models.trials import TrialRegression, regress
from needleplan.scenario import Scenario
from needleplan.signals import Array, Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["SHARE", "CurvatureByDuty", "curvature_by_duty", "identify", "scenario_with_share"]

SHARE = "straight_curvature_share"
"""Name of the estimate that a scenario takes, `[motion] straight_curvature_share`."""


@dataclass(frozen=True)
class CurvatureByDuty:
    """Curvature (1/mm) by duty cycle, k(d) = A (1 - d) + B d.

    - `law`: the coefficients A and B with their covariance
    - `bend`: test of a further term d (1 - d): Student's t and its p-value; None if it was not tested
    """

    law: TrialRegression
    bend: tuple[float, float] | None

    def at(self, duty: float) -> Estimate:
        """Return the mean curvature (1/mm) at a duty cycle, with its 95 % interval."""
        return self.law.combination([1 - duty, duty]).estimate("1/mm")

    def share(self, duty: float) -> Estimate:
        """Return k(d) / k(0), the share of the curvature that is left at a duty cycle, with Fieller's interval.

        It is not identified, with an unbounded interval, if the curvature without turning may be zero.
        """
        (a, b), (aa, bb), ab = self.law.coefficients, np.diag(self.law.covariance), self.law.covariance[0, 1]
        t2 = self.law.quantile**2
        ratio = b / a
        sd = duty * float(np.sqrt(max(bb - 2 * ratio * ab + ratio**2 * aa, 0.0)) / abs(a))
        value = float(1 - duty + duty * ratio)
        # (b - q a)^2 - t2 (bb - 2 q ab + q^2 aa) = 0
        square, linear, rest = a**2 - t2 * aa, a * b - t2 * ab, b**2 - t2 * bb
        if square <= 0:
            return Estimate(value, sd, float("-inf"), float("inf"), "", False)
        reach = np.sqrt(max(linear**2 - square * rest, 0.0))
        low, high = (float(1 - duty + duty * (linear + sign * reach) / square) for sign in (-1, 1))
        return Estimate(value, sd, low, high, "", True)


def curvature_by_duty(duty: Array, curvature_per_mm: Array, sd_per_mm: Array) -> CurvatureByDuty:
    """Fit the curvature by duty cycle to insertions.

    Parameters
    ----------
    duty
        Duty cycle of each insertion, 0 to 1, shape (n,).
    curvature_per_mm, sd_per_mm
        Curvature (1/mm) of each insertion and its standard deviation, shape (n,).

    Returns
    -------
    CurvatureByDuty
        The fit.

    Raises
    ------
    DataError
        For fewer than three insertions, or if all have the same duty cycle.
    """
    duty = np.asarray(duty, float)
    kinds = np.unique(duty)
    if len(duty) < 3 or len(kinds) < 2:
        rule = "at least three insertions with two different duty cycles are needed"
        raise DataError(Mistake("duty_cycle", f"{len(duty)} insertions, {len(kinds)} duty cycles", rule))
    design = np.column_stack([1 - duty, duty])
    bend = None
    if len(kinds) > 2 and len(duty) > 3:
        curved = regress(np.column_stack([design, duty * (1 - duty)]), curvature_per_mm, sd_per_mm)
        bend = curved.combination([0.0, 0.0, 1.0]).zero_test()
    return CurvatureByDuty(regress(design, curvature_per_mm, sd_per_mm), bend)


def identify(records: object, *, plane: str = "xy", skip_mm: float = 0.0, duty: float = 1.0) -> Identification:
    """Identify the curvature by duty cycle from insertions with several duty cycles.

    Parameters
    ----------
    records : Record, table of columns such as a DataFrame, path of a data file, or list of these
        Trials with `duty_cycle`, constant in each trial, the lateral position of the tip, and `x_mm` or `depth_mm`.
        The bevel is to the same side in all of them. The arc through each is one curvature.
    plane
        Plane of bending, xy or xz.
    skip_mm
        Samples at smaller depths are left out.
    duty
        Duty cycle of the straight steps of a plan, above 0 and at most 1.

    Returns
    -------
    Identification
        The model is the bicycle without turning; `straight_curvature_share` is the estimate for a plan.

    Raises
    ------
    DataError
        If a column is missing, a duty cycle is outside of 0 to 1 or changes within a trial, or the trials are too few.
    """
    if not 0 < duty <= 1:
        raise DataError(Mistake("duty", f"{duty:g}", "must be above 0 and at most 1"))
    trials = trials_by_role(records)
    train, held_out = (
        [_insertion(record, plane, skip_mm) for record in records_of_role]
        for records_of_role in (trials.train, trials.holdout)
    )
    fit = curvature_by_duty(*_columns(train))
    share, nominal = fit.share(duty), fit.at(0.0)
    insertions = [*train, *held_out]
    remarks = [*trials.remarks, *(remark for _, trial in insertions for remark in trial.remarks)]
    if not share.identified:
        remarks.append("without turning, the path may be straight: the share that is left is not determined")
    elif not 0 <= share.value <= 1:
        remarks.append(f"the share {share.value:.3g} is outside of 0 to 1, by chance or because bevels differ in side")
    if not any(cycle == duty for cycle, _ in train):
        remarks.append(f"no insertion has the duty cycle {duty:g}: its share is interpolated on a straight line")
    findings = [_linear(*fit.bend)] if fit.bend else []
    findings += [_validated(cycle, trial, fit) for cycle, trial in held_out]
    scores = [
        (f"{trial.name or 'trial'}: curvature, duty cycle {cycle:g}", trial.whole.curvature_per_mm, "1/mm")
        for cycle, trial in insertions
    ]
    return Identification(
        "duty-cycle",
        Bicycle(nominal.value) if share.identified else None,
        {SHARE: share, "curvature_per_mm": nominal, "curvature_turning_per_mm": fit.at(1.0)},
        tuple(scores), tuple(findings), tuple(remarks), partial(_draw, insertions=insertions, fit=fit),
    )  # fmt: skip


def scenario_with_share(found: Identification, scenario: Scenario) -> tuple[Scenario, tuple[str, ...]]:
    """Return the scenario with the identified share of straight steps, within 0 to 1, and remarks.

    Raises DataError if the share is not identified.
    """
    share = found.estimates[SHARE]
    if not share.identified:
        raise DataError(Mistake(SHARE, "", "is not identified"))
    kept = float(np.clip(share.value, 0.0, 1.0))
    remarks = [] if kept == share.value else [f"the share {share.value:.3g} was set to {kept:g}"]
    remarks.append("the radius of the scenario was not changed: identify curvature sets it")
    if scenario.objective.straight_per_mm is None:
        remarks.append("a straight step costs what another one costs: [objective] straight_per_mm sets its price")
    motion = replace(scenario.motion, straight_curvature_share=float(f"{kept:.4g}"))
    return replace(scenario, motion=motion), tuple(remarks)


def _insertion(record: Record, plane: str, skip_mm: float) -> tuple[float, CurvatureTrial]:
    if "duty_cycle" not in record.columns:
        rule = "is missing: write the share of the length during which the needle turned, 0 to 1"
        raise DataError(Mistake("duty_cycle", "", rule), record.trial)
    known = record["duty_cycle"][np.isfinite(record["duty_cycle"])]
    if not known.size or np.ptp(known) or not 0 <= known[0] <= 1:
        value = f"{known.min():g} to {known.max():g}" if known.size else "no number"
        raise DataError(Mistake("duty_cycle", value, "must be one number from 0 to 1 in each trial"), record.trial)
    return float(known[0]), insertion_of(record, segments=1, plane=plane, skip_mm=skip_mm)


def _columns(insertions: Sequence[tuple[float, CurvatureTrial]]) -> tuple[Array, Array, Array]:
    rows = [(cycle, trial.whole.curvature_per_mm, trial.whole.interval_sd_per_mm) for cycle, trial in insertions]
    duty, curvature, sd = np.array(rows).T
    return duty, curvature, sd


def _linear(score: float, p_value: float) -> Finding:
    says = "the curvature falls linearly with the duty cycle"
    if p_value < 0.05:
        says = "the curvature does not fall linearly: measure at the duty cycle of the plan, and without turning"
    return Finding("linear in the duty cycle", score, p_value, says)


def _validated(duty: float, held: CurvatureTrial, fit: CurvatureByDuty) -> Finding:
    expected = fit.law.combination([1 - duty, duty])
    score, p_value = expected.further_trial(held.whole.curvature_per_mm, held.whole.interval_sd_per_mm)
    says = "its curvature agrees with the fit" if p_value >= 0.05 else "its curvature contradicts the fit"
    return Finding(f"held out, {held.name}".rstrip(", "), score, p_value, says)


def _draw(figure: Figure, insertions: Sequence[tuple[float, CurvatureTrial]], fit: CurvatureByDuty) -> None:
    """Draw the curvature of each insertion and the fitted line with its 95 % interval over the duty cycle."""
    from needleplan.plotting.canvas import BLUE, GREY, VERMILLION, title

    axes = figure.subplots()
    duty = np.linspace(0, 1, 101)
    line = [fit.at(float(cycle)) for cycle in duty]
    axes.fill_between(duty, [mean.low for mean in line], [mean.high for mean in line], color=BLUE, alpha=0.15)
    axes.plot(duty, [mean.value for mean in line], color=BLUE, label="fitted, 95 % interval of the mean")
    for number, (cycle, trial) in enumerate(insertions):
        whole = trial.whole
        reach = [[whole.curvature_per_mm - whole.low_per_mm], [whole.high_per_mm - whole.curvature_per_mm]]
        axes.errorbar([cycle], [whole.curvature_per_mm], reach, fmt="o", color=VERMILLION, capsize=3, markersize=4,
                      label=None if number else "insertions, 95 % interval")  # fmt: skip
    axes.axhline(0, color=GREY, linewidth=0.8)
    axes.set_xlabel("duty cycle: share of the length during which the needle turns")
    axes.set_ylabel("curvature (1/mm)")
    axes.legend(frameon=False, fontsize=8)
    title(axes, "Curvature by duty cycle")
