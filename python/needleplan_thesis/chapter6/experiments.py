"""Section 6.5, Figs. 6.7 to 6.9, as experiments: the loop steers a needle of the thesis' radius in the lab twin.

Starts, costs, radius, grid and insertion speed are the thesis'; rods, target and the imperfections of the lab (those of
the shipped experiment `steering`) are ours. The base turns ten times faster than the thesis' three turns a minute: in
the twin nothing depends on that but the time it takes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from needleplan.plotting import caption, save, sheet
from needleplan.plotting.canvas import GREY, SKY, title
from needleplan.reports.comparison import Agreement, Comparison, measured
from needleplan.scenario import Scenario
from needleplan.simulation import Experiment as LabExperiment
from needleplan_thesis.chapter6.phantom import EXPERIMENTS, Experiment, with_rotation
from needleplan_thesis.steering import Course, Guidance, Summary, Task, Trial, run_all, summarized

__all__ = ["experiments"]

_SECTION = "ch6/experiments"
_VELOCITY_MM_S, _VELOCITY_RAD_S = 12.0, 3.14
_DEVIATION_MM, _BESIDE_MM = 0.176, 0.248
_WHY = (
    "rods, target and the lab's imperfections are ours; the lab's needle wanders by 2 mrad per root mm, which nobody "
    "measured in the thesis' gel; the thesis has one insertion, measured by its tracker"
)


class _Done(NamedTuple):
    experiment: Experiment
    course: Course
    trials: list[Trial]
    summary: Summary


def experiments(folder: Path | None, note: Callable[[str], None], seeds: int) -> list[Comparison]:
    """Carry out every experiment with so many seeds, draw where there is a folder, and compare."""
    scenario, lab = Scenario.read("phantom"), LabExperiment.read("steering")
    done = []
    for experiment in EXPERIMENTS:
        if experiment.turns is None:  # no path is what the thesis says of it: there is nothing to carry out
            continue
        note(f"{experiment.figure}: {seeds} insertions in the lab twin")
        course = _course(experiment, scenario, lab)
        trials = list(run_all([Task(course, Guidance.REPLANNED, seed) for seed in range(seeds)]))
        done.append(_Done(experiment, course, trials, summarized(trials)))
    if folder:
        for figure in ("6.7", "6.8", "6.9"):
            chosen = [each for each in done if each.experiment.figure.startswith(figure)]
            _draw(figure, chosen, folder / f"fig_{figure.replace('.', '_')}_lab.png")
    return [comparison for each in done for comparison in _compared(each)]


def _course(experiment: Experiment, scenario: Scenario, lab: LabExperiment) -> Course:
    chosen = with_rotation(scenario, experiment.rotation)
    alpha = 2 * math.pi / chosen.motion.headings
    course = Course(
        experiment.figure, chosen, lab, (0.0, experiment.y_mm, (experiment.alphas or 0) * alpha),
        velocity_mm_s=_VELOCITY_MM_S, velocity_rad_s=_VELOCITY_RAD_S,
    )  # fmt: skip
    if experiment.alphas is not None:
        return course
    best = course.table.best_entry(y_mm=experiment.y_mm).pose
    return Course(
        experiment.figure, chosen, lab, (best.x_mm, best.y_mm, best.heading_rad), _VELOCITY_MM_S, _VELOCITY_RAD_S
    )


def _compared(done: _Done) -> list[Comparison]:
    summary, name = done.summary, f"{_SECTION}/{done.experiment.figure}"
    deviations = np.array([each.deviation_mm for each in done.trials])
    seen = np.array([each.seen_deviation_mm for each in done.trials])
    beyond = np.array([each.beyond_rim_mm for each in done.trials])
    low, high = summary.success_interval
    share = f"95 % interval {low:.2f} to {high:.2f}; promised {summary.predicted:.2f}; {summary.runs} insertions"
    failures = ", ".join(f"{count} {what}" for what, count in summary.failures.items())
    return [
        Comparison(f"{name} success", None, summary.success, "", Agreement.OURS, share),
        Comparison(f"{name} failures", None, failures or "none", "", Agreement.OURS),
        _beside(
            f"{name} largest deviation, by the tip filter, median", _DEVIATION_MM if _is(done, "6.7") else None, seen
        ),
        Comparison(f"{name} largest deviation, in truth, median", None, float(np.median(deviations)), "mm",
                   Agreement.OURS, _spread(deviations)),
        _beside(f"{name} beyond the rim, median", _BESIDE_MM if _is(done, "6.8c") else None, beyond),
        Comparison(f"{name} error to the centre, mean", None, summary.error_mm, "mm", Agreement.OURS,
                   f"95 % interval {summary.error_interval_mm[0]:.3f} to {summary.error_interval_mm[1]:.3f} mm; "
                   f"95 % of them below {summary.error_95_mm:.3f} mm"),
        Comparison(f"{name} turns, mean", float(done.experiment.turns or 0), summary.turns, "turns", Agreement.OURS,
                   "of the loop, which decides anew at every step; the thesis counts those of the plan"),
    ]  # fmt: skip


def _reached(trial: Trial) -> bool:
    return trial.success


def _is(done: _Done, figure: str) -> bool:
    return done.experiment.figure == figure


def _beside(name: str, published: float | None, ours: np.ndarray) -> Comparison:
    """Compare a single published measurement with the median of ours."""
    middle = float(np.median(ours))
    if published is None:
        return Comparison(name, None, middle, "mm", Agreement.OURS, _spread(ours))
    return measured(name, published, middle, "mm", f"{_spread(ours)}; {_WHY}")


def _spread(values: np.ndarray) -> str:
    low, high = np.percentile(values, [2.5, 97.5]).tolist()
    return f"95 % of the insertions from {low:.3f} to {high:.3f} mm"


def _draw(figure: str, chosen: Sequence[_Done], file: Path) -> None:
    from matplotlib.lines import Line2D

    drawing, every = sheet(chosen[0].course.scenario.workspace, len(chosen))
    for axes, done in zip(every, chosen, strict=True):
        done.course.scenario.plot(axes)
        for trial in sorted(done.trials, key=_reached):
            colour = SKY if trial.success else GREY
            axes.plot(*trial.path_mm[:, :2].T, color=colour, linewidth=0.5, alpha=0.6, zorder=2)
        done.course.table.path(done.course.pose).plot(axes, scene=False)
        summary = done.summary
        title(
            axes,
            f"{done.experiment.figure}: success {summary.success:.2f} of {summary.runs} (promised "
            f"{summary.predicted:.2f}), median error {summary.error_median_mm:.2f} mm",
        )
    handles = [
        Line2D([], [], color=SKY, linewidth=0.8, label="in the lab twin, reached"),
        Line2D([], [], color=GREY, linewidth=0.8, label="failed"),
    ]
    drawing.legend(handles=handles, loc="outside upper right", ncols=2, frameon=False, fontsize=7.5)
    caption(
        drawing,
        f"Fig. {figure} in the lab twin. Thick: the plan. Thin: true paths of insertions with feedback, one a seed. "
        "Rods, target and the imperfections of the lab are ours; the thesis measured one insertion each.",
    )
    save(drawing, file)
