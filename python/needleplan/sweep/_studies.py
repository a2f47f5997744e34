"""Studies of a table set: maps over two parameters, entries, trade-offs, sensitivities, and wrong parameters.

Sensitivities are those of an additive model y = m + sum_p f_p(value of p) + rest, fitted by least squares to n tables.
In a product design f_p has a free value for each of the L_p values: k_p = L_p - 1 coefficients. In a list or a sample
f_p is a quadratic polynomial, k_p = 2 (1 if there are two values); texts and lists have free values. The share of p is
the variance of f_p divided by that of y; its effect is the range of f_p. What interactions contribute is in no share.

How many tables: the model has K = 1 + sum_p k_p coefficients. In a complete product the f_p are orthogonal, the shares
are those of an analysis of variance and exact, and any number of values will do; a parameter that varies alone has the
share 1. Otherwise n > K is required, since with n = K the model fits any y without a rest, and the columns of the f_p
must be linearly independent, since otherwise the f_p are not unique. What is not additive then acts as noise of the
variance s^2 = |rest|^2 / (n - K), and a parameter without effect gets the share

    s^2 trace(C_p X_p' X_p) / |y - mean(y)|^2

on average (`ParameterEffect.chance`), where X_p are the columns of f_p and C_p their block of (X' X)^-1; it is about
k_p / (n - 1) of the share that is not additive.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from needleplan.artifacts import CallRepr, ShortRepr
from needleplan.config import plain
from needleplan.errors import Mistake, SweepError
from needleplan.planning import PolicyTable
from needleplan.sweep._study_rules import (
    has_quantity,
    key_of,
    levels_of,
    quantity_of,
    require_grid,
    require_made,
    require_names,
    require_others_fixed,
    require_quantity,
)
from needleplan.sweep._sweep import Design
from needleplan.sweep._table_set import TableSet, TableSetEntry

__all__ = [
    "GOALS",
    "ParameterEffect",
    "QuantityMap",
    "TableSetEntryMap",
    "WrongParameter",
    "entry_map",
    "pareto_candidates",
    "pareto_front",
    "quantity_map",
    "sensitivities",
    "wrong_parameters",
]

GOALS = {"success": 1, "clearance_mm": 1, "length_mm": -1, "turns": -1}
"""Quantities of the trade-off: 1 if more is better, -1 if less is better."""


@dataclass(frozen=True)
class QuantityMap(ShortRepr):
    """A quantity over two parameters: `values` has the shape (len(y), len(x)); missing ones are NaN."""

    x: tuple[Any, ...]
    y: tuple[Any, ...]
    values: NDArray[np.float64]


@dataclass(frozen=True)
class TableSetEntryMap(ShortRepr):
    """Success over the entry position and one parameter: `success` has the shape (len(levels), len(position_mm))."""

    levels: tuple[Any, ...]
    position_mm: NDArray[np.float64]
    success: NDArray[np.float64]


@dataclass(frozen=True)
class ParameterEffect(CallRepr):
    """Effect of one parameter on a quantity: range of its main effect, and its share of the variance.

    `chance` is the share that a parameter without effect would have on average; 0 in a complete product.
    """

    name: str
    effect: float
    share: float
    levels: tuple[Any, ...]
    main_effect: tuple[float, ...]
    chance: float = 0.0


@dataclass(frozen=True)
class WrongParameter(CallRepr):
    """A plan that was made for other values than the true ones: its realised success, and that of the right plan.

    The intervals are 95 % confidence intervals (Wilson).
    """

    values: dict[str, Any]
    success: float
    replanned: float
    success_interval: tuple[float, float]
    replanned_interval: tuple[float, float]


def quantity_map(table_set: TableSet, x: str, y: str, quantity: str = "success") -> QuantityMap:
    """Return a quantity over two parameters.

    Parameters
    ----------
    table_set : TableSet
        Table set with one table for each combination of the values of `x` and `y`; all other parameters have one value.
    x : str
        Name of the parameter along the columns.
    y : str
        Name of the parameter along the rows.
    quantity : str, default "success"
        Name of a quantity, a key of `QUANTITIES`.

    Returns
    -------
    QuantityMap
        Values, shape (values of y, values of x); NaN where a table does not have the quantity.

    Raises
    ------
    SweepError
        A name is unknown, another parameter varies, combinations are missing, no table is made, or no table has the
        quantity.
    """
    require_names(table_set, (x, y))
    require_made(table_set, "map")
    require_quantity(table_set, quantity)
    require_others_fixed(table_set, "map", (x, y))
    require_grid(table_set, "map", (x, y))
    xs, ys = levels_of(table_set, x), levels_of(table_set, y)
    values = np.full((len(ys), len(xs)), math.nan)
    for entry in table_set:
        values[ys.index(key_of(entry.values[y])), xs.index(key_of(entry.values[x]))] = quantity_of(entry, quantity)
    return QuantityMap(xs, ys, values)


def entry_map(table_set: TableSet, parameter: str) -> TableSetEntryMap:
    """Return the success of the best heading over the entry position and one parameter.

    Tables that are not made yet are left out.

    Parameters
    ----------
    table_set : TableSet
        Table set in the plane in which no other parameter varies.
    parameter : str
        Name of the parameter.

    Returns
    -------
    TableSetEntryMap
        Rows in the order of the values of the parameter.

    Raises
    ------
    SweepError
        The name is unknown, another parameter varies, the tables are in 3D, no table is made, or their edges differ in
        length or grid.
    """
    require_names(table_set, (parameter,))
    if table_set.sweep.in_space:
        raise SweepError(Mistake("study", "entries", "is for scenarios in a plane; `needleplan entry` maps an anatomy"))
    require_made(table_set, "entries")
    require_others_fixed(table_set, "entries", (parameter,))
    require_grid(table_set, "entries", (parameter,))
    profiles = {key_of(entry.values[parameter]): entry.record["profile"] for entry in table_set if entry.record}
    levels = tuple(level for level in levels_of(table_set, parameter) if level in profiles)
    positions = {tuple(profile["position_mm"]) for profile in profiles.values()}
    if len(positions) != 1:
        rule = f"needs edges of the same length and grid; {parameter} changes them. Select one value with --select"
        raise SweepError(Mistake("study", "entries", rule))
    success = [[math.nan if each is None else each for each in profiles[level]["success"]] for level in levels]
    return TableSetEntryMap(levels, np.array(next(iter(positions))), np.array(success))


def pareto_front(table_set: TableSet, goals: Mapping[str, int] = GOALS) -> list[TableSetEntry]:
    """Return the tables that no other table beats: in all goals at least as good and in one better.

    Tables whose path without noise misses the target are left out. A goal that no table has is ignored, such as the
    clearance in a scenario without obstacles.

    Parameters
    ----------
    table_set : TableSet
        Table set, or a selection of it.
    goals : mapping, optional
        For each quantity, 1 if more is better, -1 if less is better.

    Returns
    -------
    list of TableSetEntry

    Raises
    ------
    SweepError
        A goal is unknown, no table is made, or no path without noise reaches the target.
    """
    require_made(table_set, "pareto")
    goals = {name: sign for name, sign in goals.items() if has_quantity(table_set, name)}
    known = pareto_candidates(table_set, goals)
    if not known:
        rule = f"none of the {len(table_set)} tables has a path without noise that reaches the target"
        raise SweepError(Mistake("study", "pareto", rule))
    points = np.array([[sign * quantity_of(entry, name) for name, sign in goals.items()] for entry in known])
    return [
        entry
        for entry, point in zip(known, points, strict=True)
        if not ((points >= point).all(axis=1) & (points > point).any(axis=1)).any()
    ]


def pareto_candidates(table_set: TableSet, goals: Iterable[str] = tuple(GOALS)) -> list[TableSetEntry]:
    """Return the tables that `pareto_front` compares.

    Their path without noise reaches the target, and they have all goals that any table has.

    Parameters
    ----------
    table_set : TableSet
        Table set, or a selection of it.
    goals : iterable of str, optional
        Names of quantities.

    Returns
    -------
    list of TableSetEntry
    """
    names = [name for name in goals if has_quantity(table_set, name)]
    reached = [entry for entry in table_set if entry.record and entry.record["reached"]]
    return [entry for entry in reached if all(math.isfinite(quantity_of(entry, name)) for name in names)]


def sensitivities(table_set: TableSet, quantity: str = "success") -> list[ParameterEffect]:
    """Return the effects of all varied parameters on a quantity, the largest share of the variance first.

    Parameters
    ----------
    table_set : TableSet
        Table set, or a selection of it.
    quantity : str, default "success"
        Name of a quantity, a key of `QUANTITIES`.

    Returns
    -------
    list of ParameterEffect

    Raises
    ------
    SweepError
        The quantity is unknown, no parameter varies, or the effects cannot be separated: parameters change together, or
        an incomplete design has no more tables than the additive model has coefficients.
    """
    require_made(table_set, "sensitivity")
    require_quantity(table_set, quantity)
    rows = [entry for entry in table_set if math.isfinite(quantity_of(entry, quantity))]
    y = np.array([quantity_of(row, quantity) for row in rows])
    product = table_set.sweep.design is Design.PRODUCT
    bases = {name: _basis([row.values[name] for row in rows], product) for name in table_set.parameters}
    bases = {name: basis for name, basis in bases.items() if basis.shape[1]}
    if not bases:
        raise SweepError(Mistake("study", "sensitivity", f"no parameter varies in the {len(rows)} tables"))
    design = np.column_stack([np.ones(len(rows)), *bases.values()])
    complete = product and _is_grid([tuple(key_of(row.values[name]) for name in bases) for row in rows])
    if not complete:
        _require_separable(bases, design, quantity)
    solution = np.linalg.lstsq(design, y, rcond=None)[0]
    rest = float(np.sum((y - design @ solution) ** 2))
    total = float(np.sum((y - y.mean()) ** 2))
    covariance = np.linalg.pinv(design.T @ design) * (0.0 if complete else rest / (len(rows) - design.shape[1]))
    effects, first = [], 1
    for name, basis in bases.items():
        columns = slice(first, first + basis.shape[1])
        first = columns.stop
        main = basis @ solution[columns]
        order = dict(zip([key_of(row.values[name]) for row in rows], main.tolist(), strict=True))
        levels = tuple(level for level in levels_of(table_set, name) if level in order)
        share, chance = (
            (float(np.sum(main**2)) / total, float(np.sum(covariance[columns, columns] * (basis.T @ basis))) / total)
            if total > 0
            else (0.0, 0.0)
        )
        values = tuple(order[level] for level in levels)
        effects.append(ParameterEffect(name, float(np.ptp(main)), share, levels, values, chance))
    return sorted(effects, key=lambda effect: -effect.share)


def wrong_parameters(table_set: TableSet, runs: int = 2000, seed: int = 0, **planned: Any) -> list[WrongParameter]:
    """Execute one plan in the scenarios of all tables, and compare its success with that of the plan made for each.

    The study shows what a wrong assumption about a parameter costs. Each plan starts at its own best entry. Actions are
    those of the nearest state, because a look one step ahead would use the true scenario. Tables whose grid differs
    from the grid of the executed plan are left out.

    Parameters
    ----------
    table_set : TableSet
        Table set in the plane that keeps its tables.
    runs : int, default 2000
        Number of simulated executions of each plan.
    seed : int, default 0
        Seed of the simulated noise.
    **planned
        Values of parameters that select the executed plan: exactly one table.

    Returns
    -------
    list of WrongParameter
        One comparison for each table with the same grid.

    Raises
    ------
    SweepError
        The tables are in 3D, `planned` does not select one table, or the sweep keeps records only.
    """
    if table_set.sweep.in_space:
        raise SweepError(Mistake("study", "mismatch", "is for scenarios in a plane"))
    plan = cast("PolicyTable", table_set.table(**planned))
    comparisons = []
    for entry in table_set:
        if entry.record is None:
            continue
        right = cast("PolicyTable", entry.table())  # raises SweepError if the sweep keeps records only
        if right.scenario.shape != plan.scenario.shape:
            continue
        transferred = PolicyTable(plan.values, plan.policy, plan.success, plan.stats, right.scenario)
        edge = entry.record["edge"]
        wrong = transferred.rollout(plan.best_entry(edge, nearest=True).pose, runs, seed, nearest=True)
        replanned = right.rollout(right.best_entry(edge, nearest=True).pose, runs, seed, nearest=True)
        comparisons.append(
            WrongParameter(entry.values, wrong.success, replanned.success, wrong.interval, replanned.interval)
        )
    return comparisons


def _basis(values: Sequence[Any], product: bool) -> NDArray[np.float64]:
    """Return the columns of the main effect of a parameter, each with mean 0."""
    numbers = [plain(value) for value in values]
    if product or any(number is None for number in numbers):
        keys = [key_of(value) for value in values]
        levels = list(dict.fromkeys(keys))
        columns = np.array([[float(key == level) for level in levels[1:]] for key in keys]).reshape(len(keys), -1)
    else:
        x = np.array(numbers, float)
        scaled = (x - x.mean()) / (np.ptp(x) or 1.0)
        powers = min(2, len(set(x.tolist())) - 1)  # two values determine a straight line, one value nothing
        columns = np.column_stack([np.empty((len(x), 0)), *(scaled**power for power in range(1, powers + 1))])
    return np.asarray(columns - columns.mean(axis=0))


def _is_grid(points: Sequence[tuple[Any, ...]]) -> bool:
    """Return whether each combination of the values in the points is exactly one of the points."""
    return len(set(points)) == len(points) == math.prod(len(set(values)) for values in zip(*points, strict=True))


def _require_separable(bases: Mapping[str, NDArray[np.float64]], design: NDArray[np.float64], quantity: str) -> None:
    """Raise SweepError unless an additive model has one solution and leaves a rest."""
    tables, count = design.shape
    if tables < count + 1:
        sizes = " + ".join(["1", *(f"{basis.shape[1]} ({name})" for name, basis in bases.items())])
        rule = (
            f"needs at least {count + 1} tables with a {quantity}, one more than the additive model has coefficients: "
            f"{sizes} = {count}; there are {tables}. Make more tables, or fix parameters with --select"
        )
        raise SweepError(Mistake("study", "sensitivity", rule))
    rank = int(np.linalg.matrix_rank(design))
    if rank == count:
        return
    mixed = [
        name
        for name in bases
        if rank - 1 - np.linalg.matrix_rank(np.column_stack([basis for key, basis in bases.items() if key != name]))
        < bases[name].shape[1]
    ]
    rule = f"the values of {', '.join(mixed)} change together in the {tables} tables: their effects cannot be separated"
    raise SweepError(Mistake("study", "sensitivity", rule))
