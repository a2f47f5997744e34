"""The goals of the diagnosis compared with the measured values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

LEVELS = ("0", "0.03", "0.1")
ENOUGH = 20
"""Number of data sets below which a share is marked as uncertain."""


@dataclass(frozen=True)
class Goal:
    """A goal and the measured value from `of` data sets. `reached` is None if there is no measured value."""

    what: str
    goal: str
    measured: str
    of: int
    reached: bool | None


def goals(found: dict[str, Any], seconds_of_preparation: float | None) -> list[Goal]:
    """Compare a summary of the axial force with all its goals."""
    return [*_named(found), *_others(found), *_costs(found, seconds_of_preparation), *_against_peers(found)]


def tip_goals(found: dict[str, Any], seconds_of_preparation: float | None) -> list[Goal]:
    """Compare a summary of the path of the tip with its goals, which are fewer than those of the axial force."""
    listed = []
    for level in LEVELS:
        null, single = found["null"][f"rich {level}"], found["single"][f"rich {level}"]
        text = f"rich motion, {_percent(level)}"
        listed.append(_share(f"no effect hidden, {text}: falsely named", null["falsely_named"], 0.01, at_most=True))
        listed.append(_share(f"named and right, from 5 sigma of the tracker, {text}", single["right"], 0.90))
        listed.append(_share(f"wrong name, from 5 sigma, {text}", single["wrong"], 0.04, at_most=True))
    return [*listed, *_costs(found, seconds_of_preparation)]


def _named(found: dict[str, Any]) -> Iterator[Goal]:
    for level, most in zip(LEVELS, (0.0, 0.0, 0.015), strict=True):
        yield _share(f"no effect hidden, {_percent(level)}: falsely named", found["null"][f"rich {level}"][
            "falsely_named"], most, at_most=True)  # fmt: skip
    for variety, least in (("rich", (0.97, 0.90, 0.78)), ("poor", (0.90, 0.80, 0.68))):
        for level, each in zip(LEVELS, least, strict=True):
            text = f"named and right, from 1 noise RMS, {variety} motion, {_percent(level)}"
            yield _share(text, found["single"][f"{variety} {level}"]["right"], each)
    for variety in ("rich", "poor"):
        for level, most in zip(LEVELS, (0.01, 0.03, 0.04), strict=True):
            text = f"wrong name, from 1 noise RMS, {variety} motion, {_percent(level)}"
            yield _share(text, found["single"][f"{variety} {level}"]["wrong"], most, at_most=True)


def _others(found: dict[str, Any]) -> Iterator[Goal]:
    yield _share(
        "outside the library, from 0.3 noise RMS: not falsely named", found["outside"]["all"]["declined"], 0.92
    )
    yield _share("outside the library, called unknown: right axis", found["outside"]["all"]["right_axis"], 0.78)
    yield _share("two effects, 0 %: exact set", found["pair"]["0"]["exact"], 0.82)
    text = "two effects, 0 %, the base leaves a noncentrality of 100 of both: exact set"
    yield _share(text, found["pair"]["0"]["exact_where_left"], 0.82)
    yield _share("two effects, 0 %: strongest named", found["pair"]["0"]["strongest"], 0.97)
    yield _share("two effects, 0 %: false extra", found["pair"]["0"]["false_extra"], 0.04, at_most=True)
    for level in LEVELS:
        each = found["single"][f"rich {level}"]["shrink"]
        text = f"held-out gap closed, from 1 noise RMS, rich motion, {_percent(level)}"
        yield _value(f"{text}: median", each["median"], each["of"], 0.92)
        yield _value(f"{text}: 10 % quantile", each["q10"], each["of"], 0.77)
    for level, least in zip(LEVELS, (0.92, 0.92, 0.88), strict=True):
        each = found["coverage"][level]["parameters"]
        reached = None if each["rate"] is None else least <= each["rate"] <= 0.98
        if level == "0.1" and each["rate"] is not None:
            reached = each["rate"] >= least
        text = f"95 % intervals of parameters hold the truth, {_percent(level)}"
        yield Goal(text, f"{least:.0%} to 98 %" if level != "0.1" else f"at least {least:.0%}",
                   _shown(each), each["of"], reached)  # fmt: skip
    each = found["depth_mm"]["all"]
    yield _value("depth of puncture or layer: median error in mm", each["median"], each["of"], 0.5, at_most=True)


def _costs(found: dict[str, Any], seconds_of_preparation: float | None) -> Iterator[Goal]:
    each = found["seconds"]["cpu"]
    yield _value("seconds of processor time a data set: median", each["median"], each["of"], 1.0, at_most=True)
    if seconds_of_preparation is not None:
        yield _value("seconds of processor time to prepare", seconds_of_preparation, 1, 10.0, at_most=True)


def _against_peers(found: dict[str, Any]) -> Iterator[Goal]:
    for group in ("single", "pair"):
        if not found["peers"]:
            continue
        ours = found["peers"]["needleplan"][group]["exact"]
        others = {who: each[group]["exact"]["rate"] for who, each in found["peers"].items() if who != "needleplan"}
        if ours["rate"] is None or None in others.values():
            continue
        best = max(others, key=lambda who: others[who])
        text = f"exact set, {group}: at least twice the best peer"
        measured = f"{ours['rate']:.1%} against {others[best]:.1%} ({best})"
        yield Goal(text, "2 times", measured, ours["of"], ours["rate"] >= 2 * others[best])


def _share(what: str, each: dict[str, Any], goal: float, *, at_most: bool = False) -> Goal:
    text = f"at {'most' if at_most else 'least'} {goal:.3g}"
    if each["rate"] is None:
        return Goal(what, text, "no data", 0, None)
    return Goal(what, text, _shown(each), each["of"], each["rate"] <= goal if at_most else each["rate"] >= goal)


def _value(what: str, each: float | None, of: int, goal: float, *, at_most: bool = False) -> Goal:
    text = f"at {'most' if at_most else 'least'} {goal:.3g}"
    if each is None:
        return Goal(what, text, "no data", 0, None)
    return Goal(what, text, f"{each:.3g}", of, each <= goal if at_most else each >= goal)


def _shown(each: dict[str, Any]) -> str:
    if each["rate"] is None:
        return "no data"
    return f"{each['hits']}/{each['of']} = {each['rate']:.1%} ({each['low']:.1%} to {each['high']:.1%})"


def _percent(level: str) -> str:
    return f"{100 * float(level):g} % heterogeneity"
