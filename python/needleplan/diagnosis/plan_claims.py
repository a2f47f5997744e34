"""What a plan claims, judged by recorded insertions: success, curvature, tip noise, and the plane of the plan.

Between decisions i and i + 1 of an insertion in the plane the needle advances by d_i with the bevel b_i. A step of the
plan has the length l_i there. The estimated headings t_i have independent errors of the variance s, and the heading
diffuses with the variance q for each step of the plan:

    t_(i+1) - t_i = k b_i d_i / r_i + e_i,    var e_i = q d_i / l_i + 2 s,    cov(e_i, e_(i+1)) = -s

with the radius r_i of the plan, and b_i = 0 in a straight step. The factor k, q and s have the largest restricted
likelihood of all insertions. The interval of q is the profile interval; that of k is Student's, at the best q and s.
The plan claims that k is 1, and that q is the variance of its tip noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky_banded, solveh_banded
from scipy.optimize import brentq, minimize
from scipy.stats import binomtest, chi2, t

from needleplan.artifacts import CallRepr, ShortRepr
from needleplan.errors import DataError, Mistake
from needleplan.planning import Table, Uncertainty
from needleplan.recording import Recording
from needleplan.scenario import Scenario
from needleplan.signals import Array

__all__ = ["PlanClaim", "PlanComparison", "compare_plan"]

# Probability below which a claim does not hold: one true claim in a hundred.
_DOUBT = 0.01
# Ends of a run in a recording by which the plan is judged, the first in the target; others are by persons and faults.
_TARGET = "target"
_JUDGED = (_TARGET, "missed", "unreachable", "outside", "collision", "too_long")
# Executions from the entry of each insertion: their chance counts less than that of the insertion.
_EXECUTIONS = 500
# Fewest steps from which curvature and noise are estimated, and fewest runs from which a mean has an interval.
_FEWEST_STEPS, _FEWEST_RUNS = 10, 3
# Range of the sought standard deviations: heading noise (rad) in a step, and error of a heading (rad).
_LEAST_SD, _LARGEST_SD = 1e-5, 1.0
_LOG_RANGE = math.log(_LEAST_SD), math.log(_LARGEST_SD)


@dataclass(frozen=True)
class PlanClaim(CallRepr):
    """One number that a plan states, beside its measured value.

    Attributes
    ----------
    name : str
        Success, curvature, tip noise, or distance from the plane.
    planned, measured : float
        Claimed and measured value.
    low, high : float
        95 % interval of the measured value.
    unit : str
        Unit of these values; empty for a probability.
    p_value : float
        Probability of so large a difference, or a larger one, if the claim holds.
    """

    name: str
    planned: float
    measured: float
    low: float
    high: float
    unit: str
    p_value: float

    @property
    def holds(self) -> bool:
        """Whether chance explains the difference, with a probability of 0.01 or more."""
        return self.p_value >= _DOUBT


@dataclass(frozen=True)
class PlanComparison(ShortRepr):
    """The claims of a plan beside the insertions that followed it.

    Attributes
    ----------
    claims : tuple of PlanClaim
        The claims that these insertions can judge.
    runs : int
        Number of insertions that the loop ended.
    remarks : tuple of str
        Insertions and claims that are not judged, and why.
    """

    claims: tuple[PlanClaim, ...]
    runs: int
    remarks: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether all claims hold, and at least one was judged."""
        return bool(self.claims) and all(claim.holds for claim in self.claims)

    def lines(self) -> Iterator[str]:
        """Yield the lines for the terminal."""
        yield f"claims of the plan beside {self.runs} insertion{'s' * (self.runs != 1)}"
        yield f"  {'claim':<28}{'planned':>10}{'measured':>10}  {'95 % interval':<20}{'chance':>8}"
        for claim in self.claims:
            interval = f"{claim.low:.4g} to {claim.high:.4g}"
            verdict = "" if claim.holds else "  does not hold"
            yield (
                f"  {claim.name:<28}{claim.planned:>10.4g}{claim.measured:>10.4g}  {interval:<20}{claim.p_value:>8.2g}"
                f"  {claim.unit}{verdict}"
            )
        yield from (f"  {remark}" for remark in self.remarks)


@dataclass(frozen=True)
class _PlannedRun:
    """Decisions of one insertion: predicted success, outcome, headings, turns of the arcs, and steps of the plan."""

    predicted: float
    ended: str
    start: tuple[float, ...]
    headings: Array
    planned_rad: Array
    steps: Array
    from_plane_mm: float
    heading_sd_rad: float


def compare_plan(table: Table, recordings: Sequence[Recording], coil_mm: float | None = None) -> PlanComparison:
    """Judge what a table claims by recorded insertions that followed it.

    Parameters
    ----------
    table : Table
        The table. Curvature, tip noise and distance from the plane are judged for plans in the plane.
    recordings : sequence of Recording
        Recordings of `insert` with this table.
    coil_mm : float, optional
        Distance of the coil behind the tip. With it, the success of a tip that is known up to the coil is judged too.

    Returns
    -------
    PlanComparison
        Claims with measured values and 95 % intervals.

    Raises
    ------
    DataError
        If a recording is no insertion with this table, or is given twice.
    """
    wrong = [
        Mistake(recording.path.name, "", f"is no insertion with this table, {table.digest[:15]}...")
        for recording in recordings
        if recording.session.digests.get("table") != table.digest
    ]
    seen: dict[tuple[int, ...], str] = {}
    for recording in recordings:
        span = (recording.session.wall_ns, recording.start_ns, recording.end_ns, sum(recording.counts.values()))
        if span in seen:
            wrong.append(Mistake(recording.path.name, "", f"is the insertion of {seen[span]} once more"))
        seen.setdefault(span, recording.path.name)
    if wrong:
        raise DataError(wrong)
    scenario = table.scenario if isinstance(table.scenario, Scenario) else None
    runs, remarks = [], []
    for recording in recordings:
        run = _run(recording, scenario)
        if run is None or run.ended not in _JUDGED:
            how = "has no decision and end" if run is None else f"ended as {run.ended}"
            remarks.append(f"{recording.path.name} is left out: it {how}")
        else:
            runs.append(run)
    claims = [_success("success", [run.predicted for run in runs], runs)] if runs else []
    if runs and coil_mm is not None:
        late = Uncertainty(coil_mm=coil_mm)
        shares = [table.success_under(late, run.start, executions=_EXECUTIONS).together.value for run in runs]
        claims.append(_success(f"success, coil {coil_mm:.3g} mm behind", shares, runs))
    if scenario:
        steps = sum(len(run.steps) for run in runs)
        if not any(run.planned_rad.any() for run in runs):
            remarks.append("curvature and tip noise are not judged: no step of these insertions was to bend")
        elif steps >= _FEWEST_STEPS:
            claims += _motion(scenario, runs)
        else:
            remarks.append(f"curvature and tip noise are not judged: {steps} steps, {_FEWEST_STEPS} are needed")
        if len(runs) >= _FEWEST_RUNS:
            claims.append(_plane(runs))
    if runs:
        sd_deg = math.degrees(float(np.median([run.heading_sd_rad for run in runs])))
        remarks.append(
            f"the success of the plan assumes that each decision knows the pose; the standard deviation of the heading "
            f"was {sd_deg:.2g} deg"
        )
    return PlanComparison(tuple(claims), len(runs), tuple(remarks))


def _run(recording: Recording, scenario: Scenario | None) -> _PlannedRun | None:
    """Return the decisions of a recorded insertion; None without a decision or an end."""
    decisions = [message.values for message in recording.messages(["/decision"])]
    ends = [each.values for each in recording.messages(["/event"]) if each.values["name"] == "end"]
    if not decisions or not ends:
        return None
    advanced_mm = np.diff([float(each["path_mm"]) for each in decisions])
    headings = planned = steps = np.zeros(0)
    if scenario:
        x_mm, y_mm, headings, bevels = np.array([each["pose"] for each in decisions], float).T
        sides = {"insert": 1.0, "rotate": -1.0}  # a straight step has none
        bevels = bevels * [sides.get(each["action"], 0.0) for each in decisions]
        radii_mm = scenario.radius_mm(x_mm, y_mm)
        planned = advanced_mm * (bevels / radii_mm)[:-1]
        steps = advanced_mm / [scenario.motion.step_length_mm(float(radius_mm)) for radius_mm in radii_mm[:-1]]
    return _PlannedRun(
        float(decisions[0]["success"]), str(ends[-1]["cause"]), tuple(decisions[0]["pose"]), headings, planned, steps,
        float(decisions[-1]["tip"]["z_mm"]),
        float(np.median([each["tip"]["heading_sd_rad"] for each in decisions])),
    )  # fmt: skip


def _success(name: str, predicted: Sequence[float], runs: Sequence[_PlannedRun]) -> PlanClaim:
    """Return the claim of these probabilities: the number of runs in the target is Poisson binomial."""
    reached = sum(run.ended == _TARGET for run in runs)
    counts = np.ones(1)
    for probability in predicted:
        counts = np.convolve(counts, [1 - probability, probability])
    as_rare = counts <= counts[reached] * (1 + 1e-9)
    interval = binomtest(reached, len(runs)).proportion_ci(0.95)
    return PlanClaim(
        name, float(np.mean(predicted)), reached / len(runs), interval.low, interval.high, "",
        min(float(counts[as_rare].sum()), 1.0),
    )  # fmt: skip


def _motion(scenario: Scenario, runs: Sequence[_PlannedRun]) -> Iterator[PlanClaim]:
    """Yield the claims of curvature and tip noise."""
    motion = scenario.motion
    claimed_sd = motion.noise_step_rad * math.sqrt(2 * sum(k**2 * p for k, p in enumerate(motion.tip_noise)))
    likelihood = _HeadingLikelihood(runs)
    best = likelihood.best()
    factor, sd = likelihood.factor(*best)
    free = sum(len(run.steps) for run in runs) - 3
    low, high = (factor + side * float(t.ppf(0.975, free)) * sd for side in (-1, 1))
    planned, name, unit = 1.0, "curvature, relative", ""
    if scenario.uniform and math.isfinite(scenario.needle.curvature_radius_mm):
        planned, name, unit = 1 / scenario.needle.curvature_radius_mm, "curvature", "1/mm"
    p_value = float(2 * t.sf(abs(factor - 1) / sd, free))
    yield PlanClaim(name, planned, planned * factor, planned * low, planned * high, unit, p_value)
    drop = 2 * (likelihood(*best) - likelihood.profile(max(claimed_sd, _LEAST_SD)))
    low, high = map(math.degrees, likelihood.interval(best))
    yield PlanClaim(
        "tip noise of a step", math.degrees(claimed_sd), math.degrees(best[0]), low, high, "deg",
        float(chi2.sf(max(drop, 0.0), 1)),
    )  # fmt: skip


def _plane(runs: Sequence[_PlannedRun]) -> PlanClaim:
    """Return the claim that the tips end in the plane of the plan, on average: a claim of the registration."""
    distances = np.array([run.from_plane_mm for run in runs])
    mean, error = float(distances.mean()), float(distances.std(ddof=1)) / math.sqrt(len(runs))
    wide = float(t.ppf(0.975, len(runs) - 1)) * error
    p_value = float(2 * t.sf(abs(mean) / max(error, 1e-12), len(runs) - 1))
    return PlanClaim("distance from the plane", 0.0, mean, mean - wide, mean + wide, "mm", p_value)


class _HeadingLikelihood:
    """Restricted log-likelihood of the heading increments of all runs."""

    def __init__(self, runs: Sequence[_PlannedRun]) -> None:
        runs = [run for run in runs if len(run.steps)]
        turns = [np.diff(run.headings) for run in runs]
        self._increments = [np.arctan2(np.sin(turn), np.cos(turn)) for turn in turns]
        self._steps = [run.steps for run in runs]
        self._planned = [run.planned_rad for run in runs]

    def __call__(self, noise: float, error: float) -> float:
        """Return the log-likelihood for the noise of a step (rad) and an error of the headings (rad)."""
        normal, right, square, logs = self._sums(noise, error)
        return -0.5 * (logs + math.log(normal) + square - right**2 / normal)

    def _sums(self, noise: float, error: float) -> tuple[float, float, float, float]:
        normal = right = square = logs = 0.0
        for steps, planned, increments in zip(self._steps, self._planned, self._increments, strict=True):
            bands: Array = np.zeros((2, len(steps)))
            bands[0], bands[1, :-1] = noise**2 * steps + 2 * error**2, -(error**2)
            solved = solveh_banded(bands, np.column_stack([planned, increments]), lower=True)
            normal += float(planned @ solved[:, 0])
            right += float(planned @ solved[:, 1])
            square += float(increments @ solved[:, 1])
            logs += 2 * float(np.log(cholesky_banded(bands, lower=True)[0]).sum())
        return normal, right, square, logs

    def factor(self, noise: float, error: float) -> tuple[float, float]:
        """Return the best factor of the planned turns and its standard deviation."""
        normal, right, _, _ = self._sums(noise, error)
        return right / normal, 1 / math.sqrt(normal)

    def best(self) -> tuple[float, float]:
        """Return the noise and the error with the largest likelihood."""

        def loss(logs: Array) -> float:
            return -self(*np.exp(logs).tolist())

        starts = np.log([(0.05, 0.01), (0.02, 0.002), (0.005, 0.02)])
        found = [minimize(loss, start, bounds=[_LOG_RANGE] * 2) for start in starts]
        noise, error = np.exp(min(found, key=lambda each: float(each.fun)).x).tolist()
        return noise, error

    def profile(self, noise: float) -> float:
        """Return the largest log-likelihood for a noise."""

        def loss(logs: Array) -> float:
            return -self(noise, math.exp(logs[0]))

        grid = np.linspace(*_LOG_RANGE, 60)
        start = grid[int(np.argmin([loss(grid[[number]]) for number in range(len(grid))]))]
        return -float(minimize(loss, [start], bounds=[_LOG_RANGE]).fun)

    def interval(self, best: tuple[float, float]) -> tuple[float, float]:
        """Return the 95 % profile interval of the noise; 0 if the data do not exclude that there is none."""
        least = self(*best) - chi2.ppf(0.95, 1) / 2

        def above(log: float) -> float:
            return self.profile(math.exp(log)) - least

        middle, (lowest, highest) = math.log(best[0]), _LOG_RANGE
        low = 0.0 if above(lowest) > 0 else math.exp(brentq(above, lowest, middle, xtol=1e-3))
        high = _LARGEST_SD if above(highest) > 0 else math.exp(brentq(above, middle, highest, xtol=1e-3))
        return low, high
