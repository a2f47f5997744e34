"""Table of the outcomes of the diagnosis: asked figures, counts and Clopper-Pearson bounds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from diagnosis_score import rate

Line = dict[str, Any]
Lines = Sequence[Line]

# Noncentrality from which a single effect, and both effects of a pair, should be named.
SINGLE, PAIR = 70.0, 100.0
# Asked rate of right names for single effects, by heterogeneity.
_ASKED_SINGLE = {0.0: ">= 92 %", 0.03: ">= 90 %", 0.1: ">= 85 %"}
# Posterior probabilities of the row of calibration.
_CALIBRATED = (0.90, 0.95)
# Motions with several speeds, dwells and reversals.
_RICH = "rich"


def page(lines: Lines, generator: str, seed: int) -> str:
    """Return the table as Markdown."""
    failed = [line for line in lines if line["failure"]]
    good = [line for line in lines if not line["failure"]]
    text = [
        f"# Diagnosis of the {generator} generator",
        "",
        f"{len(lines)} data sets, seed {seed}; {len(failed)} failures. Brackets: 95 % Clopper-Pearson bounds.",
        "",
        "| row | asked | measured |",
        "|---|---|---|",
    ]
    text += [f"| {name} | {asked} | {value} |" for name, asked, value in rows(good)]
    text += ["", "False or wrong names, hidden effects and the answer:", ""]
    text += [f"- {count} x {what}" for what, count in _confusions(good).most_common(40)]
    text += [f"- failure of {line['key']}: {line['failure']}" for line in failed]
    return "\n".join(text) + "\n"


def rows(lines: Lines) -> list[tuple[str, str, str]]:
    """Return name, asked figure and measured figure of each row."""
    found: list[tuple[str, str, str]] = []

    def add(name: str, asked: str, kept: Lines, true: Callable[[Line], bool]) -> None:
        found.append((name, asked, share([true(line) for line in kept])))

    nulls = _pick(lines, "null")
    for motion in sorted({line["motion"] for line in nulls}):
        add(f"nothing hidden, {motion}: false names", "<= 0.3 %", [n for n in nulls if n["motion"] == motion], _named)
    singles = [line for line in _pick(lines, "single") if _least(line) >= SINGLE]
    rich = [line for line in singles if line["motion"] == _RICH]
    for level, asked in _ASKED_SINGLE.items():
        kept = [line for line in rich if line["heterogeneity"] == level]
        add(f"single, noncentrality >= {SINGLE:g}, rich, {level:.0%}: right", asked, kept, right)
    add("the same, all heterogeneities: right", "", rich, right)
    add("the same, all heterogeneities: wrong", "<= 2 %", rich, wrong)
    add("single, other motions: right", "", [line for line in singles if line["motion"] != _RICH], right)
    add("single, other motions: wrong", "", [line for line in singles if line["motion"] != _RICH], wrong)
    add("the same: family of the answer AMBIGUOUS holds it", "", rich, _in_family)
    weak = [line for line in _pick(lines, "single") if _least(line) < SINGLE]
    add(f"single, noncentrality < {SINGLE:g}: right", "", weak, right)
    add(f"single, noncentrality < {SINGLE:g}: wrong", "<= 2 %", weak, wrong)
    pairs = _pick(lines, "pair")
    strong = [line for line in pairs if _least(line) >= PAIR]
    add(f"pairs, both >= {PAIR:g}: exact", ">= 85 %", strong, right)
    add(f"pairs, both >= {PAIR:g}: strongest", ">= 97 %", strong, strongest)
    add(f"pairs, both >= {PAIR:g}: a false one", "<= 3 %", strong, wrong)
    add("other pairs: exact", "", [line for line in pairs if _least(line) < PAIR], right)
    add("other pairs: a false one", "", [line for line in pairs if _least(line) < PAIR], wrong)
    outside = [line for line in _pick(lines, "outside") if _least(line) >= 30]
    add("outside the library, noncentrality >= 30: declined", ">= 93 %", outside, lambda line: not _named(line))
    unknown = [line for line in outside if line["verdict"] == "unknown"]
    add("outside, unknown: right axis", ">= 80 %", unknown, lambda line: line["axis"] in line["axes"])
    add("absorbed: named", "0", _pick(lines, "absorbed"), _named)
    low, high = _CALIBRATED
    said = [line for line in lines if line.get("probability") and line["verdict"] in ("named", "unknown")]
    sure = [line for line in said if low <= line["probability"] <= high]
    add("answers with posterior 0.90 to 0.95: right", "88 to 97 %", sure, answered)
    surer = [line for line in said if line["probability"] > high]
    add("answers with posterior > 0.95: right", "", surer, answered)
    found.append(("95 % intervals hold the truth", "92 to 98 %", share(covered(lines))))
    shrinks = [line["shrink"] for line in lines if right(line) and line["truth"] and _finite(line.get("shrink"))]
    if shrinks:
        half, tenth = np.quantile(shrinks, (0.5, 0.1))
        value = f"{half:.2f}; {tenth:.2f} (of {len(shrinks)})"
        found.append(("held-out shrink: median; lowest tenth", ">= 0.92; >= 0.7", value))
    if lines:
        half, most = np.quantile([line["cpu_s"] for line in lines], (0.5, 0.95))
        found.append(("processor time: median; 95 %", "<= 1 s; <= 4 s", f"{half:.2f} s; {most:.1f} s"))
    return found


def right(line: Line) -> bool:
    """Whether the verdict is NAMED and its names are exactly the hidden effects."""
    return line["verdict"] == "named" and set(line["names"]) == _hidden(line)


def wrong(line: Line) -> bool:
    """Whether an effect is named that was not hidden."""
    return bool(set(line["names"]) - _hidden(line))


def _in_family(line: Line) -> bool:
    """Whether no effect is named, but the hidden one is in the family of which one effect is said to be missing."""
    return not line["names"] and bool(_hidden(line) & set(line.get("family", ())))


def strongest(line: Line) -> bool:
    """Whether the hidden effect with the largest noncentrality is named."""
    return max(line["truth"], key=lambda each: each["noncentrality"])["name"] in line["names"]


def answered(line: Line) -> bool:
    """Whether all named effects are hidden; for an answer without names, whether no effect of the library is hidden.

    This is what the probability of the answers NAMED and UNKNOWN refers to.
    """
    if line["names"]:
        return set(line["names"]) <= _hidden(line)
    return line["stratum"] in ("outside", "absorbed")


def covered(lines: Lines) -> list[bool]:
    """Return for each comparable parameter of a correctly named set whether its interval holds the truth."""
    found = []
    for line in filter(right, lines):
        for each in line["truth"]:
            for name, value in each["parameters"].items():
                if name in line["estimates"].get(each["name"], {}):
                    _, low, high = line["estimates"][each["name"]][name]
                    found.append(bool(low <= value <= high))
    return found


def one_line(line: Line) -> str:
    """Return an outcome as one line of text."""
    truth = ", ".join(f"{each['name']} {each['noncentrality']:.0f}" for each in line["truth"]) or "nothing"
    if line["failure"]:
        return f"{line['key']} {line['stratum']} {truth}: FAILURE {line['failure']}"
    mark = "ok" if _good(line) else "WRONG" if wrong(line) else "--"
    about = "+".join(line["names"]) or line["axis"] or ""
    sure = "" if line.get("probability") is None else f"{line['probability']:.2f}"
    return (
        f"{mark:5} {line['key']} {line['motion']} {line['rate_hz']} {line['heterogeneity']:.0%} [{truth}] "
        f"{line['verdict']} {about} {sure} {line.get('note', '')} {line['cpu_s']:.1f}s"
    )


def _good(line: Line) -> bool:
    if line["stratum"] in ("null", "absorbed"):
        return not _named(line)
    return not _named(line) if line["stratum"] == "outside" else right(line)


def _named(line: Line) -> bool:
    return bool(line["names"])


def _hidden(line: Line) -> set[str]:
    return {each["name"] for each in line["truth"]}


def _least(line: Line) -> float:
    return min((float(each["noncentrality"]) for each in line["truth"]), default=0.0)


def _pick(lines: Lines, stratum: str) -> list[Line]:
    return [line for line in lines if line["stratum"] == stratum]


def share(each: Sequence[bool]) -> str:
    found = rate(sum(each), len(each))
    if not found["of"]:
        return "none"
    low, value, high = (float(found[key] or 0.0) for key in ("low", "rate", "high"))
    return f"{found['hits']} of {found['of']}, {value:.0%} ({low:.0%} to {high:.0%})"


def _finite(value: float | None) -> bool:
    return value is not None and bool(np.isfinite(value))


def _confusions(lines: Lines) -> Counter[str]:
    counts: Counter[str] = Counter()
    for line in lines:
        if wrong(line):
            counts[f"{line['stratum']} {' + '.join(sorted(_hidden(line))) or '-'}: {' + '.join(line['names'])}"] += 1
    return counts
