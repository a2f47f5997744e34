"""The report of `compare_peers.py`, in Markdown."""

from collections.abc import Mapping
from typing import Any

from contest import Result
from contestants import LATTICE
from verdicts import does_prioritization_pay, fastest_library, verdicts

AGAIN = "again"
"""Name of the second result of the first contestant, which is measured again at the end."""

Record = Mapping[str, Any]


def text(record: Record) -> str:
    """Return the report as Markdown."""
    results = _results(record)
    words = {True: "yes", False: "**no**", None: "?"}
    claims = [f"| {each.claim} | {each.measured} | {words[each.holds]} |" for each in verdicts(results)]
    parts = [
        _heading(record),
        "\n".join(_table(results, record["states"])),
        "Ratio: the best run of the fastest of mdpsolver, QuantEcon and pymdptoolbox, over the median of the row.",
        "\n".join(["| claim | measured | holds |", "|---|--:|---|", *claims]),
        f"Does prioritization pay? {does_prioritization_pay(results)}",
        _drift(results),
        "" if is_full(record) else "A smoke test: the claims are about a spacing of 1 mm.",
    ]
    return "\n\n".join(part for part in parts if part)


def is_full(record: Record) -> bool:
    """Whether the record is of the full problem (grid spacing 1 mm), to which the claims apply."""
    return float(record["spacing_mm"]) == 1.0


def fails(record: Record) -> bool:
    """Whether a measured claim does not hold; claims without a measurement do not count."""
    return any(each.holds is False for each in verdicts(_results(record)))


def _results(record: Record) -> dict[str, Result]:
    return {each["name"]: Result(**each) for each in record["results"]}


def _heading(record: Record) -> str:
    about = record["machine"]
    versions = ", ".join(f"{name} {number}" for name, number in about["packages"].items())
    return (
        f"{record['states']:,} states, {record['entries']:,} entries, residual below {record['threshold']:.3g}. "
        f"Errors are max |V - V*|, against values right within {record['reference_error_bound']:.1g}.\n"
        f"{about['processor']}, {about['threads']} threads, load {about['load_before']} before the run; "
        f"{about['date'][:10]}, commit {about['commit']}, {about['rustc']}, Python {about['python']}, {versions}."
    )


def _table(results: Mapping[str, Result], states: int) -> list[str]:
    peer = fastest_library(results)
    lines = [
        "| solver | build s | solve s, median | best | runs | ratio | backups / n | 1e6 backups/s | error | peak GB |",
        "|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for name, each in results.items():
        if name == AGAIN:
            continue
        label = each.label + (f" ({each.note})" if each.note else "")
        if each.failure:
            lines.append(f"| {label} | {each.failure.replace('|', '/')} | | | | | | | | |")
            continue
        ratio = f"{peer.least / each.median:.3g}" if peer else ""
        done = each.facts.get("sweeps")
        sweeps = "|" if done is None else f"{done:.4g} | {states * done / each.median / 1e6:.4g}"
        times = f"{each.build:.3g} | {each.median:.4g} | {each.least:.4g} | {len(each.solves)}"
        lines.append(f"| {label} | {times} | {ratio} | {sweeps} | {each.error:.1e} | {each.peak_gb:.2f} |")
    return lines


def _drift(results: Mapping[str, Result]) -> str:
    first, last = results.get(LATTICE.name), results.get(AGAIN)
    if first is None or last is None or first.failure or last.failure:
        return ""
    change = last.median / first.median - 1
    verdict = "the machine was busy or changed its speed: run again" if abs(change) > 0.25 else "steady enough"
    return f"The first figure once more at the end: {100 * change:+.0f} % ({verdict})."
