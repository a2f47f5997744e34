"""Measure the tracked times and instruction counts, append them to benches/history.jsonl, draw benches/history.png.

    python benches/python/track.py            # a few minutes, on an idle machine
    python benches/python/track.py --draw     # draw the existing history

Times are medians in seconds. Each run is compared with the first run on the same processor. Instruction counts
(`benches/guard`) do not depend on the load of the machine, but on compiler and processor.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from time import time
from typing import Any

import machine
from machine import ROOT

HISTORY = ROOT / "benches" / "history.jsonl"
FIGURE = ROOT / "benches" / "history.png"
BENCHES = ("sweep_pass", "solve", "tabular", "lookup")
PYTHON_FIGURES = {
    "lookup, one call, us": 1e-6,
    "table read, ms": 1e-3,
    "plan: all of it, ms": 1e-3,
    "shell: plan, ms": 1e-3,
}
_DRAWN = {
    "solve/nearest/thesis/1": "solve, nearest, 1 thread",
    "solve/nearest/thesis/2": "solve, nearest, 2 threads",
    "solve/interpolated/success/1": "solve, interpolated, success, 1 thread",
    "tabular/sweep": "tabular sweep",
    "lookup/many/1": "a million look-ups",
    "shell: plan": "needleplan plan, from the shell",
}

Record = dict[str, Any]


def main() -> int:
    """Measure, append the record to the history, and draw it; --draw and --quick skip parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="measure nothing, draw only")
    parser.add_argument("--quick", action="store_true", help="measure roughly and print, append nothing")
    options = parser.parse_args()
    if not options.draw:
        record = measure(quick=options.quick)
        if options.quick:
            print(json.dumps(record, indent=1))
            return 0
        with HISTORY.open("a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")
    records = [json.loads(line) for line in HISTORY.read_text(encoding="utf-8").splitlines() if line]
    draw(records, FIGURE)
    print(f"{len(records)} records in {HISTORY.relative_to(ROOT)}, drawn in {FIGURE.relative_to(ROOT)}")
    return 0


def measure(quick: bool) -> Record:
    """Return the record of this working tree: machine, times and instruction counts."""
    about = machine.description()
    figures = {**criterion(quick), **from_python()}
    counted = json.loads(output("benches/guard", "--json"))
    return {**about, "figures": figures, "instructions": counted["instructions"]}


def criterion(quick: bool) -> dict[str, float]:
    """Run the Rust benches; return their median times (s) by name."""
    began = time()
    chosen = [word for name in BENCHES for word in ("--bench", name)]
    pace = ("--quick",) if quick else ("--warm-up-time", "1", "--measurement-time", "3")
    output("cargo", "bench", "--locked", "-p", "needleplan-benches", *chosen, "--", *pace)
    figures = {}
    target = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    for estimates in sorted(target.glob("criterion/**/new/estimates.json")):
        if estimates.stat().st_mtime >= began:
            name = json.loads(estimates.with_name("benchmark.json").read_text())["full_id"]
            figures[name] = json.loads(estimates.read_text())["median"]["point_estimate"] / 1e9
    for kind in ("nearest", "interpolated"):
        few, many = (figures.get(f"sweep_pass/{kind}/{passes}") for passes in (1, 4))
        if few is not None and many is not None:
            figures[f"sweep_pass/{kind}"] = (many - few) / 3
    return figures


def from_python() -> dict[str, float]:
    """Run `lookup.py`; return the tracked times (s) by name."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "lookup.json"
        output(sys.executable, str(Path(__file__).with_name("lookup.py")), "--json", str(file))
        measured = json.loads(file.read_text())["figures"]
    return {name.rpartition(",")[0]: measured[name] * unit for name, unit in PYTHON_FIGURES.items()}


def output(*command: str) -> str:
    """Run a command and return its standard output; its error output is not captured."""
    print(" ".join(command), file=sys.stderr)
    return subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True).stdout


def draw(records: list[Record], file: Path) -> None:
    """Draw times and instructions of all runs, each relative to the first run on its processor."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, (upper, lower) = plt.subplots(2, 1, figsize=(9.6, 7.2), sharex=True, layout="constrained")
    names = [name for name in _DRAWN if any(name in each["figures"] for each in records)]
    _draw_relative(upper, records, "figures", {name: _DRAWN[name] for name in names}, "time / time of the first run")
    paths = sorted({name for each in records for name in each["instructions"]})
    _draw_relative(lower, records, "instructions", {name: name for name in paths}, "instructions / those of the first")
    lower.set_xticks(range(len(records)), [f"{each['commit']}\n{each['date'][:10]}" for each in records], fontsize=7)
    figure.savefig(file, dpi=140)


def _draw_relative(axes: Any, records: list[Record], part: str, names: dict[str, str], label: str) -> None:
    """Draw one curve for each name and processor; the legend shows the last value."""
    for number, (name, title) in enumerate(names.items()):
        for processor in sorted({_conditions(each) for each in records}):
            runs = [(at, each[part][name]) for at, each in _runs_on(records, processor) if name in each[part]]
            if runs:
                relative = [value / runs[0][1] for _, value in runs]
                last = f"{runs[-1][1]:,} instructions" if part == "instructions" else _seconds(runs[-1][1])
                axes.plot([at for at, _ in runs], relative, "o-", color=f"C{number}", label=f"{title}: {last}")
    axes.set(ylabel=label)
    axes.set_ylim(bottom=0)
    axes.grid(which="major", color="0.9")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5))


def _runs_on(records: list[Record], conditions: str) -> Iterable[tuple[int, Record]]:
    return ((at, each) for at, each in enumerate(records) if _conditions(each) == conditions)


def _conditions(record: Record) -> str:
    return f"{record['processor']}, {record['threads']} threads"


def _seconds(value: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if value >= size:
            return f"{value / size:.3g} {unit}"
    return f"{value * 1e9:.3g} ns"


if __name__ == "__main__":
    sys.exit(main())
