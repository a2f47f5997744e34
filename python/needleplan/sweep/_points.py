"""The points of a sweep: combinations of values, and the scenario of each."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from needleplan.anatomy import AnatomyFile
from needleplan.config import Violation, shown, suggestion
from needleplan.errors import Mistake, SweepError
from needleplan.scenario import Scenario
from needleplan.sweep._problems import SweptProblem, SweptProblems
from needleplan.sweep._sweep import Design, Sweep
from needleplan.sweep._swept_parameter import SweptParameter

__all__ = ["SweepPoint", "points_of", "scenario_with"]

# Names of coordinates, by which keys such as `target.center_mm.x` address the numbers of a pair.
_COORDINATES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class SweepPoint:
    """One combination of values.

    `values` maps the names of the parameters to their values. `scenario` is None if the values contradict a rule;
    `why` then tells the rule. `identity` is the same for equal scenarios on all machines.
    """

    values: dict[str, Any]
    scenario: Scenario | AnatomyFile | None
    identity: str = ""
    why: str = ""


def points_of(sweep: Sweep, problems: SweptProblems) -> Iterator[SweepPoint]:
    """Yield the points of a sweep in the order of its design: the last parameter varies fastest.

    Raises SweepError if no scenario has a key of a parameter, or two parameters change the same key, and ScenarioError
    if a volume cannot be read.
    """
    _require_keys(sweep, problems)
    _require_separate_keys(sweep, problems)
    titles = [parameter.title for parameter in sweep.parameters]
    for values in _combinations(sweep):
        named = dict(zip(titles, values, strict=True))
        try:
            problem = problems.of(named)
            scenario = _changed(problem, sweep, named)
        except Violation as broken:
            yield SweepPoint(named, None, why="; ".join(map(str, broken.mistakes)))
        else:
            yield SweepPoint(named, scenario, problem.identity(scenario))


def scenario_with(problems: SweptProblems, sweep: Sweep, values: Mapping[str, Any]) -> Scenario | AnatomyFile | None:
    """Return the problem with the values of one point by name, or None if they break a rule."""
    try:
        return _changed(problems.of(values), sweep, values)
    except Violation:
        return None


def _changed(problem: SweptProblem, sweep: Sweep, values: Mapping[str, Any]) -> Scenario | AnatomyFile:
    """Return the problem with the values of one point by name. Raises Violation if they break a rule."""
    changed = problem.raw
    for parameter in sweep.parameters:
        if parameter.is_file:
            continue
        try:
            changed = _with(changed, parameter.scenario_key.split("."), values[parameter.title])
        except KeyError as missing:  # several files may have different obstacles
            raise Violation(f"{parameter.scenario_key} {missing.args[0]}") from None
    return problem.changed(changed)


def _combinations(sweep: Sweep) -> Iterator[tuple[Any, ...]]:
    if sweep.design is Design.PRODUCT:
        yield from itertools.product(*(parameter.levels for parameter in sweep.parameters))
    elif sweep.design is Design.LIST:
        yield from zip(*(parameter.levels for parameter in sweep.parameters), strict=True)
    else:
        from scipy.stats import qmc

        sampler = qmc.LatinHypercube(len(sweep.parameters), seed=sweep.seed)
        for shares in sampler.random(sweep.tables).tolist():
            yield tuple(parameter.at(share) for parameter, share in zip(sweep.parameters, shares, strict=True))


def _require_keys(sweep: Sweep, problems: SweptProblems) -> None:
    """Raise SweepError with a mistake for each key that no scenario of the sweep has."""
    mistakes = []
    for number, parameter in enumerate(sweep.parameters, start=1):
        if parameter.is_file:
            continue
        rules = [_missing(problem, parameter) for problem in problems.all]
        if all(rules):
            mistakes.append(Mistake(f"parameter {number}.key", shown(parameter.scenario_key), rules[0]))
    if mistakes:
        raise SweepError(mistakes)


def _missing(problem: SweptProblem, parameter: SweptParameter) -> str:
    """Return why a problem does not have the key of a parameter, or an empty text if it has."""
    try:
        problem.changed(_with(problem.raw, parameter.scenario_key.split("."), parameter.at(0.0)))
    except KeyError as missing:
        return str(missing.args[0])
    except Violation as broken:  # a wrong value is no wrong key
        return next((mistake.rule for mistake in broken.mistakes if mistake.rule.startswith("unknown key")), "")
    return ""


def _require_separate_keys(sweep: Sweep, problems: SweptProblems) -> None:
    """Raise SweepError if a parameter changes a key, or a part of it, that an earlier parameter changes too."""
    mistakes = []
    for number, parameter in enumerate(sweep.parameters, start=1):
        for earlier in sweep.parameters[: number - 1]:
            if any(_overlap(problem.raw, parameter.scenario_key, earlier.scenario_key) for problem in problems.all):
                rule = f"changes what {shown(earlier.scenario_key)} changes: give one parameter for both"
                mistakes.append(Mistake(f"parameter {number}.key", shown(parameter.scenario_key), rule))
    if mistakes:
        raise SweepError(mistakes)


def _overlap(raw: Mapping[str, Any], one: str, other: str) -> bool:
    """Return whether two keys address the same place, or one a part of the other; entries have names and numbers."""
    try:
        places = [list(_places(raw, key.split("."))) for key in (one, other)]
    except KeyError:
        return False
    length = min(map(len, places))
    return places[0][:length] == places[1][:length]


def _places(node: Any, parts: Sequence[str]) -> Iterator[str | int]:
    """Yield the parts of a key, with the positions of entries of lists instead of their names."""
    for part in parts:
        if isinstance(node, list):
            position = _position(node, part)
            yield position
            node = node[position]
        else:
            yield part
            node = node.get(part) if isinstance(node, Mapping) else None


def _with(node: Any, parts: list[str], value: Any) -> Any:
    """Return a copy of a raw table in which the key with these parts has a value. Raises KeyError with the reason."""
    if not parts:
        return value
    head, *rest = parts
    if isinstance(node, Mapping):
        if rest and head not in node:
            raise KeyError(f"has no table {shown(head)}{suggestion(head, node)}")
        return {**node, head: _with(node.get(head), rest, value)}
    if not isinstance(node, list):
        raise KeyError(f"has no key {shown(head)} in a value that is no table")
    position = _position(node, head)
    return [*node[:position], _with(node[position], rest, value), *node[position + 1 :]]


def _position(entries: list[Any], name: str) -> int:
    """Return the position of an entry by its name, its number from 1 or its coordinate. Raises KeyError."""
    names = [entry.get("name", "") if isinstance(entry, Mapping) else "" for entry in entries]
    if name in names:
        return names.index(name)
    position = int(name) - 1 if name.isdecimal() else _COORDINATES.get(name, -1)
    if isinstance(entries[0] if entries else None, Mapping) and name in _COORDINATES:
        position = -1
    if not 0 <= position < len(entries):
        known = [text for text in names if text]
        raise KeyError(f"has no entry {shown(name)} (entries are named, or numbered from 1){suggestion(name, known)}")
    return position
