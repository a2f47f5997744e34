"""Predicted beside realised success: transitions, spacings and executions compared on the shipped scenarios."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needleplan.artifacts import write_whole
from needleplan.planning import PolicyTable
from needleplan.reports.chapters import Effort
from needleplan.reports.comparison import Agreement, Comparison
from needleplan.scenario import Scenario, Transition
from needleplan_thesis.chapter6.entries import Execution, Study, choose_entries, execute, planned
from needleplan_thesis.chapter6.scatter import draw_believability

if TYPE_CHECKING:
    from needleplan.reports.chapters import Request

__all__ = ["SCENARIOS", "believability", "summary", "write_entries"]

SCENARIOS = ("four_obstacles", "narrow_passage", "prostate", "brain")
_REFERENCE = (Transition.INTERPOLATED, 0.5)
_RUNS = {Effort.QUICK: 1000, Effort.DEFAULT: 20_000, Effort.FULL: 20_000}
_SPACINGS_MM = {Effort.QUICK: (1.0,), Effort.DEFAULT: (1.0, 0.5), Effort.FULL: (1.0, 0.5, 0.25)}
_REFINEMENT = 3
_MOST_POINTS, _MEAN_POINTS = 2.0, 1.0
_FINE_ARC = 40


def believability(request: Request) -> list[Comparison]:
    """Run the study; where there is a folder, every entry goes to predicted_realised.csv and .png."""
    studies = [study for name in SCENARIOS for study in _of_scenario(name, request)]
    if request.folder:
        write_entries(request.folder / "predicted_realised.csv", studies)
        draw_believability(studies, _RUNS[request.effort], request.folder / "predicted_realised.png")
    comparisons = [comparison for study in studies for comparison in summary(study)]
    goal = [study for study in studies if _has_goal(study)]
    return comparisons + [comparison for study in goal for comparison in _each_entry(study)]


def summary(study: Study) -> list[Comparison]:
    """Return mean and maximum of |predicted - realised|, with a verdict where there is a goal."""
    apart = np.abs(study.points)
    name = f"ch6/predicted less realised/{study.scenario}, {_grid(study)}, {study.execution}"
    ours = {"mean": float(apart.mean()), "max": float(apart.max())}
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
        )
        for what, value in ours.items()
    ]  # fmt: skip


def write_entries(path: Path, studies: list[Study]) -> None:
    """Write a line for every entry of every study. Raises OutputError."""
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


def _of_scenario(name: str, request: Request) -> Iterator[Study]:
    scenario, runs = Scenario.read(name), _RUNS[request.effort]
    reference = planned(scenario, *_REFERENCE)
    entries = choose_entries(reference)
    for transition in Transition:
        for spacing in _SPACINGS_MM[request.effort]:
            request.note(f"predicted and realised: {name}, {transition}, {spacing:g} mm")
            is_reference = (transition, spacing) == _REFERENCE
            table = reference if is_reference else planned(scenario, transition, spacing)
            executions = [Execution()]
            if spacing == _REFERENCE[1] or request.effort is not Effort.DEFAULT:
                executions.append(Execution(greedy=True))
            if is_reference and request.effort is Effort.FULL:
                executions += [Execution(arc_samples=_FINE_ARC), Execution(greedy=True, arc_samples=_FINE_ARC)]
            for execution in executions:
                study = execute(name, table, entries, execution, runs)
                yield study
                if is_reference and execution == Execution():
                    yield _predicted_finer(study, planned(scenario, *_REFERENCE, _REFINEMENT))


def _predicted_finer(study: Study, table: PolicyTable) -> Study:
    """Return `study` with the predictions of `table`, which has the same policy and knows better what it does."""
    predicted = table.lookup_many(study.entries).success.astype(np.float64)
    return replace(study, grid=table.scenario.grid, predicted=predicted)


def _is_reference(study: Study) -> bool:
    return (study.grid.transition, study.grid.spacing_mm[0]) == _REFERENCE


def _has_goal(study: Study) -> bool:
    return _is_reference(study) and study.execution == Execution()


def _verdict(value: float, goal: float | None) -> Agreement:
    if goal is None:
        return Agreement.OURS
    return Agreement.MET if value <= goal else Agreement.MISSED


def _each_entry(study: Study) -> Iterator[Comparison]:
    for k, entry in enumerate(study.entries):
        verdict = _verdict(abs(study.points[k]), _MOST_POINTS)
        name = f"ch6/entries/{study.scenario}, {_grid(study)}, {study.execution}/{_pose(entry)}"
        yield Comparison(name, None, f"{_shares(study, k)}, {study.points[k]:+.2f} points", "", verdict, "")


def _grid(study: Study) -> str:
    times = study.grid.success_refinement
    finer = f", success on a grid {times} times finer" if times > 1 else ""
    return f"{study.grid.transition} {study.grid.spacing_mm[0]:g} mm{finer}"


def _pose(entry: np.ndarray) -> str:
    x, y, heading, bevel = entry.tolist()
    return f"({x:g}, {y:g}) mm, {math.degrees(heading):.0f} deg, bevel {bevel:+.0f}"


def _shares(study: Study, k: int) -> str:
    predicted, realised = 100 * study.predicted[k], 100 * study.realised[k]
    low, high = 100 * study.interval[k]
    return f"predicted {predicted:.1f} %, realised {realised:.1f} % ({low:.1f} to {high:.1f})"
