"""Section 6.5, Figs. 6.7 to 6.9: three experiments in a phantom, as plans and as insertions in the lab twin.

The starts, the radius (646.83 mm), the 1800 headings (steps of alpha = 0.2 degrees), the grid of 3 x 0.15 mm and the
insertion speed are those of the thesis. The costs are those of section 6.4, with a rotation cost of 100 or 40. With the
discount and the failure costs of the thesis, every plan would prefer a failure. Therefore failures cost 1,000 here,
without discount; with this value the cost of a rotation still has an effect.

Rods, target and the imperfections of the lab (those of the shipped simulation `steering`) are assumed. The base turns
ten times faster than the three turns a minute of the thesis, which changes only the duration in the twin. The
measurements in gel cannot be repeated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from needleplan.planning import Outcome, PolicyTable, plan
from needleplan.plotting import caption, save, sheet
from needleplan.plotting.canvas import GREY, SKY, title
from needleplan.reports.comparison import Agreement, Comparison, Evidence, measured
from needleplan.scenario import Grid, Scenario, Transition
from needleplan.simulation import Simulation
from needleplan_thesis.chapter6.paths import Panel, draw_panels, ending
from needleplan_thesis.steering import (
    Guidance,
    SteeringCase,
    SteeringSummary,
    SteeringTask,
    SteeringTrial,
    run_all,
    steering_simulation,
    summarized,
)

__all__ = [
    "EXPERIMENTS",
    "PhantomExperiment",
    "experiments",
    "miss_mm",
    "phantom",
    "published_phantom",
    "with_rotation",
]

_SECTION = "ch6/section 6.5"
# Cost of a collision and of an exit.
_FAILURE = 1000.0
_WHY = "rods and target are assumed, the thesis prints no coordinates; failures 1,000, no discount"
# Number of executions with tip noise for a realised success.
_RUNS = 10_000


@dataclass(frozen=True)
class PhantomExperiment:
    """A plan of section 6.5: figure, start, cost of a rotation, published number of turns.

    `alphas` is the start heading in steps of alpha; None means the best heading of the table. `turns` is None if the
    thesis finds no path.
    """

    figure: str
    y_mm: float
    alphas: int | None
    rotation: float
    turns: int | None


# All plans of section 6.5.
EXPERIMENTS = (
    PhantomExperiment("6.7", 1.0, -5, 100.0, 1),
    PhantomExperiment("6.8a", 1.5, -5, 100.0, 1),
    PhantomExperiment("6.8b", 1.5, -5, 40.0, 4),
    PhantomExperiment("6.8c", 1.5, 5, 100.0, 1),
    PhantomExperiment("6.9, no path", 1.8, 5, 100.0, None),
    PhantomExperiment("6.9a", 1.8, 3, 100.0, 2),
    PhantomExperiment("6.9b", 1.8, None, 100.0, 0),
)


def published_phantom() -> Scenario:
    """Return the shipped phantom on the grid of the thesis, with its step of one heading and four points an arc."""
    scenario = Scenario.read("phantom")
    motion = replace(scenario.motion, step_mm=None, arc_samples=4)
    return replace(scenario, motion=motion, grid=Grid((3.0, 0.15), Transition.INTERPOLATED, 1))


def phantom(folder: Path | None, note: Callable[[str], None], fine: bool) -> list[Comparison]:
    """Plan all experiments and return the comparisons; draw the figures if a folder is given.

    `fine` halves the grid spacing of the thesis.
    """
    note("Figs. 6.7 to 6.9")
    scenario = published_phantom()
    if fine:
        dx, dy = scenario.grid.spacing_mm
        scenario = replace(scenario, grid=replace(scenario.grid, spacing_mm=(dx / 2, dy / 2)))
    tables = {rotation: plan(with_rotation(scenario, rotation)) for rotation in (100.0, 40.0)}
    panels = {each.figure: _panel(each, tables[each.rotation]) for each in EXPERIMENTS}
    if folder:
        _draw(panels, folder)
    turns = [
        measured(
            f"{_SECTION}/{each.figure} turns",
            each.turns,
            panels[each.figure].turns,
            "turns",
            _WHY,
            kind=Evidence.COMPUTED,
        )
        for each in EXPERIMENTS
        if each.turns is not None
    ]
    return [*turns, *_statements(panels), *_predictions(scenario)]


def miss_mm(panel: Panel) -> float:
    """Return the smallest distance (mm) of the poses of a path from the rim of the target; negative inside."""
    target = panel.table.scenario.target
    x, y = target.center_mm
    return min(math.hypot(*(pose[:2] - (x, y))) for pose in panel.path.poses) - target.radius_mm


def with_rotation(scenario: Scenario, rotation: float) -> Scenario:
    """Return the scenario with this rotation cost and the failure costs of this module."""
    objective = replace(scenario.objective, rotation=rotation, collision=_FAILURE, exit=_FAILURE)
    return replace(scenario, objective=objective)


def _panel(experiment: PhantomExperiment, table: PolicyTable) -> Panel:
    alpha = 2 * math.pi / table.scenario.motion.headings
    if experiment.alphas is None:
        start = tuple(table.best_entry(y_mm=experiment.y_mm, nearest=True).pose)
    else:
        start = (0.0, experiment.y_mm, experiment.alphas * alpha)
    panel = Panel.of("", table, start)
    realised = table.rollout(panel.start, _RUNS, nearest=True).success
    heading = (
        f"{experiment.figure}: from (0, {experiment.y_mm:g}), {round(start[2] / alpha):+d} $\\alpha$, $C_r$ = "
        f"{experiment.rotation:g}: {panel.turns} turns, success {realised:.2f}"
    )
    return replace(panel, heading=heading)


def _draw(panels: dict[str, Panel], folder: Path) -> None:
    conditions = (
        "$\\alpha$ = 0.2 deg; rods and target are assumed, the thesis prints no coordinates. Failures 1,000, no "
        "discount; success realised in 10,000 executions."
    )
    published_results = {
        "6.7": "The thesis has one turn, at (9, 0.75) mm.",
        "6.8": "The thesis has 1, 4 and 1 turns, and misses the target with the last.",
        "6.9": "The thesis finds no path with +5 $\\alpha$, 2 turns with +3 $\\alpha$, none with the best heading, "
        "-16 $\\alpha$.",
    }
    for figure, published in published_results.items():
        chosen = [panel for name, panel in panels.items() if name.startswith(figure)]
        draw_panels(chosen, f"Fig. {figure}. {published} {conditions}", folder / f"fig_{figure.replace('.', '_')}.png")


def _statements(panels: dict[str, Panel]) -> list[Comparison]:
    alpha = 2 * math.pi / 1800
    dear, cheap, late = panels["6.8a"], panels["6.8b"], panels["6.8c"]
    blocked, steered, best = panels["6.9, no path"], panels["6.9a"], panels["6.9b"]

    def statement(what: str, published: str, computed: str, holds: bool) -> Comparison:
        verdict = Agreement.REPRODUCED if holds else Agreement.NOT_REPRODUCED
        return Comparison(f"{_SECTION}/{what}", published, computed, "", verdict, _WHY, kind=Evidence.QUALITATIVE)

    miss = miss_mm(late)
    return [
        statement(
            "6.8 cheaper rotations, more turns", "4 > 1", f"{cheap.turns}, {dear.turns}", cheap.turns > dear.turns
        ),
        statement(
            "6.8c from +5 alpha the target is just missed",
            "0.248 mm beside its edge",
            f"{ending(late.path)}, {miss:+.2f} mm from its edge",
            0 < miss < 1,
        ),
        statement(
            "6.9 from (0, 1.8) with +5 alpha a collision is unavoidable",
            "no path",
            f"{ending(blocked.path)}, predicted success {blocked.success:.2f}",
            blocked.path.outcome is Outcome.COLLISION,
        ),
        statement(
            "6.9a with +3 alpha the target is reached",
            "after 2 turns",
            f"{ending(steered.path)} after {steered.turns} turns",
            steered.path.outcome is Outcome.TARGET,
        ),
        measured(
            f"{_SECTION}/6.9b best heading",
            -16,
            round(best.start.heading_rad / alpha),
            "alpha",
            _WHY,
            kind=Evidence.COMPUTED,
        ),
    ]


def _predictions(scenario: Scenario) -> list[Comparison]:
    """Compare predicted and realised success from the best entry, for both transitions on the grid of `scenario`."""
    comparisons = []
    for transition in Transition:
        table = plan(replace(scenario, grid=replace(scenario.grid, transition=transition)))
        best = table.best_entry(nearest=True)
        nearest, greedy = (table.rollout(best.pose, _RUNS, nearest=nearest).success for nearest in (True, False))
        dx, dy = scenario.grid.spacing_mm
        computed = f"predicted {best.success:.3f}, realised {nearest:.3f}, greedy {greedy:.3f}"
        name = f"{_SECTION}/best entry, {transition} {dx:g} x {dy:g} mm"
        rounded = transition is Transition.NEAREST and dx > scenario.step_mm
        why = f"a step of {scenario.step_mm:.2f} mm, rounded to the nearest point, counts as {dx:g}" if rounded else ""
        comparisons.append(Comparison(name, None, computed, "", Agreement.OURS, why, kind=Evidence.COMPUTED))
    return comparisons


_LAB_SECTION = "ch6/experiments"
# Speeds of insertion and rotation in the lab twin.
_VELOCITY_MM_S, _VELOCITY_RAD_S = 12.0, 3.14

# Published distances (mm): largest deviation from the plan (Fig. 6.7), and end of the path beyond the rim (Fig. 6.8c).
_DEVIATION_MM, _BEYOND_MM = 0.176, 0.248
_LAB_WHY = (
    "rods, target and imperfections of the lab are assumed; the heading of its needle has a random walk of 2 mrad per "
    "root mm, which was not measured in the thesis' gel; the thesis has one insertion, measured by its tracker"
)


class _Done(NamedTuple):
    experiment: PhantomExperiment
    case: SteeringCase
    trials: list[SteeringTrial]
    summary: SteeringSummary


def experiments(folder: Path | None, note: Callable[[str], None], seeds: int) -> list[Comparison]:
    """Repeat every experiment in the lab twin with `seeds` seeds and return the comparisons.

    Draws the figures if a folder is given.
    """
    scenario, lab = published_phantom(), steering_simulation()
    done = []
    for experiment in EXPERIMENTS:
        if experiment.turns is None:  # the thesis finds no path, so there is no insertion to repeat
            continue
        note(f"{experiment.figure}: {seeds} insertions in the lab twin")
        case = _steering_case(experiment, scenario, lab)
        trials = list(run_all([SteeringTask(case, Guidance.REPLANNED, seed) for seed in range(seeds)]))
        done.append(_Done(experiment, case, trials, summarized(trials)))
    if folder:
        for figure in ("6.7", "6.8", "6.9"):
            chosen = [each for each in done if each.experiment.figure.startswith(figure)]
            _draw_lab(figure, chosen, folder / f"fig_{figure.replace('.', '_')}_lab.png")
    return [comparison for each in done for comparison in _compared(each)]


def _steering_case(experiment: PhantomExperiment, scenario: Scenario, lab: Simulation) -> SteeringCase:
    chosen = with_rotation(scenario, experiment.rotation)
    alpha = 2 * math.pi / chosen.motion.headings
    case = SteeringCase(
        experiment.figure, chosen, lab, (0.0, experiment.y_mm, (experiment.alphas or 0) * alpha),
        velocity_mm_s=_VELOCITY_MM_S, velocity_rad_s=_VELOCITY_RAD_S,
    )  # fmt: skip
    if experiment.alphas is not None:
        return case
    best = case.table.best_entry(y_mm=experiment.y_mm, nearest=True).pose
    return SteeringCase(
        experiment.figure, chosen, lab, (best.x_mm, best.y_mm, best.heading_rad), _VELOCITY_MM_S, _VELOCITY_RAD_S
    )


def _compared(done: _Done) -> list[Comparison]:
    summary, name = done.summary, f"{_LAB_SECTION}/{done.experiment.figure}"
    deviations = np.array([trial.deviation_mm for trial in done.trials])
    seen = np.array([trial.seen_deviation_mm for trial in done.trials])
    beyond = np.array([trial.beyond_rim_mm for trial in done.trials])
    low, high = summary.success_interval
    share = f"95 % interval {low:.2f} to {high:.2f}; predicted {summary.predicted:.2f}; {summary.runs} insertions"
    failures = ", ".join(f"{count} {what}" for what, count in summary.failures.items())
    return [
        Comparison(f"{name} success", None, summary.success, "", Agreement.OURS, share, kind=Evidence.COMPUTED),
        Comparison(f"{name} failures", None, failures or "none", "", Agreement.OURS, kind=Evidence.COMPUTED),
        _median(
            f"{name} largest deviation, by the tip filter, median", _DEVIATION_MM if _is(done, "6.7") else None, seen
        ),
        Comparison(f"{name} largest deviation, in truth, median", None, float(np.median(deviations)), "mm",
                   Agreement.OURS, _spread(deviations), kind=Evidence.COMPUTED),
        _median(f"{name} beyond the rim, median", _BEYOND_MM if _is(done, "6.8c") else None, beyond),
        Comparison(f"{name} error to the centre, mean", None, summary.error_mm, "mm", Agreement.OURS,
                   f"95 % interval {summary.error_interval_mm[0]:.3f} to {summary.error_interval_mm[1]:.3f} mm; "
                   f"95 % of them below {summary.error_95_mm:.3f} mm", kind=Evidence.COMPUTED),
        Comparison(f"{name} turns, mean", float(done.experiment.turns or 0), summary.turns, "turns", Agreement.OURS,
                   "of the loop, which decides again at every step; the thesis counts those of the plan",
                   kind=Evidence.COMPUTED),
    ]  # fmt: skip


def _reached(trial: SteeringTrial) -> bool:
    return trial.success


def _is(done: _Done, figure: str) -> bool:
    return done.experiment.figure == figure


def _median(name: str, published: float | None, values: np.ndarray) -> Comparison:
    """Compare the published measurement of one insertion with the median of the simulated insertions."""
    median = float(np.median(values))
    if published is None:
        return Comparison(name, None, median, "mm", Agreement.OURS, _spread(values), kind=Evidence.COMPUTED)
    return measured(name, published, median, "mm", f"{_spread(values)}; {_LAB_WHY}", kind=Evidence.COMPUTED)


def _spread(values: np.ndarray) -> str:
    low, high = np.percentile(values, [2.5, 97.5]).tolist()
    return f"95 % of the insertions from {low:.3f} to {high:.3f} mm"


def _draw_lab(figure: str, chosen: Sequence[_Done], file: Path) -> None:
    from matplotlib.lines import Line2D

    drawing, every = sheet(chosen[0].case.scenario.workspace, len(chosen))
    for axes, done in zip(every, chosen, strict=True):
        done.case.scenario.plot(axes)
        for trial in sorted(done.trials, key=_reached):
            colour = SKY if trial.success else GREY
            axes.plot(*trial.path_mm[:, :2].T, color=colour, linewidth=0.5, alpha=0.6, zorder=2)
        done.case.table.path(done.case.pose, nearest=True).plot(axes, scene=False)
        summary = done.summary
        title(
            axes,
            f"{done.experiment.figure}: success {summary.success:.2f} of {summary.runs} (predicted "
            f"{summary.predicted:.2f}), median error {summary.error_median_mm:.2f} mm",
        )
    handles = [
        Line2D([], [], color=SKY, linewidth=0.8, label="in the lab twin, reached the target"),
        Line2D([], [], color=GREY, linewidth=0.8, label="in the lab twin, failed"),
    ]
    drawing.legend(handles=handles, loc="outside upper left", ncols=2, frameon=False, fontsize=8)
    caption(
        drawing,
        f"Fig. {figure} in the lab twin. Thick: the plan. Thin: true paths of insertions with feedback, one per seed. "
        "Rods, target and the imperfections of the lab are assumed; the thesis measured one insertion each.",
    )
    save(drawing, file)
