"""Predicted less realised success, entry by entry: one panel a scenario, one colour a grid."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from needleplan.plotting import caption, save
from needleplan.plotting.canvas import BLACK, BLUE, GREEN, GREY, ORANGE, SKY, VERMILLION, title
from needleplan.scenario import Transition
from needleplan_thesis.chapter6.entries import Execution, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_believability"]

_FINER = "#CC79A7"
_COLOURS = {
    (Transition.NEAREST, 1.0): ORANGE,
    (Transition.NEAREST, 0.5): VERMILLION,
    (Transition.NEAREST, 0.25): BLACK,
    (Transition.INTERPOLATED, 1.0): SKY,
    (Transition.INTERPOLATED, 0.5): BLUE,
    (Transition.INTERPOLATED, 0.25): GREEN,
}
_GOAL = 2.0


def draw_believability(studies: Sequence[Study], runs: int, file: Path) -> None:
    """Draw the studies that execute the policy of the nearest state."""
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(study.scenario for study in studies))
    figure = Figure(figsize=(3.1 * len(names), 3.2), layout="constrained")
    every = figure.subplots(1, len(names), squeeze=False, sharey=True).flat
    for axes, name in zip(every, names, strict=True):
        chosen = [study for study in studies if study.scenario == name and study.execution == Execution()]
        _draw(axes, chosen)
        title(axes, name.replace("_", " "))
    axes = figure.axes[0]
    axes.set_ylabel("predicted - realised (points)")
    handles = axes.get_legend_handles_labels()
    figure.legend(*handles, loc="outside upper left", ncols=len(handles[0]), frameon=False, fontsize=8)
    caption(
        figure,
        f"Predicted less realised success, {runs:,} executions an entry by the policy of the nearest state; bars: 95 % "
        f"intervals. Grey: within {_GOAL:g} points. Above: the table promises too much. Scenarios of our own.",
    )
    save(figure, file)


def _draw(axes: Axes, studies: Sequence[Study]) -> None:
    axes.axhspan(-_GOAL, _GOAL, color=GREY, alpha=0.2, linewidth=0)
    axes.axhline(0, color=GREY, linewidth=0.8)
    for study in studies:
        transition, spacing, times = study.grid.transition, study.grid.spacing_mm[0], study.grid.success_refinement
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
