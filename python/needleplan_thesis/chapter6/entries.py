"""Predicted and realised success from many entries of the shipped scenarios: transitions, spacings and executions.

The entries lie on the left edge at every multiple of 10 mm, with the headings nearest to -30, 0 and +30 degrees and the
bevel of the lower cost. An entry is kept if the interpolated table at 0.5 mm predicts a success above 1 %. All tables
of a scenario are evaluated at the same entries.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from needleplan.artifacts import write_whole
from needleplan.planning import MOST_STEPS, PolicyTable, plan, wilson
from needleplan.plotting import caption, save
from needleplan.plotting.canvas import BLACK, BLUE, GREEN, GREY, ORANGE, SKY, VERMILLION, title
from needleplan.reports.chapters import Effort
from needleplan.reports.comparison import Agreement, Comparison, Evidence
from needleplan.scenario import Grid, Method, Scenario, Transition

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from needleplan.reports.chapters import Request

__all__ = [
    "SCENARIOS",
    "SEED",
    "EntryStudy",
    "ExecutionRule",
    "choose_entries",
    "draw_predicted_and_realised",
    "execute",
    "planned",
    "predicted_and_realised",
    "sampled",
    "summary",
    "write_entries",
]

# Seed of all executions.
SEED = 6

# Rule for the entries: spacing along the edge (mm), headings (degrees), and lower limit of the predicted success.
_EVERY_MM = 10.0
_HEADINGS_DEG = (-30.0, 0.0, 30.0)
_LEAST_SUCCESS = 0.01


@dataclass(frozen=True)
class ExecutionRule:
    """How a table is executed: by the policy of the nearest state, or, if `greedy`, by interpolated values.

    `arc_samples` is the number of points per arc that are tested for collision, exit and target; None means the number
    in the scenario.
    """

    greedy: bool = False
    arc_samples: int | None = None

    def __str__(self) -> str:
        arcs = f", {self.arc_samples} points an arc" if self.arc_samples else ""
        return ("greedy" if self.greedy else "nearest state") + arcs


@dataclass(frozen=True)
class EntryStudy:
    """Predicted and realised success of n entries.

    `entries`, shape (n, 4), holds x_mm, y_mm, heading_rad and bevel. `predicted` and `realised` have shape (n,);
    `interval`, shape (n, 2), is the 95 % interval of the realised success.
    """

    scenario: str
    grid: Grid
    execution: ExecutionRule
    entries: NDArray[np.float64]
    predicted: NDArray[np.float64]
    realised: NDArray[np.float64]
    interval: NDArray[np.float64]

    @property
    def points(self) -> NDArray[np.float64]:
        """Predicted minus realised success in percentage points, shape (n,)."""
        return 100 * (self.predicted - self.realised)


def sampled(name: str) -> Scenario:
    """Return the shipped scenario `name` as in the published figures: four tested points an arc, nearest, 1 mm."""
    scenario = Scenario.read(name)
    motion = replace(scenario.motion, arc_samples=scenario.motion.arc_samples or _ARC_SAMPLES)
    return replace(scenario, motion=motion, grid=Grid(transition=Transition.NEAREST))


def planned(scenario: Scenario, transition: Transition, spacing_mm: float, refinement: int = 1) -> PolicyTable:
    """Plan `scenario` by sweeps on a square grid with the given spacing.

    The success is evaluated on a grid that is `refinement` times finer.
    """
    grid = Grid((spacing_mm, spacing_mm), transition, refinement)
    return plan(replace(scenario, grid=grid, solver=replace(scenario.solver, method=Method.SWEEP, partitions=None)))


def choose_entries(table: PolicyTable) -> NDArray[np.float64]:
    """Return the entries, shape (n, 4), that the rule of the module docstring selects with `table`."""
    scenario = table.scenario
    step = 2 * math.pi / scenario.motion.headings
    headings = [step * round(math.radians(degrees) / step) for degrees in _HEADINGS_DEG]
    heights = np.arange(_EVERY_MM, scenario.workspace.height_mm, _EVERY_MM)
    poses = np.array([(0.0, y, heading, bevel) for y in heights for heading in headings for bevel in (-1, 1)])
    answers = table.lookup_many(poses, nearest=True)
    better = np.arange(0, len(poses), 2) + np.argmin(answers.value.reshape(-1, 2), axis=1)
    entries: NDArray[np.float64] = poses[better[answers.success[better] > _LEAST_SUCCESS]]
    return entries


def execute(
    name: str, table: PolicyTable, entries: NDArray[np.float64], execution: ExecutionRule, runs: int
) -> EntryStudy:
    """Execute `table` of the scenario `name` from every entry, `runs` times each, and return the study."""
    result = table.lattice.rollout(
        policy=table.policy,
        values=table.values,
        starts=np.ascontiguousarray(entries),
        runs=runs,
        seed=SEED,
        greedy=execution.greedy,
        arc_samples=execution.arc_samples,
        max_steps=MOST_STEPS,
    )
    target = 1
    reached = np.count_nonzero(result["outcome"] == target, axis=1)
    return EntryStudy(
        scenario=name,
        grid=table.scenario.grid,
        execution=execution,
        entries=entries,
        predicted=table.lookup_many(entries, nearest=True).success.astype(np.float64),
        realised=reached / runs,
        interval=np.array([wilson(int(each), runs) for each in reached]),
    )


# Tested points of every arc in the published figures.
_ARC_SAMPLES = 4

SCENARIOS = ("four_obstacles", "narrow_passage", "prostate", "brain")
# Transition and spacing (mm) of the grid whose table determines the entries, and to which the goals apply.
_REFERENCE = (Transition.INTERPOLATED, 0.5)
# Executions per entry, and grid spacings (mm), by effort.
_RUNS = {Effort.QUICK: 1000, Effort.DEFAULT: 20_000, Effort.FULL: 20_000}
_SPACINGS_MM = {Effort.QUICK: (1.0,), Effort.DEFAULT: (1.0, 0.5), Effort.FULL: (1.0, 0.5, 0.25)}
# Refinement of the grid for a second evaluation of the predicted success.
_REFINEMENT = 3

# Goals: largest and mean difference of predicted and realised success (percentage points).
_MOST_POINTS, _MEAN_POINTS = 2.0, 1.0

# Tested points per arc in the finest execution.
_FINE_ARC = 40


def predicted_and_realised(request: Request) -> list[Comparison]:
    """Run all studies and return the comparisons.

    Writes predicted_realised.csv and predicted_realised.png if the request names a folder.
    """
    studies = [study for name in SCENARIOS for study in _of_scenario(name, request)]
    if request.folder:
        write_entries(request.folder / "predicted_realised.csv", studies)
        draw_predicted_and_realised(studies, _RUNS[request.effort], request.folder / "predicted_realised.png")
    comparisons = [comparison for study in studies for comparison in summary(study)]
    goal = [study for study in studies if _has_goal(study)]
    return comparisons + [comparison for study in goal for comparison in _each_entry(study)]


def summary(study: EntryStudy) -> list[Comparison]:
    """Return mean and maximum of |predicted - realised| as comparisons.

    They have goals if the study uses the reference grid and the default `ExecutionRule`.
    """
    apart = np.abs(study.points)
    name = f"ch6/predicted less realised/{study.scenario}, {_grid(study)}, {study.execution}"
    differences = {"mean": float(apart.mean()), "max": float(apart.max())}
    goals = {"mean": _MEAN_POINTS, "max": _MOST_POINTS} if _has_goal(study) else {}
    worst = int(apart.argmax())
    reasons = {
        "mean": f"{len(apart)} entries, bias {study.points.mean():+.2f}",
        "max": f"at {_pose(study.entries[worst])}: {_shares(study, worst)}",
    }
    return [
        Comparison(
            f"{name}/{what}", None, round(value, 3), "points", _verdict(value, goals.get(what)),
            reasons[what] + (f"; goal: at most {goals[what]:g}" if what in goals else ""),
            kind=Evidence.COMPUTED,
        )
        for what, value in differences.items()
    ]  # fmt: skip


def write_entries(path: Path, studies: list[EntryStudy]) -> None:
    """Write a CSV file with a line for every entry of every study. Raises OutputError if it cannot be written."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(
        ["scenario", "transition", "spacing_mm", "success_refinement", "execution", "x_mm", "y_mm", "heading_deg",
         "bevel", "predicted", "realised", "realised_low", "realised_high", "difference_points"]
    )  # fmt: skip
    for study in studies:
        grid = study.grid
        for k, (x, y, heading, bevel) in enumerate(study.entries.tolist()):
            low, high = study.interval[k]
            table.writerow(
                [study.scenario, grid.transition, grid.spacing_mm[0], grid.success_refinement, study.execution, x, y,
                 round(math.degrees(heading), 3), int(bevel), f"{study.predicted[k]:.4f}", f"{study.realised[k]:.4f}",
                 f"{low:.4f}", f"{high:.4f}", f"{study.points[k]:.2f}"]
            )  # fmt: skip
    write_whole(path, text.getvalue().encode())


def _of_scenario(name: str, request: Request) -> Iterator[EntryStudy]:
    scenario, runs = sampled(name), _RUNS[request.effort]
    reference = planned(scenario, *_REFERENCE)
    entries = choose_entries(reference)
    for transition in Transition:
        for spacing in _SPACINGS_MM[request.effort]:
            request.note(f"predicted and realised: {name}, {transition}, {spacing:g} mm")
            is_reference = (transition, spacing) == _REFERENCE
            table = reference if is_reference else planned(scenario, transition, spacing)
            executions = [ExecutionRule()]
            if spacing == _REFERENCE[1] or request.effort is not Effort.DEFAULT:
                executions.append(ExecutionRule(greedy=True))
            if is_reference and request.effort is Effort.FULL:
                executions += [ExecutionRule(arc_samples=_FINE_ARC), ExecutionRule(greedy=True, arc_samples=_FINE_ARC)]
            for execution in executions:
                study = execute(name, table, entries, execution, runs)
                yield study
                if is_reference and execution == ExecutionRule():
                    yield _predicted_finer(study, planned(scenario, *_REFERENCE, _REFINEMENT))


def _predicted_finer(study: EntryStudy, table: PolicyTable) -> EntryStudy:
    """Return `study` with predicted success and grid replaced by those of `table`.

    `table` must have the same policy; its success was evaluated on a finer grid.
    """
    predicted = table.lookup_many(study.entries, nearest=True).success.astype(np.float64)
    return replace(study, grid=table.scenario.grid, predicted=predicted)


def _is_reference(study: EntryStudy) -> bool:
    return (study.grid.transition, study.grid.spacing_mm[0]) == _REFERENCE


def _has_goal(study: EntryStudy) -> bool:
    return _is_reference(study) and study.execution == ExecutionRule()


def _verdict(value: float, goal: float | None) -> Agreement:
    if goal is None:
        return Agreement.OURS
    return Agreement.MET if value <= goal else Agreement.MISSED


def _each_entry(study: EntryStudy) -> Iterator[Comparison]:
    for k, entry in enumerate(study.entries):
        verdict = _verdict(abs(study.points[k]), _MOST_POINTS)
        name = f"ch6/entries/{study.scenario}, {_grid(study)}, {study.execution}/{_pose(entry)}"
        yield Comparison(
            name, None, f"{_shares(study, k)}, {study.points[k]:+.2f} points", "", verdict, "", kind=Evidence.COMPUTED
        )


def _grid(study: EntryStudy) -> str:
    times = study.grid.success_refinement or 1
    finer = f", success on a grid {times} times finer" if times > 1 else ""
    return f"{study.grid.transition} {study.grid.spacing_mm[0]:g} mm{finer}"


def _pose(entry: np.ndarray) -> str:
    x, y, heading, bevel = entry.tolist()
    return f"({x:g}, {y:g}) mm, {math.degrees(heading):.0f} deg, bevel {bevel:+.0f}"


def _shares(study: EntryStudy, k: int) -> str:
    predicted, realised = 100 * study.predicted[k], 100 * study.realised[k]
    low, high = 100 * study.interval[k]
    return f"predicted {predicted:.1f} %, realised {realised:.1f} % ({low:.1f} to {high:.1f})"


_FINER = "#CC79A7"
_COLOURS = {
    (Transition.NEAREST, 1.0): ORANGE,
    (Transition.NEAREST, 0.5): VERMILLION,
    (Transition.NEAREST, 0.25): BLACK,
    (Transition.INTERPOLATED, 1.0): SKY,
    (Transition.INTERPOLATED, 0.5): BLUE,
    (Transition.INTERPOLATED, 0.25): GREEN,
}


def draw_predicted_and_realised(studies: Sequence[EntryStudy], runs: int, file: Path) -> None:
    """Draw predicted minus realised success by entry: a panel per scenario, a colour per grid."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(study.scenario for study in studies))
    figure = Figure(figsize=(3.1 * len(names), 3.2), layout="constrained")
    every = figure.subplots(1, len(names), squeeze=False, sharey=True).flat
    for axes, name in zip(every, names, strict=True):
        chosen = [study for study in studies if study.scenario == name and study.execution == ExecutionRule()]
        _draw(axes, chosen)
        title(axes, name.replace("_", " "))
    axes = figure.axes[0]
    axes.set_ylabel("predicted - realised (points)")
    handles = axes.get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper left", ncols=len(handles[0]), frameon=False, fontsize=8)
    caption(
        figure,
        f"Predicted minus realised success, {runs:,} executions per entry by the policy of the nearest state; bars: "
        f"95 % intervals. Grey: within {_MOST_POINTS:g} points. Above zero: the prediction is too high.",
    )
    save(figure, file)


def _draw(axes: Axes, studies: Sequence[EntryStudy]) -> None:
    axes.axhspan(-_MOST_POINTS, _MOST_POINTS, color=GREY, alpha=0.2, linewidth=0)
    axes.axhline(0, color=GREY, linewidth=0.8)
    for study in studies:
        transition, spacing, times = study.grid.transition, study.grid.spacing_mm[0], study.grid.success_refinement or 1
        low, high = study.interval.T
        axes.errorbar(
            100 * study.realised,
            study.points,
            yerr=100 * abs(study.realised - [high, low])[::-1],
            linestyle="none",
            marker="o",
            markersize=3.2,
            linewidth=0.8,
            color=_COLOURS.get((transition, spacing), BLACK) if times == 1 else _FINER,
            label=f"{transition} {spacing:g} mm" + (f", success {times} x finer" if times > 1 else ""),
        )
    axes.set_xlabel("realised success (%)")
    axes.set_xlim(0, 100)
