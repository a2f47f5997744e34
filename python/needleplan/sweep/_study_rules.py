"""Rules that a selection of a table set must keep for a study, and the number of tables that a study is based on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from needleplan.config import shown, suggestion
from needleplan.errors import Mistake, SweepError
from needleplan.sweep._sweep import Design
from needleplan.sweep._table_set import TableSet, TableSetEntry

__all__ = [
    "QUANTITIES",
    "has_quantity",
    "key_of",
    "levels_of",
    "quantity_of",
    "require_grid",
    "require_made",
    "require_names",
    "require_others_fixed",
    "require_quantity",
    "selected",
    "tables_text",
    "varying",
]

QUANTITIES = {
    "success": "success probability of the best entry",
    "start_success": "success probability of the fixed entry",
    "cost": "expected cost of the best entry (cost units)",
    "clearance_mm": "clearance of the path (mm)",
    "length_mm": "length of the path (mm)",
    "turns": "turns of the path",
    "seconds": "time of the solve (s)",
}
"""Quantities of a record that studies show, with their titles."""

# Largest number of values of a parameter that a message lists; of more values, the message states the range.
_LISTED = 6


def selected(table_set: TableSet, values: Mapping[str, Any], option: str = "--select") -> TableSet:
    """Return the part of a table set with given values, as `TableSet.select` does.

    Parameters
    ----------
    table_set : TableSet
        Table set, or a selection of it.
    values : mapping
        Wanted values by name of the parameter; a pair (low, high) is a range.
    option : str, default "--select"
        Command line option that gave the values, for messages.

    Returns
    -------
    TableSet

    Raises
    ------
    SweepError
        A name is unknown, a range is reversed, or no table has the values. The message lists the existing values.
    """
    if any(name not in table_set.parameters for name in values):
        return table_set.select(**values)  # raises SweepError with a suggestion
    values = {name: int(value) if isinstance(value, bool) else value for name, value in values.items()}
    mistakes = []
    for name, value in values.items():
        given = f"{name}={_wanted(value)}"
        if isinstance(value, tuple) and value[0] > value[1]:
            mistakes.append(Mistake(option, given, f"a range is LOW:HIGH; write {value[1]:g}:{value[0]:g}"))
        elif not _has_value(table_set, name, value):
            mistakes.append(Mistake(option, given, f"no table has this value; {name} is {_values(table_set, name)}"))
    if mistakes:
        raise SweepError(mistakes)
    selection = table_set.select(**values)
    if not len(selection):
        given = ", ".join(f"{name}={_wanted(value)}" for name, value in values.items())
        raise SweepError(Mistake(option, given, "each of these values exists, but no table has all of them"))
    return selection


def _has_value(table_set: TableSet, name: str, value: Any) -> bool:
    numbers = all(isinstance(entry.values[name], int | float) for entry in table_set)
    if numbers and not isinstance(value, int | float | tuple):
        return False
    return len(table_set.select(**{name: value})) > 0


def varying(table_set: TableSet) -> list[str]:
    """Return the parameters that have several values, in the order of the sweep."""
    return [name for name in table_set.parameters if len(levels_of(table_set, name)) > 1]


def tables_text(table_set: TableSet, used: int, rest: str = "left out") -> str:
    """Return the text on the tables that a study is based on, such as `22 of 80 tables, 58 not made`.

    Parameters
    ----------
    table_set : TableSet
        The table set or the selection that was studied.
    used : int
        Number of tables that the study uses.
    rest : str, default "left out"
        Why the study does not use the other tables that are made.

    Returns
    -------
    str
    """
    of = "selected tables" if len(table_set) < table_set.sweep.tables else "tables"
    impossible = sum(entry.record is None and bool(entry.why) for entry in table_set)
    missing = sum(entry.record is None for entry in table_set) - impossible
    counts = {"not made": missing, "break a rule of scenarios": impossible}
    counts[rest] = len(table_set) - missing - impossible - used
    return ", ".join(
        [f"{used} of {len(table_set)} {of}", *(f"{number} {why}" for why, number in counts.items() if number)]
    )


def levels_of(table_set: TableSet, name: str) -> tuple[Any, ...]:
    """Return the different values of a parameter, sorted: numbers, then texts, then lists (as tuples).

    Parameters
    ----------
    table_set : TableSet
        Table set, or a selection of it.
    name : str
        Name of the parameter.

    Returns
    -------
    tuple
    """
    keys = {key_of(entry.values[name]) for entry in table_set}
    return tuple(sorted(keys, key=lambda level: (isinstance(level, str) + 2 * isinstance(level, tuple), level)))


def key_of(value: Any) -> Any:
    """Return a value of a parameter, with lists as tuples."""
    return tuple(map(key_of, value)) if isinstance(value, list | tuple) else value


def quantity_of(entry: TableSetEntry, quantity: str) -> float:
    """Return a quantity of the record of a table, or NaN if the table is not made or has no such quantity."""
    value = (entry.record or {}).get(quantity)
    return math.nan if value is None else float(value)


def require_names(table_set: TableSet, names: Sequence[str]) -> None:
    """Raise SweepError if a name is no parameter of the table set, or is given twice."""
    known = ", ".join(table_set.parameters)
    mistakes = [
        Mistake(
            "parameter", name, f"is no parameter of this table set ({known}){suggestion(name, table_set.parameters)}"
        )
        for name in names
        if name not in table_set.parameters
    ]
    if not mistakes and len(set(names)) < len(names):
        mistakes = [Mistake("parameter", names[0], "is given for both axes; x and y must be two parameters")]
    if mistakes:
        raise SweepError(mistakes)


def require_made(table_set: TableSet, study: str) -> None:
    """Raise SweepError if the table set has no point, or none of its tables is made."""
    if not len(table_set):
        raise SweepError(Mistake("study", study, "the selection has no tables"))
    if all(entry.record is None for entry in table_set):
        rule = f"none of the {len(table_set)} tables is made; `needleplan sweep` makes them"
        raise SweepError(Mistake("study", study, rule))


def require_quantity(table_set: TableSet, quantity: str) -> None:
    """Raise SweepError if the name of the quantity is unknown, or no table of the table set has the quantity."""
    _require_quantity_name(quantity)
    if all(math.isnan(quantity_of(entry, quantity)) for entry in table_set):
        reason = {
            "start_success": "it is recorded for [entry] start of the sweep, in a plane",
            "clearance_mm": "a scenario without obstacles has no clearance",
        }
        because = f": {reason[quantity]}" if quantity in reason else ""
        raise SweepError(Mistake("quantity", quantity, f"no table of the selection has this quantity{because}"))


def _require_quantity_name(quantity: str) -> None:
    """Raise SweepError if the name of the quantity is unknown."""
    if quantity not in QUANTITIES:
        rule = f"must be one of {', '.join(QUANTITIES)}{suggestion(quantity, QUANTITIES)}"
        raise SweepError(Mistake("quantity", quantity, rule))


def has_quantity(table_set: TableSet, quantity: str) -> bool:
    """Return whether a table of the set has a quantity. Raises SweepError if the name is unknown."""
    _require_quantity_name(quantity)
    return any(math.isfinite(quantity_of(entry, quantity)) for entry in table_set)


def require_others_fixed(table_set: TableSet, study: str, names: Sequence[str]) -> None:
    """Raise SweepError if parameters other than the named ones vary. The message says what to give."""
    others = [name for name in varying(table_set) if name not in names]
    if not others:
        return
    listed = "; ".join(f"{name} is {_values(table_set, name)}" for name in others)
    rule = f"shows {' and '.join(names)}, but other parameters vary: {listed}. {_advice(table_set, others)}"
    raise SweepError(Mistake("study", study, rule))


def require_grid(table_set: TableSet, study: str, names: Sequence[str]) -> None:
    """Raise SweepError unless the table set has one point for each combination of the values of the parameters."""
    cells = math.prod(len(levels_of(table_set, name)) for name in names)
    points = len({tuple(key_of(entry.values[name]) for name in names) for entry in table_set})
    if points == cells == len(table_set):
        return
    rule = (
        f"needs one table for each combination of {' and '.join(names)}; the selection has {len(table_set)} tables "
        f"with {points} of {cells} combinations. {_advice(table_set, ())}"
    )
    raise SweepError(Mistake("study", study, rule))


def _advice(table_set: TableSet, others: Sequence[str]) -> str:
    """Return advice for the user if other parameters vary, or if the tables do not form a grid."""
    if others and table_set.sweep.design is Design.PRODUCT:
        example = " ".join(f"--select {name}={_given(levels_of(table_set, name)[0])}" for name in others)
        return f"Give one value of each, such as {example}"
    what = "sampled" if table_set.sweep.design is Design.SAMPLED else "a list"
    return f"The sweep is {what}, not a product: `needleplan study sensitivity` fits such tables"


def _values(table_set: TableSet, name: str) -> str:
    """Return the values of a parameter as a text for messages: a list if there are few, else the range."""
    levels = levels_of(table_set, name)
    if len(levels) <= _LISTED:
        return " or ".join(map(_given, levels)) or "unknown: the table set has no points"
    first, last = (f"{level:.4g}" if isinstance(level, float) else _given(level) for level in (levels[0], levels[-1]))
    return f"one of {len(levels)} values from {first} to {last}"


def _given(level: Any) -> str:
    """Return a value as the command line takes it: without quotation marks and spaces."""
    return level if isinstance(level, str) else shown(level).replace(" ", "")


def _wanted(value: Any) -> str:
    """Return a selected value, or a range, as the command line takes it."""
    return f"{value[0]:g}:{value[1]:g}" if isinstance(value, tuple) else _given(value)
