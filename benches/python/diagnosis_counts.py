"""Counts of right and wrong answers of the diagnosis with their bounds, and the digest of the engine that gave them."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import machine
from scipy.stats import beta

import needleplan
from needleplan.artifacts import digest

Line = dict[str, Any]


def engine_digest() -> str:
    """Return a digest of all sources that affect an outcome."""
    package = Path(needleplan.__file__).parent
    files = sorted(file for part in ("diagnosis", "models", "signals") for file in (package / part).rglob("*.py"))
    files += sorted((machine.ROOT / "tests" / "blind").glob("*.py"))
    return digest(b"".join(file.read_bytes() for file in files))[:19]


def rate(hits: int, of: int) -> dict[str, float | int | None]:
    """Return hits / of with its 95 % Clopper-Pearson bounds; rate and bounds are None if `of` is 0."""
    if not of:
        return {"hits": 0, "of": 0, "rate": None, "low": None, "high": None}
    low = float(beta.ppf(0.025, hits, of - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, of - hits)) if hits < of else 1.0
    return {"hits": hits, "of": of, "rate": hits / of, "low": low, "high": high}


def share(each: Sequence[bool]) -> str:
    """Return a rate with its bounds as text."""
    found = rate(sum(each), len(each))
    if not found["of"]:
        return "none"
    low, value, high = (float(found[key] or 0.0) for key in ("low", "rate", "high"))
    return f"{found['hits']} of {found['of']}, {value:.0%} ({low:.0%} to {high:.0%})"


def hidden(line: Line) -> set[str]:
    """Return the names of the hidden effects."""
    return {each["name"] for each in line["truth"]}


def right(line: Line) -> bool:
    """Whether the verdict is NAMED and its names are exactly the hidden effects."""
    return line["verdict"] == "named" and set(line["names"]) == hidden(line)


def wrong(line: Line) -> bool:
    """Whether an effect is named that was not hidden."""
    return bool(set(line["names"]) - hidden(line))


def covered(lines: Sequence[Line]) -> list[bool]:
    """Return for each comparable parameter of a correctly named set whether its interval holds the truth."""
    found = []
    for line in filter(right, lines):
        for each in line["truth"]:
            for name, value in each["parameters"].items():
                if name in line["estimates"].get(each["name"], {}):
                    _, low, high = line["estimates"][each["name"]][name]
                    found.append(bool(low <= value <= high))
    return found
