"""Success and error before and after, effect by effect."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needleplan.plotting import caption, save
from needleplan.plotting.canvas import BLUE, GREY, VERMILLION, title
from needleplan_thesis.closed_loop.loop import Round
from needleplan_thesis.closed_loop.summary import Insertions, Summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw"]

_APART = 0.24


def draw(summaries: Sequence[Summary], rounds: Sequence[Round], file: Path) -> None:
    """Draw a row for every hidden effect: success promised and realised, and the errors of all insertions."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 1.3 + 0.62 * len(summaries)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for row, each in enumerate(summaries):
        own = [one for one in rounds if one.hidden == each.hidden.name]
        rows = (
            (each.before, [a.error_mm for one in own for a in one.before], VERMILLION, -_APART),
            (each.after, [a.error_mm for one in own for a in one.after], BLUE, 0.0),
            (each.known, [a.error_mm for one in own for a in one.known], GREY, _APART),
        )
        for insertions, errors, colour, shift in rows:
            _success(left, insertions, row + shift, colour)
            _errors(right, errors, row + shift, colour)
    left.set_yticks(range(len(summaries)), [each.hidden.name.replace("_", " ") for each in summaries])
    left.invert_yaxis()
    left.set_xlim(-3, 103)
    left.set_xlabel("success (%)")
    right.set_xlabel("distance from the centre of the target (mm)")
    right.set_xlim(left=0)
    title(left, "promised (line) and realised (dot)")
    title(right, "every insertion, and the median")
    handles = [
        left.plot([], [], "o", color=colour, markersize=5, label=label)[0]
        for colour, label in ((VERMILLION, "before"), (BLUE, "by the diagnosed model"), (GREY, "nothing hidden"))
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=3, frameon=False, fontsize=8)
    caption(
        figure,
        f"Insertions in lab twins that hide something, {summaries[0].before.runs} for each, without feedback. Bars: "
        "95 % intervals of the realised success.",
    )
    save(figure, file)


def _success(axes: Axes, each: Insertions, at: float, colour: str) -> None:
    low, high = each.success_interval
    axes.plot([100 * low, 100 * high], [at, at], color=colour, linewidth=1.0)
    axes.plot(100 * each.success, at, "o", color=colour, markersize=4.5)
    axes.plot([100 * each.promised] * 2, [at - 0.11, at + 0.11], color=colour, linewidth=2.0)


def _errors(axes: Axes, errors: Sequence[float], at: float, colour: str) -> None:
    axes.plot(errors, np.full(len(errors), at), "o", color=colour, markersize=3, alpha=0.3, markeredgewidth=0)
    axes.plot([np.median(errors)] * 2, [at - 0.11, at + 0.11], color=colour, linewidth=2.0)
