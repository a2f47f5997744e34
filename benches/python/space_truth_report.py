"""The report of space_truth.py, from its JSON file: `python benches/python/space_truth_report.py FILE.json`."""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

# Goals of the project: mean and largest absolute difference, in percentage points.
GOALS = (1.5, 5.0)
# Entries that are listed as the worst.
WORST = 8
Row = dict[str, Any]


def table(header: list[str], rows: list[list[object]], texts: int = 1) -> str:
    """Return a table in Markdown; the first columns are texts."""
    lines = [header, ["---"] * texts + ["--:"] * (len(header) - texts), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def chance(entry: Row, runs: int, key: str = "told") -> float:
    """Return the mean difference (points) of an exact prediction; the interval of what is told has its own chance."""
    realised = entry["realised"]
    variance = realised * (1.0 - realised) / runs
    if key == "told":
        variance += ((entry["interval"][1] - entry["interval"][0]) / (2 * 1.96)) ** 2
    return float(100 * np.sqrt(2 / np.pi * variance))


def line(name: str, pairs: list[tuple[Row, Row]], key: str = "told") -> list[object]:
    """Return a line on pairs of anatomy and entry; differences are told less realised, in percentage points."""
    told, realised = (100 * np.array([entry[field] for _, entry in pairs]) for field in (key, "realised"))
    apart = told - realised
    by_chance = np.mean([chance(entry, anatomy["runs"], key) for anatomy, entry in pairs])
    worst = apart[abs(apart).argmax()]
    missed = 100 * np.mean([entry["missed"] / anatomy["runs"] for anatomy, entry in pairs])
    return [name, len(pairs), f"{told.mean():.1f} %", f"{realised.mean():.1f} %", f"{abs(apart).mean():.2f}",
            f"{by_chance:.2f}", f"{apart.mean():+.2f}", f"{worst:+.1f}", f"{apart.max():+.1f}",
            f"{missed:.2f}"]  # fmt: skip


def label(anatomy: Row) -> str:
    """Return the name, the seed and the needle of an anatomy."""
    needle = f", needle of {anatomy['diameter_mm']:.2f} mm" if anatomy["diameter_mm"] else ""
    return f"{anatomy['name']} {anatomy['seed']}{needle}"


def groups(anatomies: list[Row]) -> list[tuple[str, list[tuple[Row, Row]]]]:
    """Return the entries of each kind and of all, listed and random ones apart."""
    pairs = [(anatomy, entry) for anatomy in anatomies for entry in anatomy["entries"]]
    found = []
    for kind in dict.fromkeys(anatomy["name"] for anatomy in anatomies):
        for listed in (True, False):
            chosen = [pair for pair in pairs if pair[0]["name"] == kind and pair[1]["listed"] == listed]
            found.append((f"{kind}, {'listed' if listed else 'random'}", chosen))
    for name, foreign in (("phantoms", False), ("foreign", True)):
        found.append((f"all {name}", [pair for pair in pairs if pair[0]["name"].startswith("foreign") == foreign]))
    found.append(("all listed", [pair for pair in pairs if pair[1]["listed"]]))
    found.append(("all random", [pair for pair in pairs if not pair[1]["listed"]]))
    return [(name, chosen) for name, chosen in [*found, ("all", pairs)] if chosen]


def goals(pairs: list[tuple[Row, Row]]) -> str:
    """Return whether the goals are reached."""
    apart = np.array([100 * abs(entry["told"] - entry["realised"]) for _, entry in pairs])
    parts = [
        f"{name} {value:.2f} (at most {goal:g}: {'reached' if value <= goal else 'not reached'})"
        for name, value, goal in zip(("mean", "worst"), (apart.mean(), apart.max()), GOALS, strict=True)
    ]
    return "; ".join(parts) + f"; {(apart > GOALS[1]).sum()} of {len(apart)} entries above {GOALS[1]:g}"


def text(about: Row, anatomies: list[Row]) -> str:
    """Return the report on anatomies."""
    pairs = [(anatomy, entry) for anatomy in anatomies for entry in anatomy["entries"]]
    entries = [entry for _, entry in pairs]
    executions = sum(anatomy["runs"] * len(anatomy["entries"]) for anatomy in anatomies)
    seeds = ", ".join(str(seed) for seed in dict.fromkeys(anatomy["seed"] for anatomy in anatomies))
    header = ["entries", "number", "told", "realised", "mean", "chance", "bias", "worst", "most too high", "missed"]
    worst = sorted(pairs, key=lambda pair: -abs(pair[1]["told"] - pair[1]["realised"]))[:WORST]
    where = ["anatomy, seed", "entry", "R, A, S (mm)", "direction R, A, S", "told", "realised", "gap", "reached",
             "by the table"]  # fmt: skip
    cost = ["anatomy, seed", "voxels of the file", "spacing", "states", "seconds", "processor time", "peak memory"]
    return "\n".join([
        "# Success as told, and realised in the voxels of the file\n",
        f"{about['processor']}, {about['threads']} threads, load {about['load_before']}, commit {about['commit']}, "
        f"{about['date']}.",
        f"Seeds {seeds}; {anatomies[0]['runs']:,} executions of each entry. Differences: told less realised, in",
        "percentage points. Chance: the mean difference of an exact prediction, from the executions of the judge and",
        "those of the estimate. Missed: executions that meet the target of the file, but do not count as reached.\n",
        table(header, [line(name, chosen) for name, chosen in groups(anatomies)]),
        f"\nGoals, in points: {goals(pairs)}.\n",
        "| must not be | found |",
        "|---|--:|",
        f"| executions that count as reached and touch an obstacle or its margin, of {executions:,} | "
        f"{sum(entry['reached_and_touch'] for entry in entries)} |",
        f"| executions that count as reached and end beside the target, of {executions:,} | "
        f"{sum(entry['reached_and_end_beside'] for entry in entries)} |",
        "| listed entries whose path without noise touches an obstacle or its margin, of "
        f"{sum(entry['listed'] for entry in entries)} | "
        f"{sum(entry['listed'] and entry['path_touches'] for entry in entries)} |",
        f"| executions that meet the target of the file and do not count as reached, of {executions:,} | "
        f"{sum(entry['missed'] for entry in entries)} |",
        "\n## The largest differences\n",
        "Reached: the share of the executions that they themselves count as a success.\n",
        table(where, [
            [label(anatomy), "listed" if entry["listed"] else "random",
             ", ".join(f"{value:.2f}" for value in entry["entry_mm"]),
             ", ".join(f"{value:.4f}" for value in entry["direction"]),
             f"{100 * entry['told']:.1f} % ({100 * entry['interval'][0]:.1f} to {100 * entry['interval'][1]:.1f})",
             f"{100 * entry['realised']:.1f} %", f"{100 * (entry['told'] - entry['realised']):+.1f}",
             f"{100 * entry['reached']:.1f} %", f"{100 * entry['table']:.1f} %"]
            for anatomy, entry in worst
        ], 4),
        "\n## By the table alone\n",
        "Users are told the estimate. The table is off by more, because its success is interpolated.\n",
        table(header, [line(name, chosen, "table") for name, chosen in groups(anatomies)]),
        "\n## Cost of planning\n",
        "Reading the anatomy, solving, and the map of entries. Memory: of the whole process, Python included.\n",
        table(cost, [
            [label(anatomy), f"{anatomy['voxels'] / 1e6:.2f} M", f"{anatomy['spacing_mm']:g} mm",
             f"{anatomy['states'] / 1e6:.1f} M", f"{anatomy['seconds']:.1f}", f"{anatomy['processor_s']:.1f} s",
             f"{anatomy['memory_mb']:,.0f} MB"]
            for anatomy in anatomies
        ]),
    ])  # fmt: skip


if __name__ == "__main__":
    record = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    print(text(record["machine"], record["anatomies"]))
