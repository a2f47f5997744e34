"""How often the diagnosis answers rightly, on data sets that no state of it has seen: one table for one engine.

PYTHONPATH=.:python python benches/python/diagnosis_evidence.py --out build/evidence.jsonl
PYTHONPATH=.:python python benches/python/diagnosis_evidence.py --out build/evidence.jsonl --references 3
PYTHONPATH=.:python python benches/python/diagnosis_evidence.py --out build/evidence.jsonl --report

The seeds stand below, and were fixed before the first run. Strata alternate, so that an interrupted run has all of
them; a repeated command continues the file. The data are those of the second generator; its
seeds 1571 to 2281 decided on mechanisms, those below on none:

null, single, pair, outside
    No, one or two effects of the library, or one that it lacks. Effects have 0.5 to 50 noise RMS (log-uniform) in rich
    motions; nulls have all kinds of motion.
parameter
    A null whose given model has half or twice one of its four parameters.
law
    A null of the third generator whose base has other laws than the model's.

With `--references`, data sets without an effect, or with effects of the library, are diagnosed again, with as many
further trials of other tissue and another motion in which the effects are absent.
"""

import argparse
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import diagnosis_engines_case as cases
import machine
import numpy as np
import second_generator_sets as second
from diagnosis_counts import covered, engine_digest, right, share, wrong

# Seeds of the two generators, which no earlier count has used.
SECOND, THIRD = 2371, 2381
# Strata in the order in which they are drawn, again and again.
CYCLE = (
    "null", "single", "outside", "null", "single", "pair", "parameter", "null", "single", "outside",
    "null", "single", "law", "null", "single", "pair", "parameter", "null", "single", "outside",
)  # fmt: skip
# Given values of a parameter, as multiples of the true ones.
CHANGES = tuple(
    (name, factor) for factor in (2.0, 0.5) for name in ("friction", "cutting", "onset_mm", "presliding_mm")
)
# Noise RMS of an effect that should be named.
STRONG = 2.0

Line = dict[str, Any]


def drawn(cycles: int, references: int) -> Iterator[cases.EngineCase]:
    """Yield the data sets of some cycles of the strata."""
    counts: Counter[str] = Counter()
    kinds = {"null": "none", "parameter": "none"}
    wishes = {
        stratum: second.wishes(
            SECOND + place, cycles * CYCLE.count(stratum), kinds.get(stratum, stratum), None, None,
            None if stratum == "null" else "rich", "rms",
        )
        for place, stratum in enumerate(("null", "single", "pair", "outside", "parameter"))
    }  # fmt: skip
    others = cases.nulls_of_other_laws(THIRD, cycles * CYCLE.count("law"))
    for stratum in CYCLE * cycles:
        number, counts[stratum] = counts[stratum], counts[stratum] + 1
        if references and stratum not in ("null", "single", "pair"):
            continue
        if stratum == "law":
            yield next(others)
            continue
        change = dict([CHANGES[number % len(CHANGES)]]) if stratum == "parameter" else {}
        key = f"{stratum} {number}{' with references' if references else ''}"
        yield cases.second_case(wishes[stratum][number], stratum, key, change, references)


def page(lines: Sequence[Line]) -> Iterator[str]:
    """Yield the lines of the result."""
    plain, taught = ([line for line in lines if bool(line["references"]) is with_them] for with_them in (False, True))
    yield "# How often the diagnosis is right"
    yield ""
    yield f"The engine of commit {lines[-1]['commit']}; {machine.processor()}, two cores that other programs used too."
    yield f"{len(plain)} data sets, {len(taught) or 'none'} of them with references{'' if taught else ' so far'}, by"
    yield "`benches/python/diagnosis_evidence.py`, whose head says what is drawn. Seeds, fixed before:"
    yield f"{SECOND} to {SECOND + 4} and {THIRD}. Brackets: 95 % Clopper-Pearson bounds."
    good = [line for line in plain if not line["failure"]]
    yield ""
    counts = sum(map(answered, good)), sum(map(wrong, good))
    yield f"Answered rightly: {counts[0]} of {len(plain)}; wrongly: {counts[1]}. The others are declined."
    hidden = [line for line in good if line["stratum"] not in ("null", "parameter", "law")]
    others = [line for line in good if line not in hidden]
    told = [f"{sum(map(answered, some))} and {sum(map(wrong, some))}" for some in (hidden, others)]
    yield f"Of the {len(hidden)} sets with hidden causes: {told[0]}; "
    yield f"of the {len(others)} in which no effect is missing: {told[1]}."
    yield ""
    yield "| | asked (without references) | without references | with three references |"
    yield "|---|---|---|---|"
    with_them = {name: value for name, _, value in rows(taught)} if taught else {}
    for name, asked, value in rows(plain):
        yield f"| {name} | {asked} | {value} | {with_them.get(name, '')} |"
    yield ""
    yield "| hidden, from 2 noise RMS, without references | sets | right | wrong | other answers |"
    yield "|---|--:|--:|--:|---|"
    singles = [line for line in plain if line["stratum"] == "single" and _least(line) >= STRONG]
    for effect in sorted({line["truth"][0]["name"] for line in singles}):
        own = [line for line in singles if line["truth"][0]["name"] == effect]
        said = Counter(_said(line) for line in own if not right(line) and not wrong(line))
        words = ", ".join(f"{word} {count}" if count > 1 else word for word, count in said.most_common())
        yield f"| {effect} | {len(own)} | {sum(map(right, own))} | {sum(map(wrong, own))} | {words} |"
    yield ""
    yield "Names of effects that were not hidden:"
    yield ""
    for line in lines:
        if line["failure"]:
            yield f"- {line['key']}: {line['failure']}"
        elif wrong(line):
            hidden = " and ".join(_words(each) for each in line["truth"]) or line.get("changes") or "nothing"
            also = ", with references" if line["references"] else ""
            yield f"- {line['stratum']}, {hidden}: {' and '.join(line['names'])} ({line['probability']:.2f}{also})"


def rows(lines: Sequence[Line]) -> Iterator[tuple[str, str, str]]:
    """Yield name, asked figure and count of each row."""
    good = [line for line in lines if not line["failure"]]
    by = {stratum: [line for line in good if line["stratum"] == stratum] for stratum in CYCLE}
    yield "nothing hidden: a false name", "<= 0.5 % (1 %)", share([bool(line["names"]) for line in by["null"]])
    strong = [line for line in by["single"] if _least(line) >= STRONG]
    weak = [line for line in by["single"] if _least(line) < STRONG]
    yield "one effect of 2 noise RMS and more: right", ">= 90 % (85 %)", share([right(line) for line in strong])
    yield "one effect of 2 noise RMS and more: a family that holds it", "", share([_in_family(line) for line in strong])
    yield "one effect of 2 noise RMS and more: a wrong name", "<= 2 % (3 %)", share([wrong(line) for line in strong])
    yield "one effect of 0.5 to 2 noise RMS: right", "", share([right(line) for line in weak])
    yield "one effect of 0.5 to 2 noise RMS: a wrong name", "<= 2 % (3 %)", share([wrong(line) for line in weak])
    both = [line for line in by["pair"] if _least(line) >= STRONG]
    yield "two effects, both of 2 noise RMS and more: exact", ">= 75 % (65 %)", share([right(line) for line in both])
    yield "all pairs: exact", "", share([right(line) for line in by["pair"]])
    yield "all pairs: a wrong name", "", share([wrong(line) for line in by["pair"]])
    if by["parameter"]:
        told = [f"parameter {next(iter(line['changes']))}" in line["findings"] for line in by["parameter"]]
        yield "a changed parameter: reported as such", ">= 95 %", share(told)
        yield (
            "a changed parameter: an effect named for it",
            "<= 2 %",
            share([bool(line["names"]) for line in by["parameter"]]),
        )
    if by["law"]:
        told = [any(each.startswith("law") for each in line["findings"]) for line in by["law"]]
        yield "a base of other laws: a law reported", ">= 95 %", share(told)
        yield (
            "a base of other laws: an effect named for it",
            "<= 2 %",
            share([bool(line["names"]) for line in by["law"]]),
        )
    if by["outside"]:
        yield "outside the library: no name", ">= 93 %", share([not line["names"] for line in by["outside"]])
        unknown = [line for line in by["outside"] if line["verdict"] == "unknown"]
        yield (
            "the same, called unknown: right axis",
            ">= 80 %",
            share([line["axis"] in line["axes"] for line in unknown]),
        )
    yield "95 % intervals of right names hold the truth", "92 to 98 %", share(covered(good))
    shrinks = [line["shrink"] for line in good if right(line) and line["truth"] and line["shrink"] is not None]
    if shrinks:
        half, tenth = np.quantile(shrinks, (0.5, 0.1))
        yield "held-out shrink of right names: median; lowest tenth", ">= 0.9; >= 0.6", f"{half:.2f}; {tenth:.2f}"
    if good:
        half, most = np.quantile([line["cpu_s"] - line["library_s"] for line in good], (0.5, 0.95))
        yield "processor time, warm library: median; 95 %", "<= 1 s; <= 4 s", f"{half:.1f} s; {most:.1f} s"


def answered(line: Line) -> bool:
    """Whether exactly the hidden effects are named, or none if no effect of the library is hidden."""
    return right(line) if line["stratum"] in ("single", "pair") else not line["names"]


def _least(line: Line) -> float:
    return min((float(each["multiple"]) for each in line["truth"]), default=0.0)


def _in_family(line: Line) -> bool:
    return not line["names"] and {each["name"] for each in line["truth"]} <= set(line["family"])


def _said(line: Line) -> str:
    return f"family {' or '.join(line['family'])}" if _in_family(line) else str(line["verdict"])


def _words(each: Line) -> str:
    return f"{each['name']} of {each['multiple']:.1f} noise RMS"


def main() -> None:
    """Diagnose the data sets, or print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="file of outcomes, one line for each data set")
    parser.add_argument("--cycles", type=int, default=20, help="number of cycles of 20 data sets (20)")
    parser.add_argument("--references", type=int, default=0, choices=(0, 3), help="trials without the effects")
    parser.add_argument("--report", action="store_true", help="print the table of the outcomes so far")
    given = parser.parse_args()
    digest = engine_digest()
    texts = given.out.read_text(encoding="utf-8").splitlines() if given.out.exists() else []
    lines = [line for line in map(json.loads, texts) if line["digest"] == digest]
    if given.report:
        if not lines:
            parser.error(f"{given.out} has no outcome of this state of the diagnosis")
        print("\n".join(page(lines)))
        return
    given.out.parent.mkdir(parents=True, exist_ok=True)
    known, bench = {line["key"] for line in lines}, cases.EngineBench()
    facts = {"digest": digest, "commit": machine.commit(), "references": given.references}
    with given.out.open("a", encoding="utf-8") as file:
        for case in drawn(given.cycles, given.references):
            if case.key not in known:
                file.write(json.dumps(bench.outcome(case) | facts) + "\n")
                file.flush()


if __name__ == "__main__":
    main()
