"""Statistics of the outcomes of a campaign: rates with bounds, power curves, calibration, confusion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import beta

Line = dict[str, Any]
Lines = Sequence[Line]

# Heterogeneity standard deviations of the tissue (shares).
LEVELS = (0.0, 0.03, 0.10)
VARIETIES = ("rich", "poor")
# Edges of the bins of the power curves: sizes (multiples of the noise RMS) and noncentralities.
SIZES = (0.0, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0, 10.0, 50.0)
NONCENTRALITIES = (0.0, 10.0, 30.0, 60.0, 100.0, 300.0, 1000.0, 3000.0, 1e9)
# Verdicts that report no effect, and verdicts that give a name.
QUIET = ("none", "underpowered")
NAMING = ("named", "incomplete")


def rate(hits: int, of: int) -> dict[str, float | int | None]:
    """Return hits / of with its 95 % Clopper-Pearson bounds; rate and bounds are None if `of` is 0."""
    if not of:
        return {"hits": 0, "of": 0, "rate": None, "low": None, "high": None}
    low = float(beta.ppf(0.025, hits, of - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, of - hits)) if hits < of else 1.0
    return {"hits": hits, "of": of, "rate": hits / of, "low": low, "high": high}


def share(lines: Iterable[Line], true: Callable[[Line], bool]) -> dict[str, float | int | None]:
    """Return the rate of the outcomes for which `true` holds."""
    each = [true(line) for line in lines]
    return rate(sum(each), len(each))


def given(line: Line) -> list[str]:
    """Return the effects that the diagnosis names; empty if its verdict gives no name."""
    return list(line["names"]) if line["verdict"] in NAMING else []


def hidden(line: Line) -> list[str]:
    """Return the names of the hidden effects."""
    return [each["name"] for each in line["truth"]]


def right(line: Line) -> bool:
    """Whether the verdict is NAMED and its names are the hidden effects. Several bumps count as one name."""
    return line["verdict"] == "named" and set(line["names"]) == set(hidden(line))


def wrong(line: Line) -> bool:
    """Whether the diagnosis names an effect that was not hidden."""
    return bool(set(given(line)) - set(hidden(line)))


def size(line: Line) -> float:
    """Return the size of the smallest hidden effect as a multiple of the noise RMS; 0 without an effect."""
    return min((each["size"] for each in line["truth"]), default=0.0)


def noncentrality(line: Line) -> float:
    """Return the smallest noncentrality of the hidden effects after the fit of the base; 0 without an effect."""
    return min((each["noncentrality"] for each in line["truth"]), default=0.0)


def pick(lines: Lines, stratum: str, **equal: Any) -> list[Line]:
    """Return the outcomes of a stratum whose fields have the values `equal`; a value of None matches all."""
    return [
        line for line in lines
        if line["stratum"] == stratum and all(line[key] == value for key, value in equal.items() if value is not None)
    ]  # fmt: skip


def summary(lines: Lines, large: float = 1.0) -> dict[str, Any]:
    """Return all statistics of a complete or partial run; effects of at least the size `large` should be named."""
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
        "coverage": {f"{level:g}": coverage(pick(lines, "single", heterogeneity=level)) for level in LEVELS},
        "depth_mm": depths(pick(lines, "single")),
        "seconds": {"cpu": spread([line["cpu_s"] for line in lines]),
                    "wall": spread([line["wall_s"] for line in lines])},
        "confusion": confusion(lines, large),
        "by_effect": by_effect(pick(lines, "single"), large),
        "peers": peers(lines, large),
    }  # fmt: skip


def nulls(lines: Lines) -> dict[str, Any]:
    """Return the statistics of data sets without a hidden effect."""
    return {
        "falsely_named": share(lines, lambda line: bool(given(line))),
        "flagged": share(lines, lambda line: line["verdict"] not in QUIET),
        "names": dict(Counter(name for line in lines for name in given(line))),
        "level_found": spread([line["level"] for line in lines]),
    }


def singles(lines: Lines, large: float) -> dict[str, Any]:
    """Return the statistics of data sets with one effect of at least the size `large`; `precision` is of all sizes."""
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
    """Return the statistics of data sets with two effects of at least 0.2 noise RMS and a ratio of sizes below 4."""
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
    """Return the statistics of data sets with an effect outside the library, of at least 0.3 noise RMS."""
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
    """Return for each bin of `by` the rates of right and of wrong names."""
    found = []
    for low, high in pairwise(edges):
        part = [line for line in lines if low <= by(line) < high]
        found.append({"from": low, "to": high, "right": share(part, right), "wrong": share(part, wrong)})
    return found


def coverage(lines: Lines) -> dict[str, Any]:
    """Return the coverage of the 95 % intervals of correctly named effects."""
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
    """Return the quantiles of the depth errors (mm) of correctly named punctures and layers: all, and by effect."""
    errors: dict[str, list[float]] = {}
    for line in filter(right, lines):
        where = line["truth"][0]["parameters"].get("depth_mm")
        if where is not None:
            found = line["effects"][0]["estimates"]["depth_mm"][0]
            errors.setdefault(line["truth"][0]["name"], []).append(abs(found - where))
    every = [value for each in errors.values() for value in each]
    return {"all": spread(every), **{name: spread(each) for name, each in sorted(errors.items())}}


def spread(values: Sequence[float | None]) -> dict[str, float | int | None]:
    """Return count, 10 % quantile, median, 90 % quantile and maximum of the finite values."""
    known = np.array([value for value in values if value is not None], float)
    known = known[np.isfinite(known)]
    if not known.size:
        return {"of": 0, "q10": None, "median": None, "q90": None, "most": None}
    ten, half, ninety = (float(each) for each in np.quantile(known, (0.1, 0.5, 0.9)))
    return {"of": int(known.size), "q10": ten, "median": half, "q90": ninety, "most": float(known.max())}


def confusion(lines: Lines, large: float) -> dict[str, dict[str, int]]:
    """Return by hidden effect the counts of the answers; effects smaller than `large` and pairs are left out."""
    counts: dict[str, Counter[str]] = {}
    for line in lines:
        if line["stratum"] == "pair" or (line["stratum"] in ("single", "outside") and size(line) < large):
            continue
        what = "nothing" if line["stratum"] == "null" else hidden(line)[0]
        answer = " + ".join(line["names"]) if line["verdict"] == "named" else line["verdict"].upper()
        counts.setdefault(what, Counter())[answer] += 1
    return {what: dict(each) for what, each in sorted(counts.items())}


def by_effect(lines: Lines, large: float) -> dict[str, Any]:
    """Return by effect the rates of right and wrong names for rich and poor motion, from the size `large` on."""
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
    """Return the results of needleplan and of each peer on the same data sets; empty if no peer was run."""
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
