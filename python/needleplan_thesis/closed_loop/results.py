"""The results as files: a table for people, and every round for programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict

from needleplan.artifacts import version
from needleplan.scenario import Scenario
from needleplan_thesis.closed_loop.loop import Round
from needleplan_thesis.closed_loop.summary import Insertions, Size, Summary, Total, shrink

__all__ = ["json_of", "markdown_of", "percent", "size_text", "times"]

_HEAD = (
    "hidden", "true", "verdicts", "named", "found (median, median 95 % interval)", "asked for", "promised", "before",
    "promised after", "after", "nothing hidden", "gap, shrink", "error before", "after", "nothing hidden", "shrink",
)  # fmt: skip


def markdown_of(scenario: Scenario, summaries: Sequence[Summary], whole: Total, command: str) -> str:
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
    scenario: Scenario, summaries: Sequence[Summary], whole: Total, rounds: Sequence[Round], command: str
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


def _document(each: Summary) -> dict[str, object]:
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


def _row(each: Summary) -> tuple[str, ...]:
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


def _success(each: Insertions) -> str:
    low, high = each.success_interval
    return f"{percent(each.success)} ({100 * low:.0f} to {100 * high:.0f})"


def _shrinks(before: float, after: float, known: float) -> str:
    return f"{times(shrink(before, after))} ({times(shrink(before, after, known))})"


def size_text(size: Size) -> str:
    """Return a parameter with its interval and unit."""
    return f"{size.value:.3g} {size.unit}".rstrip() + f" ({size.low:.3g} to {size.high:.3g})"


def percent(share: float) -> str:
    """Return a share in percent."""
    return f"{100 * share:.1f} %"


def times(share: float | None) -> str:
    """Return a shrink in percent; a dash where there is none to speak of."""
    return "-" if share is None else f"{100 * share:.0f} %"
