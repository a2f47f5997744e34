"""The results as files: a table for people, and every round for programs.

Success and error before and after, effect by effect.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needleplan.artifacts import version
from needleplan.plotting import caption, save
from needleplan.plotting.canvas import BLUE, GREY, VERMILLION, title
from needleplan.scenario import Scenario
from needleplan_thesis.closed_loop.loop import Round
from needleplan_thesis.closed_loop.summary import (
    EffectSummary,
    InsertionStatistics,
    OverallResult,
    ParameterMedians,
    shrink,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw", "json_of", "markdown_of", "percent", "size_text", "times"]

_HEAD = (
    "hidden", "true", "verdicts", "named", "found (median, median 95 % interval)", "asked for", "promised", "before",
    "promised after", "after", "nothing hidden", "gap, shrink", "error before", "after", "nothing hidden", "shrink",
)  # fmt: skip


def markdown_of(scenario: Scenario, summaries: Sequence[EffectSummary], whole: OverallResult, command: str) -> str:
    """Return the table, and what its columns mean."""
    rows = [_HEAD, ("---",) * 6 + ("--:",) * 10, *(_row(each) for each in summaries)]
    runs = summaries[0].before.runs
    gap, error = whole.gap, whole.error_mm
    lines = [
        "# To the planner and back",
        "",
        f"`{command}`, needleplan {version()}, {scenario.title}: {runs} insertions for each hidden effect, of which "
        "five share recordings, a diagnosis and a plan.",
        "",
        *(f"| {' | '.join(each)} |" for each in rows),
        "",
        f"Together: the gaps between promised and realised success sum to {gap[0]:.2f} before and {gap[1]:.2f} after "
        f"({gap[2]:.2f} where nothing is hidden), {times(shrink(gap[0], gap[1]))} less, "
        f"{times(shrink(*gap))} above what scatter leaves. The median error of all "
        f"insertions goes from {error[0]:.2f} to {error[1]:.2f} mm ({error[2]:.2f} mm), "
        f"{times(shrink(error[0], error[1]))} less, {times(shrink(*error))} above scatter.",
        "",
        "Before: by the plan that does not know. After: by the plan made from the diagnosed model, in the same tissue. "
        "Nothing hidden: by the first plan in a lab as it thinks. Shrink: of the whole, and in brackets above what is "
        "left where nothing is hidden. Success and error are those of the true tip in space; no feedback.",
    ]
    return "\n".join(lines) + "\n"


def json_of(
    scenario: Scenario, summaries: Sequence[EffectSummary], whole: OverallResult, rounds: Sequence[Round], command: str
) -> str:
    """Return everything as JSON."""
    return json.dumps(
        {
            "schema": "needleplan.circle/1",
            "made_by": f"needleplan {version()}",
            "command": command,
            "scenario": scenario.digest,
            "total": asdict(whole),
            "hidden": [_document(each) for each in summaries],
            "rounds": [asdict(each) for each in rounds],
        },
        indent=1,
    ) + "\n"  # fmt: skip


def _document(each: EffectSummary) -> dict[str, object]:
    return {
        "name": each.hidden.name,
        "title": each.hidden.title,
        "true": each.hidden.truth,
        "verdicts": each.verdicts,
        "named": {" + ".join(names): count for names, count in each.named.items()},
        "motions": each.motions,
        "sizes": {name: asdict(size) for name, size in each.sizes.items()},
        "before": asdict(each.before),
        "after": asdict(each.after),
        "known": asdict(each.known),
        "shrink": {
            "gap": shrink(each.before.gap, each.after.gap),
            "gap_above_scatter": shrink(each.before.gap, each.after.gap, each.known.gap),
            "error": shrink(each.before.error_mm, each.after.error_mm),
            "error_above_scatter": shrink(each.before.error_mm, each.after.error_mm, each.known.error_mm),
        },
    }


def _row(each: EffectSummary) -> tuple[str, ...]:
    before, after, known = each.before, each.after, each.known
    return (
        each.hidden.title, each.hidden.truth, _counts(each.verdicts),
        _counts({" + ".join(names): count for names, count in each.named.items()}),
        "; ".join(f"{name.partition('.')[2]} {size_text(size)}" for name, size in each.sizes.items()),
        _counts(each.motions), percent(before.promised), _success(before), percent(after.promised), _success(after),
        _success(known), _shrinks(before.gap, after.gap, known.gap), f"{before.error_mm:.2f} mm",
        f"{after.error_mm:.2f} mm", f"{known.error_mm:.2f} mm",
        _shrinks(before.error_mm, after.error_mm, known.error_mm),
    )  # fmt: skip


def _counts(counted: object) -> str:
    assert isinstance(counted, dict)
    return ", ".join(f"{count} {what}" for what, count in counted.items()) or "none"


def _success(each: InsertionStatistics) -> str:
    low, high = each.success_interval
    return f"{percent(each.success)} ({100 * low:.0f} to {100 * high:.0f})"


def _shrinks(before: float, after: float, known: float) -> str:
    return f"{times(shrink(before, after))} ({times(shrink(before, after, known))})"


def size_text(size: ParameterMedians) -> str:
    """Return a parameter with its interval and unit."""
    return f"{size.value:.3g} {size.unit}".rstrip() + f" ({size.low:.3g} to {size.high:.3g})"


def percent(share: float) -> str:
    """Return a share in percent."""
    return f"{100 * share:.1f} %"


def times(share: float | None) -> str:
    """Return a shrink in percent; a dash where there is none to speak of."""
    return "-" if share is None else f"{100 * share:.0f} %"


_APART = 0.24


def draw(summaries: Sequence[EffectSummary], rounds: Sequence[Round], file: Path) -> None:
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
            _draw_success(left, insertions, row + shift, colour)
            _draw_errors(right, errors, row + shift, colour)
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


def _draw_success(axes: Axes, each: InsertionStatistics, at: float, colour: str) -> None:
    low, high = each.success_interval
    axes.plot([100 * low, 100 * high], [at, at], color=colour, linewidth=1.0)
    axes.plot(100 * each.success, at, "o", color=colour, markersize=4.5)
    axes.plot([100 * each.promised] * 2, [at - 0.11, at + 0.11], color=colour, linewidth=2.0)


def _draw_errors(axes: Axes, errors: Sequence[float], at: float, colour: str) -> None:
    axes.plot(errors, np.full(len(errors), at), "o", color=colour, markersize=3, alpha=0.3, markeredgewidth=0)
    axes.plot([np.median(errors)] * 2, [at - 0.11, at + 0.11], color=colour, linewidth=2.0)
