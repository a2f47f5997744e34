"""The tuning curve of every constant of the diagnosis: the answers on tuning data if one constant has another value.

PYTHONPATH=.:python python benches/python/diagnosis_constants.py --sets 32 > build/constants.md

The data sets are tuning data of the first generator, the third one (seeds 21 and 31), and the two variants of the
first one with other laws of reversal and other laws of the base. All values see the same data sets.
Constants of the priors and of the answer need no further search: the posterior of the default is weighted anew. The
others need a diagnosis for each value. Each outcome is appended at once to a file of JSON lines, and a repeated command
continues from that file.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import diagnosis_engines_case as cases
import machine
import numpy as np
from diagnosis_benchmark import engine_digest

from needleplan.diagnosis import Diagnosis, Library, Settings, default_library, diagnose
from needleplan.diagnosis._diagnose import answer_of
from needleplan.diagnosis._posterior import Posterior, log_prior
from needleplan.models import Model

# Other values of each constant. The first group needs a search for each value, the second one new weights.
SEARCHED: Mapping[str, tuple[float, ...]] = {
    "law_tolerance": (0.035, 0.14),
    "law_along_axis": (0.075, 0.3),
    "reversal_law": (0.05, 0.3),
    "base_law": (0.0, 0.025, 0.1),
    "entry_law": (0.1, 0.4),
    "trial_tolerance": (0.02, 0.1),
    "heterogeneity": (0.04, 0.16),
    "rate_hz": (30.0, 120.0),
    "visible_law": (0.25, 1.0, 2.0),
}
WEIGHTED: Mapping[str, tuple[float, ...]] = {
    "any_effect": (0.2, 0.35, 0.65, 0.8),
    "further_cause": (0.025, 0.05, 0.2, 0.4),
    "named": (0.7, 0.8, 0.95, 0.99),
    "transfer": (1e-5, 1e-4, 0.01, 0.05),
    "relevant": (0.25, 0.5, 2.0, 4.0),
    "other_law": (3.0, 9.0, 50.0, 1000.0),
}
# Draws: generator, seed, motion and share of the data sets.
SOURCES = (
    ("first", 1, None, 0.4), ("third", 21, None, 0.2), ("third", 31, None, 0.2), ("tuning_foreign", 1, "rich", 0.1),
    ("tuning_base_laws", 1, "rich", 0.1),
)  # fmt: skip
# Least log probability of the truth that counts, so that a single set does not decide.
FLOOR = math.log(1e-3)

Line = dict[str, Any]


def drawn(sets: int) -> Iterator[cases.EngineCase]:
    """Yield the data sets, whose hidden effects have noncentralities of at least 45."""
    for generator, seed, motion, share in SOURCES:
        yield from islice(cases.draw(generator, 4 * sets, seed, None, motion, 45.0), round(share * sets))


def outcomes(case: cases.EngineCase, libraries: dict[Model, Library]) -> Iterator[Line]:
    """Yield the outcome of one data set with the defaults, and with each other value of each constant."""
    model, recordings, hidden, _ = case.make()
    truth, unknown = {each["name"] for each in hidden}, case.facts["stratum"] == "outside"
    facts = {"key": case.key, "stratum": case.facts["stratum"], "truth": sorted(truth)}
    library = libraries.setdefault(model, default_library(model))
    default = diagnose(model, recordings, library=library)
    yield facts | {"constant": "", "value": 0.0} | said(default, truth, unknown)
    for name, values in WEIGHTED.items():
        for value in values:
            settings = replace(Settings(), **{name: value})
            posterior = weighted(default.posterior, settings, len(library.effects))
            decision, _ = answer_of(posterior, default.checked, settings)
            found = replace(default, decision=decision, posterior=posterior, settings=settings)
            yield facts | {"constant": name, "value": value} | said(found, truth, unknown)
    for name, values in SEARCHED.items():
        for value in values:
            found = diagnose(model, recordings, library=library, settings=replace(Settings(), **{name: value}))
            yield facts | {"constant": name, "value": value} | said(found, truth, unknown)


def weighted(posterior: Posterior, settings: Settings, every: int) -> Posterior:
    """Return the posterior with the priors of these settings in place of its own."""
    before = posterior.problem.settings

    def change(names: tuple[str, ...], which: str) -> float:
        count = len(set(names))
        sets = log_prior(settings, every, count) - log_prior(before, every, count)
        shares = [each.further_cause if which else 1 - each.further_cause for each in (settings, before)]
        return sets + math.log(shares[0] / shares[1])

    logs = {key: value + change(*key) for key, value in posterior.logs.items()}
    total = float(np.logaddexp.reduce(list(logs.values())))
    problem = replace(posterior.problem, settings=settings)
    return replace(posterior, problem=problem, logs={key: value - total for key, value in logs.items()})


def said(found: Diagnosis, truth: set[str], unknown: bool) -> Line:
    """Return whether the answer is right, open or wrong, and the log probability of the truth.

    `unknown`: the truth is outside the library.
    """
    names = set(found.names)
    if unknown or not truth:
        answer = "wrong" if names else "right"
    else:
        answer = "wrong" if names - truth else "right" if names else "open"
    of_truth = -math.inf
    for (each, which), value in found.posterior.logs.items():
        if set(each) == (set() if unknown else truth) and (which or not unknown):
            of_truth = float(np.logaddexp(of_truth, value))
    return {"answer": answer, "log": of_truth}


def page(lines: list[Line]) -> Iterator[str]:
    """Yield the lines of the table."""
    sets = len({line["key"] for line in lines})
    yield "# What the constants of the diagnosis do"
    yield ""
    yield f"{machine.processor()}, commit {machine.commit()}. Command: `diagnosis_constants.py`, {sets} data sets."
    yield ""
    yield "All data sets are tuning data, and the same for each value. Defaults in bold. Right: no false name, and a"
    yield f"name if an effect of the library is hidden. The mean counts log probabilities from {FLOOR:.1f} on."
    yield ""
    yield "| constant | value | right | open | wrong | mean log probability of the truth |"
    yield "|---|--:|--:|--:|--:|--:|"
    for name in (*SEARCHED, *WEIGHTED):
        default = float(getattr(Settings(), name))
        for value in sorted((*SEARCHED.get(name, ()), *WEIGHTED.get(name, ()), default)):
            key = ("", 0.0) if value == default else (name, value)
            kept = [line for line in lines if (line["constant"], line["value"]) == key]
            counts = [sum(line["answer"] == answer for line in kept) for answer in ("right", "open", "wrong")]
            score = np.mean([max(line["log"], FLOOR) for line in kept]) if kept else math.nan
            cell = f"**{value:g}**" if value == default else f"{value:g}"
            yield f"| `{name}` | {cell} | {' | '.join(map(str, counts))} | {score:.2f} |"


def main() -> None:
    """Diagnose, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", type=int, default=32, help="number of data sets (32)")
    parser.add_argument("--outcomes", type=Path, default=machine.ROOT / "build" / "diagnosis_constants.jsonl")
    given = parser.parse_args()
    given.outcomes.parent.mkdir(parents=True, exist_ok=True)
    digest = engine_digest()
    libraries: dict[Model, Library] = {}
    read = given.outcomes.read_text(encoding="utf-8").splitlines() if given.outcomes.exists() else []
    lines = [line for line in map(json.loads, read) if line["digest"] == digest]
    known = {line["key"] for line in lines}
    with given.outcomes.open("a", encoding="utf-8") as file:
        for case in drawn(given.sets):
            if case.key not in known:
                found = [line | {"digest": digest} for line in outcomes(case, libraries)]
                lines += found
                file.writelines(json.dumps(line) + "\n" for line in found)
                file.flush()
    print("\n".join(page(lines)))


if __name__ == "__main__":
    main()
