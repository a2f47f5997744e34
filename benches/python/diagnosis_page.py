"""The report of the diagnosis benchmark: Markdown page and figures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from diagnosis_goals import ENOUGH, Goal
from matplotlib import pyplot as plt

COLOURS = ("#0b5394", "#38761d", "#b45f06")


def page(report: Mapping[str, Any], goals: list[Goal], figures: str) -> str:
    """Return the report as Markdown; `figures` is the common beginning of the file names of the figures."""
    return "\n".join(
        [*_head(report), *_goals(goals), *_tables(report["summary"], report["run"]["large"]), *_pictures(figures), ""]
    )


def _head(report: Mapping[str, Any]) -> Iterator[str]:
    run, machine = report["run"], report["machine"]
    channel = "path of the tip" if run["channel"] == "tip" else "axial force"
    yield f"# Diagnosis: benchmark on blind data, {channel}"
    yield ""
    yield (f"{run['done']} of {run['wanted']} data sets, seeds for {run['purpose']}, engine {run['engine']}, "
           f"commit {machine['commit']}, {machine['date']}, {machine['processor']}.")  # fmt: skip
    if run["done"] < run["wanted"]:
        yield "**A part of the run:** the data sets were taken in an order that mixes all strata."
    if run["purpose"] == "tuning":
        yield "**Seeds for tuning:** thresholds may have been chosen by these; they are no evidence."
    yield ""


def _goals(goals: list[Goal]) -> Iterator[str]:
    yield "| goal | | measured (95 % bounds) | of | reached |"
    yield "|---|---|---|---|---|"
    for each in goals:
        verdict = {True: "yes", False: "**no**", None: "-"}[each.reached]
        if each.reached is not None and each.of < ENOUGH and "prepare" not in each.what:
            verdict += ", of too few to tell"
        yield f"| {each.what} | {each.goal} | {each.measured} | {each.of} | {verdict} |"
    yield ""


def _tables(found: Mapping[str, Any], large: float) -> Iterator[str]:
    yield "## Nothing hidden"
    yield ""
    yield "| motion, heterogeneity | falsely named | any flag | names |"
    yield "|---|---|---|---|"
    for name, each in found["null"].items():
        names = ", ".join(f"{effect} {count}" for effect, count in each["names"].items()) or "-"
        yield f"| {name} | {_rate(each['falsely_named'])} | {_rate(each['flagged'])} | {names} |"
    yield ""
    yield f"## One effect, from {large:g} times the noise"
    yield ""
    yield "| motion, heterogeneity | right | right where the base leaves a noncentrality of 100 | wrong | verdicts | precision of a name, all sizes |"  # noqa: E501
    yield "|---|---|---|---|---|---|"
    for name, each in found["single"].items():
        verdicts = ", ".join(f"{verdict} {count}" for verdict, count in each["verdicts"].items())
        yield (f"| {name} | {_rate(each['right'])} | {_rate(each['right_where_left'])} | {_rate(each['wrong'])} | "
               f"{verdicts} | {_rate(each['precision'])} |")  # fmt: skip
    yield ""
    yield "| effect | right, rich | wrong, rich | right, poor | wrong, poor |"
    yield "|---|---|---|---|---|"
    for name, each in found["by_effect"].items():
        cells = (_rate(each[variety][what]) for variety in ("rich", "poor") for what in ("right", "wrong"))
        yield f"| {name} | " + " | ".join(cells) + " |"
    yield ""
    yield "## Two effects, outside of the library, taken up by the base"
    yield ""
    yield "| two effects, heterogeneity | exact set | exact where the base leaves a noncentrality of 100 of both | strongest named | false extra | verdicts |"  # noqa: E501
    yield "|---|---|---|---|---|---|"
    for name, each in found["pair"].items():
        verdicts = ", ".join(f"{verdict} {count}" for verdict, count in each["verdicts"].items())
        yield (f"| {name} | {_rate(each['exact'])} | {_rate(each['exact_where_left'])} | {_rate(each['strongest'])} | "
               f"{_rate(each['false_extra'])} | {verdicts} |")  # fmt: skip
    yield ""
    yield "| outside the library | not falsely named | right axis of those unknown | verdicts | names given |"
    yield "|---|---|---|---|---|"
    for name, each in found["outside"].items():
        verdicts = ", ".join(f"{verdict} {count}" for verdict, count in each["verdicts"].items())
        names = ", ".join(f"{effect} {count}" for effect, count in each["names"].items()) or "-"
        yield f"| {name} | {_rate(each['declined'])} | {_rate(each['right_axis'])} | {verdicts} | {names} |"
    yield ""
    if found["absorbed"]["of"]:
        yield f"Gain errors, which friction and cutting take up: falsely named {_rate(found['absorbed'])}."
        yield ""
    yield "## Sizes, places, time"
    yield ""
    yield "| 95 % intervals, heterogeneity | parameters | RMS of the contribution |"
    yield "|---|---|---|"
    for level, each in found["coverage"].items():
        yield f"| {level} | {_rate(each['parameters'])} | {_rate(each['contribution'])} |"
    yield ""
    yield "| | of | 10 % | median | 90 % | most |"
    yield "|---|---|---|---|---|---|"
    rows = {f"error of depth in mm, {name}": each for name, each in found["depth_mm"].items()}
    rows |= {f"seconds, {name}": each for name, each in found["seconds"].items()}
    rows |= {f"held-out gap closed, {name}": each["shrink"] for name, each in found["single"].items()}
    for name, each in rows.items():
        yield f"| {name} | {each['of']} | " + " | ".join(
            _number(each[key]) for key in ("q10", "median", "q90", "most")) + " |"  # fmt: skip
    yield ""
    if found["peers"]:
        yield "## Peers on the same data"
        yield ""
        groups = list(next(iter(found["peers"].values())))
        yield "| | " + " | ".join(f"{group}: exact set | names" for group in groups) + " |"
        yield "|---" * (1 + 2 * len(groups)) + "|"
        for who, each in found["peers"].items():
            cells = (f"{_rate(one['exact'])} | {_number(one['names'])}" for one in each.values())
            yield f"| {who} | " + " | ".join(cells) + " |"
        yield ""
    yield "## Confusion"
    yield ""
    yield f"Hidden in the rows, {large:g} times the noise and more; verdicts without a name in capitals."
    yield ""
    for what, each in found["confusion"].items():
        row = ", ".join(f"{answer} {count}" for answer, count in sorted(each.items(), key=lambda pair: -pair[1]))
        yield f"- {what}: {row}"
    for each in found["failures"]:
        yield f"- seed {each['seed']} failed: {each['failure']}"
    yield ""


def _pictures(figures: str) -> Iterator[str]:
    yield f"![Share named and right against size and against noncentrality]({figures}_power.png)"
    yield ""
    yield f"![What was said about what]({figures}_confusion.png)"


def _rate(each: Mapping[str, Any]) -> str:
    if each["rate"] is None:
        return "-"
    return f"{each['hits']}/{each['of']} = {each['rate']:.1%} ({each['low']:.1%} to {each['high']:.1%})"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def draw(found: Mapping[str, Any], prefix: Path) -> None:
    """Write PREFIX_power.png (power curves) and PREFIX_confusion.png (confusion matrix)."""
    mpl.use("Agg")
    _draw_power(found, prefix.with_name(f"{prefix.name}_power.png"))
    _draw_confusion(found["confusion"], prefix.with_name(f"{prefix.name}_confusion.png"))


def _draw_power(found: Mapping[str, Any], path: Path) -> None:
    figure, axes = plt.subplots(2, 2, figsize=(10, 6.4), sharey=True, constrained_layout=True)
    for row, variety in zip(axes, ("rich", "poor"), strict=True):
        for ax, (by, label) in zip(row, (("size", "size, multiple of the noise"), ("noncentrality", "noncentrality")),
                                   strict=True):  # fmt: skip
            for colour, level in zip(COLOURS, ("0", "0.03", "0.1"), strict=True):
                bins = [each for each in found["power"][by][f"{variety} {level}"] if each["right"]["of"]]
                if not bins:
                    continue
                # A bin with an open (or very distant) end is drawn at a factor of two from its other end.
                at = [np.sqrt((each["from"] or each["to"] / 4) * min(each["to"], 4 * (each["from"] or each["to"])))
                      for each in bins]  # fmt: skip
                rates = np.array([each["right"]["rate"] for each in bins])
                low = rates - [each["right"]["low"] for each in bins]
                high = np.array([each["right"]["high"] for each in bins]) - rates
                ax.errorbar(at, rates, [low, high], marker="o", color=colour, capsize=2, lw=1.2, ms=4,
                            label=f"{100 * float(level):g} % heterogeneity")  # fmt: skip
            ax.set(xscale="log", xlabel=label, title=f"{variety} motion", ylim=(-0.03, 1.03))
            ax.grid(alpha=0.3)
        row[0].set_ylabel("share named and right")
    if axes[0, 0].containers:
        axes[0, 0].legend(fontsize=8)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def _draw_confusion(counts: Mapping[str, Mapping[str, int]], path: Path) -> None:
    answers = sorted({answer for each in counts.values() for answer in each}, key=lambda each: (each.isupper(), each))
    rows = [each for each in answers if each in counts] + [each for each in counts if each not in answers]
    if not rows:
        return
    shares = np.array([[counts[what].get(answer, 0) / sum(counts[what].values()) for answer in answers]
                       for what in rows])  # fmt: skip
    figure, ax = plt.subplots(
        figsize=(max(1.8 + 0.42 * len(answers), 6.0), 2.2 + 0.3 * len(rows)), constrained_layout=True
    )
    ax.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for i, what in enumerate(rows):
        for j, answer in enumerate(answers):
            if number := counts[what].get(answer, 0):
                colour = "white" if shares[i, j] > 0.5 else "black"
                ax.text(j, i, str(number), ha="center", va="center", fontsize=7, color=colour)
    ax.set_xticks(range(len(answers)), answers, rotation=60, ha="right", fontsize=7)
    ax.set_yticks(range(len(rows)), rows, fontsize=7)
    ax.set(xlabel="what was said (verdicts without a name in capitals)", ylabel="what was hidden")
    figure.savefig(path, dpi=130)
    plt.close(figure)
