"""What each special mechanism of the diagnosis is worth: answers on the fixed panel with one of them switched off.

PYTHONPATH=.:python python benches/python/diagnosis_ablation.py --out build/ablation
PYTHONPATH=.:python python benches/python/diagnosis_ablation.py --out build/ablation --table

The second command prints the table. `--only NAME ...` chooses mechanisms. A repeated command continues. An answer
without the mechanism is better, worse or the same by its score: 2 for a right answer, 1 for part of the names or no
name, 0 for a wrong name or a crash. The chance of the difference is that of a fair coin thrown once for each answer
that changes (two-sided sign test).
"""

import argparse
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import diagnosis_engines_case as cases
import numpy as np
from diagnosis_panel import outcome, panel
from scipy.stats import binomtest

from needleplan.diagnosis import _diagnose, _hypothesis, _problem, _reversal, _screening, _search
from needleplan.diagnosis._blocks import TISSUE_KINDS

# Score of an outcome; others count 1.
_SCORES = {"right": 2, "none": 2, "underpowered": 2, "unknown": 2, "wrong": 0, "falsely named": 0, "crash": 0}

Change = Callable[[], Any]


def _only_rough() -> Any:
    own = _problem.Problem.levels.func  # type: ignore[attr-defined]
    return patch.object(
        _problem.Problem, "levels", property(lambda self: np.array([k for k in own(self) if TISSUE_KINDS[k] == 0]))
    )


def _only_smooth() -> Any:
    own = _problem.Problem.levels.func  # type: ignore[attr-defined]
    return patch.object(
        _problem.Problem, "levels",
        property(lambda self: np.array([k for k in own(self) if k == 0 or TISSUE_KINDS[k] == 1] or own(self))),
    )  # fmt: skip


def _no_formula_errors(_: Any, trials: Any, __: Any) -> list[Any]:
    return [np.zeros((len(trial.whitened.residual), 0)) for trial in trials]


def _without_the_tip(trial: Any, effects: Any) -> Any:
    found = _reversal.reversal_laws(trial, effects).copy()
    found[:, _reversal.COUNT :] = 0.0
    return found


MECHANISMS: dict[str, tuple[str, Change]] = {
    "all": ("nothing is switched off", lambda: patch.dict({})),
    "given base": ("effects are not screened again beside the given base", lambda: patch.object(
        _screening, "visible_laws", lambda *_: False)),
    "instants": ("readings are means over their intervals", lambda: patch.object(_diagnose, "parts_of", lambda _: 1)),
    "smooth tissue": ("tissue is rough", _only_rough),
    "rough tissue": ("tissue is smooth", _only_smooth),
    "memory": ("contacts remember as Dahl's bristle", lambda: patch.object(_reversal, "MEMORY_LAW", 1e-6)),
    "formula errors": ("formulas are right in time", lambda: patch.object(
        _hypothesis, "formula_errors", _no_formula_errors)),
    "tip": ("shaft and tip have one law of reversal", lambda: patch.object(
        _hypothesis, "reversal_laws", _without_the_tip)),
    "further starts": ("no further starts of effects with local optima", lambda: patch.object(
        _search, "MORE_SEARCHES", 0)),
    "tolerance scales": ("one scale of each tolerance", lambda: patch.object(
        _hypothesis.Hypothesis, "with_best_scales", lambda self: self)),
    "subsets": ("subsets of the best set are not fitted again", lambda: patch.object(
        _search._Search, "_refit_subsets", lambda *_: None)),
}  # fmt: skip


@contextmanager
def without(name: str) -> Iterator[None]:
    """Switch a mechanism off."""
    change = MECHANISMS[name][1]()
    if name == "all":
        yield
        return
    with change:
        yield


def score(line: dict[str, Any]) -> int:
    """Return the score of an answer."""
    return _SCORES.get(outcome(line), 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of outcomes, one file for each mechanism")
    parser.add_argument("--only", nargs="*", choices=list(MECHANISMS), help="mechanisms to switch off")
    parser.add_argument("--table", action="store_true", help="print the table of the folder")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    if given.table:
        _print(given.out)
        return
    every, bench = list(panel()), cases.EngineBench()
    for name in given.only or MECHANISMS:
        path = given.out / f"{name.replace(' ', '_')}.jsonl"
        known = _lines(path)
        with path.open("a", encoding="utf-8") as file, without(name):
            for case in every:
                if case.key not in known:
                    file.write(json.dumps(bench.outcome(case)) + "\n")
                    file.flush()


def _print(folder: Path) -> None:
    whole = _lines(folder / "all.jsonl")
    print("| switched off | sets | better | worse | other answer | wrong names | processor time (s) | chance |")
    print("|---|---|---|---|---|---|---|---|")
    for name, (words, _) in MECHANISMS.items():
        own = _lines(folder / f"{name.replace(' ', '_')}.jsonl")
        common = sorted(set(own) & set(whole))
        if not common:
            continue
        gains = [score(own[key]) - score(whole[key]) for key in common]
        better, worse = sum(each > 0 for each in gains), sum(each < 0 for each in gains)
        other = sum(outcome(own[key]) != outcome(whole[key]) for key in common)
        wrong = sum(score(own[key]) == 0 for key in common)
        chance = binomtest(better, better + worse).pvalue if better + worse else 1.0
        cpu_s = np.median([own[key]["cpu_s"] for key in common])
        counts = f"{len(common)} | {better} | {worse} | {other} | {wrong}"
        print(f"| {name}: {words} | {counts} | {cpu_s:.1f} | {chance:.2f} |")


def _lines(path: Path) -> dict[str, dict[str, Any]]:
    texts = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {line["key"]: line for line in map(json.loads, texts)}


if __name__ == "__main__":
    main()
