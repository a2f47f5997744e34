"""Results of the closed-loop study as files: Markdown table, JSON document, and figure."""

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
    reduction,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw", "in_percent", "json_of", "markdown_of", "parameter_text", "percent"]

_HEAD = (
    "hidden effect", "true parameters", "verdicts", "named", "estimates (medians with 95 % limits)", "next motions",
    "predicted before", "realised before", "predicted after", "realised after", "no hidden effect", "gap, reduction",
    "error before", "error after", "no hidden effect", "error, reduction",
)  # fmt: skip


def markdown_of(scenario: Scenario, summaries: Sequence[EffectSummary], overall: OverallResult, command: str) -> str:
    """Return the Markdown page: a table with a row per hidden effect, totals, and an explanation of the columns."""
    rows = [_HEAD, ("---",) * 6 + ("--:",) * 10, *(_row(summary) for summary in summaries)]
    runs = summaries[0].before.runs
    gap, error = overall.gap, overall.error_mm
    lines = [
        "# The closed loop: plan, insert, diagnose, plan again",
        "",
        f"`{command}`, needleplan {version()}, {scenario.title}: {runs} insertions per hidden effect; up "
        "to five insertions share recordings, a diagnosis and a plan.",
        "",
        *(f"| {' | '.join(row)} |" for row in rows),
        "",
        f"All effects: the gaps between predicted and realised success sum to {gap[0]:.2f} before and {gap[1]:.2f} "
        f"after ({gap[2]:.2f} without a hidden effect), {in_percent(reduction(gap[0], gap[1]))} less, "
        f"{in_percent(reduction(*gap))} of the part above scatter. The median error of all "
        f"insertions goes from {error[0]:.2f} to {error[1]:.2f} mm ({error[2]:.2f} mm), "
        f"{in_percent(reduction(error[0], error[1]))} less, {in_percent(reduction(*error))} of the part above "
        "scatter.",
        "",
        "Before: first plan, which does not know the hidden effect. After: plan with the diagnosed model, in the same "
        "tissue. No hidden effect: first plan in a lab that behaves as planned. Reduction: relative to the whole gap "
        "or error, and in brackets relative to the part above scatter. Success and error are those of the true tip in "
        "3D; no feedback.",
    ]
    return "\n".join(lines) + "\n"


def json_of(
    scenario: Scenario,
    summaries: Sequence[EffectSummary],
    overall: OverallResult,
    rounds: Sequence[Round],
    command: str,
) -> str:
    """Return all results as the text of a JSON document."""
    return json.dumps(
        {
            "schema": "needleplan.closed_loop/1",
            "made_by": f"needleplan {version()}",
            "command": command,
            "scenario": scenario.digest,
            "total": asdict(overall),
            "hidden": [_document(summary) for summary in summaries],
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
        "parameters": {name: asdict(one) for name, one in each.parameters.items()},
        "before": asdict(each.before),
        "after": asdict(each.after),
        "known": asdict(each.known),
        "reduction": {
            "gap": reduction(each.before.gap, each.after.gap),
            "gap_above_scatter": reduction(each.before.gap, each.after.gap, each.known.gap),
            "error": reduction(each.before.error_mm, each.after.error_mm),
            "error_above_scatter": reduction(each.before.error_mm, each.after.error_mm, each.known.error_mm),
        },
    }


def _row(each: EffectSummary) -> tuple[str, ...]:
    before, after, known = each.before, each.after, each.known
    return (
        each.hidden.title, each.hidden.truth, _counts(each.verdicts),
        _counts({" + ".join(names): count for names, count in each.named.items()}),
        "; ".join(parameter_text(name.partition(".")[2], one) for name, one in each.parameters.items()),
        _counts(each.motions), percent(before.predicted), _success(before), percent(after.predicted), _success(after),
        _success(known), _reductions(before.gap, after.gap, known.gap), f"{before.error_mm:.2f} mm",
        f"{after.error_mm:.2f} mm", f"{known.error_mm:.2f} mm",
        _reductions(before.error_mm, after.error_mm, known.error_mm),
    )  # fmt: skip


def _counts(counted: object) -> str:
    assert isinstance(counted, dict)
    return ", ".join(f"{count} {what}" for what, count in counted.items()) or "none"


def _success(each: InsertionStatistics) -> str:
    low, high = each.success_interval
    return f"{percent(each.success)} ({100 * low:.0f} to {100 * high:.0f})"


def _reductions(before: float, after: float, known: float) -> str:
    return f"{in_percent(reduction(before, after))} ({in_percent(reduction(before, after, known))})"


def parameter_text(name: str, each: ParameterMedians) -> str:
    """Return name, value, unit and interval of an estimated parameter as text; `size` is shown as amplitude."""
    called = name.removesuffix("size") + "amplitude" if name.endswith("size") else name
    return f"{called} {each.value:.3g} {each.unit}".rstrip() + f" ({each.low:.3g} to {each.high:.3g})"


def percent(share: float) -> str:
    """Format a share in percent, with one decimal."""
    return f"{100 * share:.1f} %"


def in_percent(share: float | None) -> str:
    """Format a reduction in percent. Returns a dash for None, which means that there was no gap to reduce."""
    return "-" if share is None else f"{100 * share:.0f} %"


# Vertical distance between the three markers of a row, as a fraction of the row height.
_APART = 0.24


def draw(summaries: Sequence[EffectSummary], rounds: Sequence[Round], file: Path) -> None:
    """Draw a row per hidden effect: predicted and realised success, and the errors of all insertions."""
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
    left.set_yticks(range(len(summaries)), [summary.hidden.name.replace("_", " ") for summary in summaries])
    left.invert_yaxis()
    left.set_xlim(-3, 103)
    left.set_xlabel("success (%)")
    right.set_xlabel("distance from the centre of the target (mm)")
    right.set_xlim(left=0)
    title(left, "success: predicted (line), realised (dot)")
    title(right, "error: each insertion (dot), median (line)")
    handles = [
        left.plot([], [], "o", color=colour, markersize=5, label=label)[0]
        for colour, label in ((VERMILLION, "before"), (BLUE, "with the diagnosed model"), (GREY, "no hidden effect"))
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=3, frameon=False, fontsize=8)
    caption(
        figure,
        f"Insertions in lab twins with a hidden effect, {summaries[0].before.runs} per row, without feedback. Bars: "
        "95 % intervals of the realised success.",
    )
    save(figure, file)


def _draw_success(axes: Axes, each: InsertionStatistics, at: float, colour: str) -> None:
    low, high = each.success_interval
    axes.plot([100 * low, 100 * high], [at, at], color=colour, linewidth=1.0)
    axes.plot(100 * each.success, at, "o", color=colour, markersize=4.5)
    axes.plot([100 * each.predicted] * 2, [at - 0.11, at + 0.11], color=colour, linewidth=2.0)


def _draw_errors(axes: Axes, errors: Sequence[float], at: float, colour: str) -> None:
    axes.plot(errors, np.full(len(errors), at), "o", color=colour, markersize=3, alpha=0.3, markeredgewidth=0)
    axes.plot([np.median(errors)] * 2, [at - 0.11, at + 0.11], color=colour, linewidth=2.0)
