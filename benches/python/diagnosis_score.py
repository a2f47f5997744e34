"""What the outcomes of a campaign say: rates with their bounds, power curves, calibration, confusion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import beta

Line = dict[str, Any]
Lines = Sequence[Line]

LEVELS = (0.0, 0.03, 0.10)
VARIETIES = ("rich", "poor")
SIZES = (0.0, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0, 10.0, 50.0)
NONCENTRALITIES = (0.0, 10.0, 30.0, 60.0, 100.0, 300.0, 1000.0, 3000.0, 1e9)
QUIET = ("none", "underpowered")
NAMING = ("named", "incomplete")
"""Verdicts that give a name."""


def rate(hits: int, of: int) -> dict[str, float | int | None]:
    """Return a share with the bounds of Clopper and Pearson, 95 %, None where there is nothing to divide by."""
    if not of:
        return {"hits": 0, "of": 0, "rate": None, "low": None, "high": None}
    low = float(beta.ppf(0.025, hits, of - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, of - hits)) if hits < of else 1.0
    return {"hits": hits, "of": of, "rate": hits / of, "low": low, "high": high}


def share(lines: Iterable[Line], true: Callable[[Line], bool]) -> dict[str, float | int | None]:
    """Return in how many of some outcomes something holds."""
    each = [true(line) for line in lines]
    return rate(sum(each), len(each))


def given(line: Line) -> list[str]:
    """Return the names that were given."""
    return list(line["names"]) if line["verdict"] in NAMING else []


def hidden(line: Line) -> list[str]:
    """Return the names that are right."""
    return [each["name"] for each in line["truth"]]


def right(line: Line) -> bool:
    """Whether the verdict is NAMED with just what was hidden; one hidden effect may be several bumps."""
    return line["verdict"] == "named" and set(line["names"]) == set(hidden(line))


def wrong(line: Line) -> bool:
    """Whether a name was given that was not hidden."""
    return bool(set(given(line)) - set(hidden(line)))


def size(line: Line) -> float:
    """Return the size of the smallest hidden effect, in noise RMS."""
    return min((each["size"] for each in line["truth"]), default=0.0)


def noncentrality(line: Line) -> float:
    """Return what the base leaves of the smallest hidden effect."""
    return min((each["noncentrality"] for each in line["truth"]), default=0.0)


def pick(lines: Lines, stratum: str, **equal: Any) -> list[Line]:
    """Return the outcomes of a stratum with some values."""
    return [
        line for line in lines
        if line["stratum"] == stratum and all(line[key] == value for key, value in equal.items() if value is not None)
    ]  # fmt: skip


def summary(lines: Lines, large: float = 1.0) -> dict[str, Any]:
    """Return all figures of a run, whole or not; effects are expected to be named from the size `large` on."""
    failures = [line for line in lines if line["failure"]]
    lines = [line for line in lines if not line["failure"]]
    return {
        "data_sets": len(lines),
        "strata": dict(Counter(line["stratum"] for line in lines)),
        "failures": [{"seed": line["seed"], "failure": line["failure"]} for line in failures],
        "null": {f"{variety} {level:g}": nulls(pick(lines, "null", heterogeneity=level, variety=variety))
                 for variety in VARIETIES for level in LEVELS},
        "single": {f"{variety} {level:g}": singles(pick(lines, "single", heterogeneity=level, variety=variety), large)
                   for variety in VARIETIES for level in LEVELS},
        "pair": {f"{level:g}": pairs(pick(lines, "pair", heterogeneity=level)) for level in LEVELS},
        "outside": {
            "all": outside(pick(lines, "outside")),
            "tuned": outside(pick(lines, "outside", never_tuned=False)),
            "never tuned": outside(pick(lines, "outside", never_tuned=True)),
            **{f"{level:g}": outside(pick(lines, "outside", heterogeneity=level)) for level in LEVELS},
        },
        "absorbed": share(pick(lines, "absorbed"), lambda line: bool(given(line))),
        "power": {
            "size": {f"{variety} {level:g}": curve(pick(lines, "single", heterogeneity=level, variety=variety),
                                                   size, SIZES) for variety in VARIETIES for level in LEVELS},
            "noncentrality": {f"{variety} {level:g}": curve(
                pick(lines, "single", heterogeneity=level, variety=variety), noncentrality, NONCENTRALITIES)
                for variety in VARIETIES for level in LEVELS},
        },
        "p_values": {f"{level:g}": chances(pick(lines, "null", heterogeneity=level)) for level in LEVELS},
        "coverage": {f"{level:g}": coverage(pick(lines, "single", heterogeneity=level)) for level in LEVELS},
        "depth_mm": depths(pick(lines, "single")),
        "seconds": {"cpu": spread([line["cpu_s"] for line in lines]),
                    "wall": spread([line["wall_s"] for line in lines])},
        "confusion": confusion(lines, large),
        "by_effect": by_effect(pick(lines, "single"), large),
        "peers": peers(lines, large),
    }  # fmt: skip


def nulls(lines: Lines) -> dict[str, Any]:
    """Score data sets without an effect."""
    return {
        "falsely_named": share(lines, lambda line: bool(given(line))),
        "flagged": share(lines, lambda line: line["verdict"] not in QUIET),
        "names": dict(Counter(name for line in lines for name in given(line))),
        "level_found": spread([line["level"] for line in lines]),
    }


def singles(lines: Lines, large: float) -> dict[str, Any]:
    """Score data sets with one effect; from the size `large` on, where nothing else is said."""
    kept = [line for line in lines if size(line) >= large]
    good = [line["shrink"] for line in kept if right(line) and line["shrink"] is not None]
    return {
        "right": share(kept, right),
        "wrong": share(kept, wrong),
        "detected": share(kept, lambda line: line["verdict"] not in QUIET),
        "right_where_left": share([line for line in kept if noncentrality(line) >= 100], right),
        "precision": share([line for line in lines if line["verdict"] == "named"], right),
        "verdicts": dict(Counter(line["verdict"] for line in kept)),
        "shrink": spread(good),
    }


def pairs(lines: Lines) -> dict[str, Any]:
    """Score data sets with two effects, each of at least 0.2 noise RMS and with a ratio below 4."""
    kept = []
    for line in lines:
        sizes = sorted(each["size"] for each in line["truth"])
        if sizes[0] >= 0.2 and sizes[1] < 4 * sizes[0]:
            kept.append(line)

    def strongest(line: Line) -> bool:
        return str(max(line["truth"], key=lambda each: each["noncentrality"])["name"]) in given(line)

    return {
        "exact": share(kept, right),
        "strongest": share(kept, strongest),
        "false_extra": share(kept, wrong),
        "exact_where_left": share([line for line in kept if noncentrality(line) >= 100], right),
        "verdicts": dict(Counter(line["verdict"] for line in kept)),
    }


def outside(lines: Lines) -> dict[str, Any]:
    """Score effects that no library has, from 0.3 noise RMS on."""
    kept = [line for line in lines if size(line) >= 0.3]
    unknown = [line for line in kept if line["verdict"] == "unknown"]
    return {
        "declined": share(kept, lambda line: not given(line)),
        "right_axis": share(unknown, lambda line: line["axis"] == line["true_axis"]),
        "verdicts": dict(Counter(line["verdict"] for line in kept)),
        "axes": dict(Counter(f"{line['true_axis']} as {line['axis']}" for line in unknown)),
        "names": dict(Counter(f"{line['truth'][0]['name']} as {name}" for line in kept for name in given(line))),
    }


def curve(lines: Lines, by: Callable[[Line], float], edges: Sequence[float]) -> list[dict[str, Any]]:
    """Return how many are named rightly, from bin to bin."""
    found = []
    for low, high in pairwise(edges):
        part = [line for line in lines if low <= by(line) < high]
        found.append({"from": low, "to": high, "right": share(part, right), "wrong": share(part, wrong)})
    return found


def chances(lines: Lines) -> dict[str, Any]:
    """Return how often the p-value of the best effect is below a level where there is none: it should be the level."""
    # Where the best effect is far from the threshold, no p-value is worked out: such data sets count as above.
    values = np.array([1.0 if line["p_value"] is None else line["p_value"] for line in lines])
    return {f"{level:g}": rate(int((values <= level).sum()), len(values)) for level in (0.001, 0.01, 0.05)}


def coverage(lines: Lines) -> dict[str, Any]:
    """Return how often 95 % intervals of effects that were named rightly hold the truth."""
    parameters: list[bool] = []
    rms: list[bool] = []
    by_name: dict[str, list[bool]] = {}
    for line in filter(right, lines):
        effect, truth = line["effects"][0], line["truth"][0]
        for name, value in truth["parameters"].items():
            if name in effect["estimates"]:
                _, low, high = effect["estimates"][name]
                parameters.append(low <= value <= high)
                by_name.setdefault(f"{truth['name']}.{name}", []).append(parameters[-1])
        value, low, high = effect["estimates"]["size"]
        if value and len(line["effects"]) == 1:
            ends = sorted(abs(effect["rms"] * end / value) if end * value > 0 else 0.0 for end in (low, high))
            rms.append(ends[0] <= truth["rms"] <= ends[1])
    return {
        "parameters": rate(sum(parameters), len(parameters)),
        "contribution": rate(sum(rms), len(rms)),
        "by_parameter": {name: rate(sum(each), len(each)) for name, each in sorted(by_name.items())},
    }


def depths(lines: Lines) -> dict[str, Any]:
    """Return errors of depth of punctures and layers that were named rightly."""
    errors: dict[str, list[float]] = {}
    for line in filter(right, lines):
        where = line["truth"][0]["parameters"].get("depth_mm")
        if where is not None:
            found = line["effects"][0]["estimates"]["depth_mm"][0]
            errors.setdefault(line["truth"][0]["name"], []).append(abs(found - where))
    every = [value for each in errors.values() for value in each]
    return {"all": spread(every), **{name: spread(each) for name, each in sorted(errors.items())}}


def spread(values: Sequence[float | None]) -> dict[str, float | int | None]:
    """Return count, tenth, half and nine tenths of some values, and the greatest."""
    known = np.array([value for value in values if value is not None], float)
    known = known[np.isfinite(known)]
    if not known.size:
        return {"of": 0, "q10": None, "median": None, "q90": None, "most": None}
    ten, half, ninety = (float(each) for each in np.quantile(known, (0.1, 0.5, 0.9)))
    return {"of": int(known.size), "q10": ten, "median": half, "q90": ninety, "most": float(known.max())}


def confusion(lines: Lines, large: float) -> dict[str, dict[str, int]]:
    """Return what was said about what: one effect or one outside of the library from a size on, and none."""
    counts: dict[str, Counter[str]] = {}
    for line in lines:
        if line["stratum"] == "pair" or (line["stratum"] in ("single", "outside") and size(line) < large):
            continue
        what = "nothing" if line["stratum"] == "null" else hidden(line)[0]
        answer = " + ".join(line["names"]) if line["verdict"] == "named" else line["verdict"].upper()
        counts.setdefault(what, Counter())[answer] += 1
    return {what: dict(each) for what, each in sorted(counts.items())}


def by_effect(lines: Lines, large: float) -> dict[str, Any]:
    """Return for each effect how many from a size on are named rightly and wrongly, rich and poor."""
    found: dict[str, Any] = {}
    for name in sorted({hidden(line)[0] for line in lines}):
        own = [line for line in lines if hidden(line)[0] == name and size(line) >= large]
        found[name] = {
            variety: {"right": share([line for line in own if line["variety"] == variety], right),
                      "wrong": share([line for line in own if line["variety"] == variety], wrong)}
            for variety in VARIETIES
        }  # fmt: skip
    return found


def peers(lines: Lines, large: float) -> dict[str, Any]:
    """Return how the peers and we did on the same data sets."""
    known = [line for line in lines if line.get("peers")]
    if not known:
        return {}
    found: dict[str, Any] = {}
    for who in ("needleplan", *known[0]["peers"]):
        groups: dict[str, Any] = {}
        for name, kept in (
            ("null", [line for line in known if line["stratum"] == "null"]),
            ("single", [line for line in known if line["stratum"] == "single" and size(line) >= large]),
            ("pair", [line for line in known if line["stratum"] == "pair"]),
        ):
            sets = [(set(given(line)) if who == "needleplan" else set(line["peers"][who]), line) for line in kept]
            groups[name] = {
                "exact": rate(sum(each == set(hidden(line)) for each, line in sets), len(sets)),
                "names": float(np.mean([len(each) for each, _ in sets])) if sets else None,
            }
        found[who] = groups
    return found
