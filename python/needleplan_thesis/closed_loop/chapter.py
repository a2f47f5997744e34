"""Entry point of `needleplan reproduce diagnosis`: the benefit of a diagnosis for the next plan, by hidden effect."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING

from needleplan.artifacts import write_whole
from needleplan.reports.chapters import Effort
from needleplan.reports.comparison import Agreement, Comparison, Evidence
from needleplan.scenario import Scenario
from needleplan_thesis.closed_loop.hidden import HIDDEN
from needleplan_thesis.closed_loop.loop import run_rounds
from needleplan_thesis.closed_loop.results import draw, json_of, markdown_of, parameter_text, percent
from needleplan_thesis.closed_loop.summary import EffectSummary, OverallResult, reduction, summarized, total

if TYPE_CHECKING:
    from needleplan.reports.chapters import Request

__all__ = ["closed_loop_scenario", "files", "run"]

# Insertions per hidden effect: default and full effort, and quick effort.
_SEEDS, _FEW = 40, 1

# Goal: relative reduction of the gap of success and of the median error by the diagnosis.
_GOAL = 0.6

# Curvature radius of the needle (mm), number of headings of the plan, and radius of the target (mm).
_RADIUS_MM, _HEADINGS = 100.0, 150
_TARGET_MM = 1.5
# Tested points of every arc in the published figures.
_ARC_SAMPLES = 4


def closed_loop_scenario() -> Scenario:
    """Return the shipped prostate with a stiffer needle and a smaller target.

    The heading in the labs has almost no random drift, so the plan has no tip noise and predicts a success near 1.
    """
    scenario = Scenario.read("prostate").with_curvature(1 / _RADIUS_MM).with_tip_noise((1.0,))
    return replace(
        scenario, target=replace(scenario.target, radius_mm=_TARGET_MM),
        motion=replace(scenario.motion, headings=_HEADINGS, arc_samples=_ARC_SAMPLES),
    )  # fmt: skip


def files(_: Request) -> tuple[str, ...]:
    """Return the names of the files that `run` writes into the output folder."""
    return ("diagnosis.md", "diagnosis.json", "diagnosis.png")


def run(request: Request) -> list[Comparison]:
    """Run all rounds and return the comparisons; write diagnosis.md, .json and .png if the request names a folder."""
    quick = request.effort is Effort.QUICK
    seeds = range(request.runs or (_FEW if quick else _SEEDS))
    chosen = HIDDEN[:1] if quick else HIDDEN
    scenario, rounds = closed_loop_scenario(), []
    request.note(f"diagnosis: {len(chosen)} hidden effects, {len(seeds)} insertions each")
    for run_round in run_rounds(scenario, chosen, seeds, 1 if quick else os.cpu_count() or 1):
        rounds.append(run_round)
        names = " + ".join(one.name for one in run_round.named) or run_round.verdicts[-1]
        request.note(
            f"diagnosis: {run_round.hidden}, insertions {run_round.seeds[0]} to {run_round.seeds[-1]}: {names}"
        )
    summaries = [summarized(each, [one for one in rounds if one.hidden == each.name]) for each in chosen]
    overall = total(summaries, rounds)
    if request.folder:
        command = f"needleplan reproduce diagnosis --runs {len(seeds)}" + " --quick" * quick
        write_whole(request.folder / "diagnosis.md", markdown_of(scenario, summaries, overall, command).encode())
        write_whole(request.folder / "diagnosis.json", json_of(scenario, summaries, overall, rounds, command).encode())
        draw(summaries, rounds, request.folder / "diagnosis.png")
    return [
        *(row for summary in summaries for row in _compared(summary)),
        *_together(overall, summaries[0].before.runs),
    ]


def _compared(each: EffectSummary) -> list[Comparison]:
    name, before, after, known = f"diagnosis/{each.hidden.name}", each.before, each.after, each.known
    named = ", ".join(f"{count} {' + '.join(names)}" for names, count in each.named.items()) or "nothing"
    verdicts = ", ".join(f"{count} {verdict}" for verdict, count in each.verdicts.items())
    motions = f"next motions: {sum(each.motions.values())}"
    details = "; ".join([verdicts, motions, *(parameter_text(key, one) for key, one in each.parameters.items())])
    return [
        Comparison(
            f"{name}/hidden", None, each.hidden.title, "", Agreement.OURS, each.hidden.truth, kind=Evidence.COMPUTED,
        ),
        Comparison(f"{name}/named", None, named, "", Agreement.OURS, details, kind=Evidence.COMPUTED),
        Comparison(
            f"{name}/success", None,
            f"predicted {percent(before.predicted)}, realised {percent(before.success)}; with the diagnosed model "
            f"predicted {percent(after.predicted)}, realised {percent(after.success)}", "", Agreement.OURS,
            f"without a hidden effect, realised {percent(known.success)}; {before.runs} insertions each",
            kind=Evidence.COMPUTED,
        ),
        _goal(f"{name}/gap of success, shrink", before.gap, after.gap, known.gap, "points"),
        _goal(f"{name}/median error, shrink", before.error_mm, after.error_mm, known.error_mm, "mm"),
    ]  # fmt: skip


def _together(overall: OverallResult, runs: int) -> list[Comparison]:
    return [
        _goal(
            "diagnosis/together/gap of success, shrink",
            *overall.gap,
            "points",
            f"sum over effects, {runs} insertions each",
        ),
        _goal("diagnosis/together/median error, shrink", *overall.error_mm, "mm", "of all insertions"),
    ]


def _goal(name: str, before: float, after: float, known: float, unit: str, about: str = "") -> Comparison:
    scale, digits = (100, 1) if unit == "points" else (1, 2)
    text = " -> ".join(f"{scale * each:.{digits}f}" for each in (before, after))
    text += f" {unit}; {scale * known:.{digits}f} without a hidden effect"
    share, above = reduction(before, after), reduction(before, after, known)
    if above is not None:
        text += f"; {100 * above:.0f} % of the part above that"
    if share is None:
        return Comparison(
            name, None, None, "", Agreement.OURS, f"{text}; there is no gap to reduce", kind=Evidence.COMPUTED
        )
    verdict = Agreement.MET if share >= _GOAL else Agreement.MISSED
    reason = "; ".join(part for part in (text, about, f"goal: {_GOAL:g}") if part)
    return Comparison(name, None, round(share, 3), "", verdict, reason, kind=Evidence.COMPUTED)
