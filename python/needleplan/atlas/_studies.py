"""Studies of an atlas: maps over two parameters, entries, trade-offs, sensitivities and the price of a wrong parameter.

Sensitivities are those of an additive model y = m + sum_p f_p(value of p) + rest, fitted by least squares: f_p has a
free value for each level of a product design, and is a quadratic polynomial in a sampled design. The share of p is the
variance of f_p divided by that of y; its effect is the range of f_p. What interactions contribute is in no share.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needleplan.atlas._atlas import Atlas, AtlasEntry
from needleplan.atlas._sweep import Design
from needleplan.config import plain, suggestion
from needleplan.errors import AtlasError, Mistake
from needleplan.planning import PolicyTable

__all__ = [
    "GOALS",
    "QUANTITIES",
    "EntryMapOfAtlas",
    "ParameterEffect",
    "QuantityMap",
    "WrongParameter",
    "entry_map",
    "pareto_front",
    "quantity_map",
    "sensitivities",
    "wrong_parameters",
]

QUANTITIES = {
    "success": "success probability of the best entry",
    "start_success": "success probability of the fixed entry",
    "cost": "expected cost of the best entry",
    "clearance_mm": "clearance of the path (mm)",
    "length_mm": "length of the path (mm)",
    "rotations": "rotations of the path",
    "seconds": "time of the solve (s)",
}
"""Quantities of a record that studies show, with their titles."""

GOALS = {"success": 1, "clearance_mm": 1, "length_mm": -1, "rotations": -1}
"""Quantities of the trade-off: 1 if more is better, -1 if less is better."""


@dataclass(frozen=True)
class QuantityMap:
    """A quantity over two parameters: `values` has the shape (len(y), len(x)); missing ones are NaN."""

    x: tuple[Any, ...]
    y: tuple[Any, ...]
    values: NDArray[np.float64]


@dataclass(frozen=True)
class EntryMapOfAtlas:
    """Success over the entry position and one parameter: `success` has the shape (len(levels), len(position_mm))."""

    levels: tuple[Any, ...]
    position_mm: NDArray[np.float64]
    success: NDArray[np.float64]


@dataclass(frozen=True)
class ParameterEffect:
    """Effect of one parameter on a quantity: range of its main effect, and its share of the variance."""

    name: str
    effect: float
    share: float
    levels: tuple[Any, ...]
    main_effect: tuple[float, ...]


@dataclass(frozen=True)
class WrongParameter:
    """A plan that was made for other values than the true ones: its realised success, and that of the right plan."""

    values: dict[str, Any]
    success: float
    replanned: float


def quantity_map(atlas: Atlas, x: str, y: str, quantity: str = "success") -> QuantityMap:
    """Return a quantity over two parameters; all other parameters must have one value.

    Raises AtlasError if a name is unknown, or several tables have the same two values.
    """
    _require_names(atlas, (x, y))
    _require_quantity(quantity)
    xs, ys = _levels(atlas, x), _levels(atlas, y)
    values = np.full((len(ys), len(xs)), math.nan)
    seen = set()
    for entry in atlas:
        place = ys.index(_key(entry.values[y])), xs.index(_key(entry.values[x]))
        if place in seen:
            others = ", ".join(name for name in atlas.parameters if name not in (x, y))
            raise AtlasError(Mistake("select", "", f"must leave one value of each other parameter: {others}"))
        seen.add(place)
        values[place] = _value(entry, quantity)
    return QuantityMap(xs, ys, values)


def entry_map(atlas: Atlas, parameter: str) -> EntryMapOfAtlas:
    """Return the success of the best heading over the entry position and one parameter.

    Raises AtlasError if the name is unknown, several tables have the same value, or their edges differ in length.
    """
    _require_names(atlas, (parameter,))
    if atlas.sweep.in_space:
        raise AtlasError(Mistake("study", "entries", "is for scenarios in a plane; `needleplan entry` maps an anatomy"))
    rows = [(_key(each.values[parameter]), each.record["profile"]) for each in atlas if each.record]
    levels = tuple(dict.fromkeys(level for level, _ in rows))
    if len(levels) != len(rows):
        others = ", ".join(name for name in atlas.parameters if name != parameter)
        raise AtlasError(Mistake("select", "", f"must leave one value of each other parameter: {others}"))
    positions = {tuple(profile["position_mm"]) for _, profile in rows}
    if len(positions) != 1:
        raise AtlasError(Mistake("select", "", "must leave tables whose edges have the same grid, and at least one"))
    success = [[math.nan if each is None else each for each in profile["success"]] for _, profile in rows]
    return EntryMapOfAtlas(levels, np.array(next(iter(positions))), np.array(success))


def pareto_front(atlas: Atlas, goals: Mapping[str, int] = GOALS) -> list[AtlasEntry]:
    """Return the tables that no other table beats: in all goals at least as good and in one better.

    Tables whose path without noise misses the target are left out.
    """
    for name in goals:
        _require_quantity(name)
    known = [each for each in atlas if each.record and each.record["reached"]]
    points = np.array([[sign * _value(each, name) for name, sign in goals.items()] for each in known])
    complete = [number for number, row in enumerate(points) if np.isfinite(row).all()]
    return [
        known[number]
        for number in complete
        if not any((points[k] >= points[number]).all() and (points[k] > points[number]).any() for k in complete)
    ]


def sensitivities(atlas: Atlas, quantity: str = "success") -> list[ParameterEffect]:
    """Return the effects of all parameters on a quantity, the largest share first.

    Raises AtlasError if fewer tables have the quantity than the additive model has coefficients.
    """
    _require_quantity(quantity)
    rows = [each for each in atlas if math.isfinite(_value(each, quantity))]
    y = np.array([_value(each, quantity) for each in rows])
    product = atlas.sweep.design is Design.PRODUCT
    bases = {name: _basis([each.values[name] for each in rows], product) for name in atlas.parameters}
    bases = {name: basis for name, basis in bases.items() if basis.shape[1]}
    count = 1 + sum(basis.shape[1] for basis in bases.values())
    if len(rows) < count + 1:
        rule = f"needs at least {count + 1} tables with a {quantity}; there are {len(rows)}"
        raise AtlasError(Mistake("study", "sensitivity", rule))
    design = np.column_stack([np.ones(len(rows)), *bases.values()])
    coefficients = np.linalg.lstsq(design, y, rcond=None)[0][1:]
    variance, effects = float(np.var(y)), []
    for name, basis in bases.items():
        own, coefficients = coefficients[: basis.shape[1]], coefficients[basis.shape[1] :]
        main = basis @ own
        order = dict(zip([_key(each.values[name]) for each in rows], main.tolist(), strict=True))
        levels = sorted(order, key=lambda level: (isinstance(level, str | tuple), level))
        share = float(np.var(main)) / variance if variance > 0 else 0.0
        effects.append(
            ParameterEffect(name, float(np.ptp(main)), share, tuple(levels), tuple(order[level] for level in levels))
        )
    return sorted(effects, key=lambda each: -each.share)


def wrong_parameters(atlas: Atlas, runs: int = 2000, seed: int = 0, **planned: Any) -> list[WrongParameter]:
    """Execute the plan for given values in the scenarios of all tables, and compare with the right plan there.

    Both are executed by the nearest state, since a look one step ahead would know the true scenario. The entry is the
    best one of the executed plan. `planned` selects one table. Raises AtlasError if it does not, and leaves out tables
    with another grid.
    """
    plan = atlas.table(**planned)
    if not isinstance(plan, PolicyTable):
        raise AtlasError(Mistake("study", "mismatch", "is for scenarios in a plane"))
    found = []
    for entry in atlas:
        if entry.record is None:
            continue
        right = entry.table()  # raises AtlasError if the sweep keeps records only
        if not isinstance(right, PolicyTable) or right.scenario.shape != plan.scenario.shape:
            continue
        meant = PolicyTable(plan.values, plan.policy, plan.success, plan.stats, right.scenario)
        start = plan.best_entry(entry.record["edge"], nearest=True)
        best = right.best_entry(entry.record["edge"], nearest=True)
        found.append(
            WrongParameter(
                entry.values,
                meant.rollout(start.pose, runs, seed, nearest=True).success,
                right.rollout(best.pose, runs, seed, nearest=True).success,
            )
        )
    return found


def _basis(values: Sequence[Any], product: bool) -> NDArray[np.float64]:
    """Return the columns of the main effect of a parameter, each with mean 0."""
    numbers = [plain(each) for each in values]
    if product or any(each is None for each in numbers):
        keys = [_key(each) for each in values]
        levels = list(dict.fromkeys(keys))
        columns = np.array([[float(key == level) for level in levels[1:]] for key in keys]).reshape(len(keys), -1)
    else:
        x = np.array(numbers, float)
        scaled = (x - x.mean()) / (np.ptp(x) or 1.0)
        columns = np.column_stack([scaled, scaled**2]) if np.ptp(x) else np.empty((len(x), 0))
    return np.asarray(columns - columns.mean(axis=0))


def _levels(atlas: Atlas, name: str) -> tuple[Any, ...]:
    keys = {_key(each.values[name]) for each in atlas}
    return tuple(sorted(keys, key=lambda level: (isinstance(level, str | tuple), level)))


def _key(value: Any) -> Any:
    return tuple(map(_key, value)) if isinstance(value, list | tuple) else value


def _value(entry: AtlasEntry, quantity: str) -> float:
    value = (entry.record or {}).get(quantity)
    return math.nan if value is None else float(value)


def _require_names(atlas: Atlas, names: Sequence[str]) -> None:
    known = ", ".join(atlas.parameters)
    mistakes = [
        Mistake("parameter", name, f"is no parameter of this atlas ({known}){suggestion(name, atlas.parameters)}")
        for name in names
        if name not in atlas.parameters
    ]
    if not mistakes and len(set(names)) < len(names):
        mistakes = [Mistake("parameter", names[0], "must differ from the other one")]
    if mistakes:
        raise AtlasError(mistakes)


def _require_quantity(quantity: str) -> None:
    if quantity not in QUANTITIES:
        rule = f"must be one of {', '.join(QUANTITIES)}{suggestion(quantity, QUANTITIES)}"
        raise AtlasError(Mistake("quantity", quantity, rule))
