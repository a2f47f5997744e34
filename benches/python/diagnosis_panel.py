"""A fixed panel of 60 data sets of the three generators, to compare two states of the diagnosis set by set.

PYTHONPATH=.:python python benches/python/diagnosis_panel.py --out build/panel_new.jsonl
PYTHONPATH=.:python python benches/python/diagnosis_panel.py --compare build/panel_old.jsonl build/panel_new.jsonl

Of each generator: 4 sets without an effect, 9 with one, 4 with two, 3 outside the library; every hidden effect has a
noncentrality of at least 60. A repeated command continues the file. `--compare` prints the counts of both files, and
each set whose outcome differs.
"""

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import diagnosis_engines_case as cases
import numpy as np

# Generators with their seeds, number of sets by stratum, and least noncentrality of a hidden effect.
_SEEDS = {"first": 3, "second": 21, "third": 31}
_QUOTA = {"null": 4, "single": 9, "pair": 4, "outside": 3}
_LEAST = 60.0


def panel() -> Iterator[cases.EngineCase]:
    """Yield the data sets of the panel."""
    for generator, seed in _SEEDS.items():
        left = dict(_QUOTA)
        for case in cases.draw(generator, 400, seed, None, None):
            hidden = case.make()[2]
            kind = _kind(case.facts["stratum"], len(hidden))
            if left.get(kind, 0) and all(each["noncentrality"] >= _LEAST for each in hidden):
                left[kind] -= 1
                yield case
            if not any(left.values()):
                break


def _kind(stratum: str, hidden: int) -> str:
    """Return the stratum; an effect of the further library is a single one or one of a pair."""
    return {1: "single", 2: "pair"}.get(hidden, stratum) if stratum == "further" else stratum


def outcome(line: dict[str, Any]) -> str:
    """Return the outcome of one diagnosis in a word."""
    truth, names = {each["name"] for each in line["truth"]}, set(line["names"])
    if line["failure"]:
        return "crash"
    if line["stratum"] in ("null", "outside"):
        return "falsely named" if names else line["verdict"]
    if names == truth:
        return "right"
    return "wrong" if names - truth else "part" if names else "missed"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="file of outcomes, one line for each data set")
    parser.add_argument("--compare", type=Path, nargs=2, metavar="FILE", help="compare two such files")
    given = parser.parse_args()
    if given.out:
        known = _lines(given.out)
        given.out.parent.mkdir(parents=True, exist_ok=True)
        bench = cases.EngineBench()
        with given.out.open("a", encoding="utf-8") as file:
            for case in panel():
                if case.key not in known:
                    file.write(json.dumps(bench.outcome(case)) + "\n")
                    file.flush()
    files = [_lines(path) for path in given.compare or filter(None, [given.out])]
    if not files:
        sys.exit("give --out FILE, or --compare OLD NEW")
    common = set.intersection(*(set(each) for each in files))
    if not common:
        sys.exit("the files have no data set in common")
    for lines in files:
        for stratum in _QUOTA:
            some = [lines[key] for key in common if _kind(lines[key]["stratum"], len(lines[key]["truth"])) == stratum]
            print(f"{stratum}: {dict(Counter(map(outcome, some)))}")
        cpu_s = [lines[key]["cpu_s"] for key in common]
        print(f"processor time: median {np.median(cpu_s):.1f} s, 95 % {np.quantile(cpu_s, 0.95):.1f} s\n")
    for key in sorted(common):
        told = [outcome(lines[key]) for lines in files]
        if len(set(told)) > 1:
            truth = [each["name"] for each in files[0][key]["truth"]]
            print(key, truth, *(f"{word} {lines[key]['names']}" for word, lines in zip(told, files, strict=True)))


def _lines(path: Path) -> dict[str, dict[str, Any]]:
    texts = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return {line["key"]: line for line in map(json.loads, texts)}


if __name__ == "__main__":
    main()
