"""Rules that a selection of an atlas must keep for a study, and the number of tables that a study is based on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from needleplan.atlas._atlas import Atlas, AtlasEntry
from needleplan.atlas._sweep import Design
from needleplan.config import shown, suggestion
from needleplan.errors import AtlasError, Mistake

__all__ = [
    "QUANTITIES",
    "key_of",
    "levels_of",
    "quantity_of",
    "require_grid",
    "require_made",
    "require_names",
    "require_others_fixed",
    "require_quantity",
    "require_quantity_name",
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
    "rotations": "rotations of the path",
    "seconds": "time of the solve (s)",
}
"""Quantities of a record that studies show, with their titles."""

# Largest number of values of a parameter that a message lists; of more values, the message states the range.
_LISTED = 6


def selected(atlas: Atlas, values: Mapping[str, Any], option: str = "--select") -> Atlas:
    """Return the part of an atlas with given values, as `Atlas.select` does.

    Raises AtlasError if a name is unknown, a range is reversed, or no point of the atlas has the values. The message
    names the values that the parameter has. `option` is the option that gave the values.
    """
    if any(name not in atlas.parameters for name in values):
        return atlas.select(**values)  # raises AtlasError with a suggestion
    values = {name: int(value) if isinstance(value, bool) else value for name, value in values.items()}
    mistakes = []
    for name, value in values.items():
        given = f"{name}={_wanted(value)}"
        if isinstance(value, tuple) and value[0] > value[1]:
            mistakes.append(Mistake(option, given, f"a range is LOW:HIGH; write {value[1]:g}:{value[0]:g}"))
        elif not _has_value(atlas, name, value):
            mistakes.append(Mistake(option, given, f"no table has this value; {name} is {_values(atlas, name)}"))
    if mistakes:
        raise AtlasError(mistakes)
    found = atlas.select(**values)
    if not len(found):
        given = ", ".join(f"{name}={_wanted(value)}" for name, value in values.items())
        raise AtlasError(Mistake(option, given, "each of these values exists, but no table has all of them"))
    return found


def _has_value(atlas: Atlas, name: str, value: Any) -> bool:
    numbers = all(isinstance(each.values[name], int | float) for each in atlas)
    if numbers and not isinstance(value, int | float | tuple):
        return False
    return len(atlas.select(**{name: value})) > 0


def varying(atlas: Atlas) -> list[str]:
    """Return the parameters that have several values, in the order of the sweep."""
    return [name for name in atlas.parameters if len(levels_of(atlas, name)) > 1]


def tables_text(atlas: Atlas, used: int, rest: str = "left out") -> str:
    """Return the text on the tables that a study is based on, such as `22 of 80 tables, 58 not made`.

    Parameters
    ----------
    atlas : Atlas
        The atlas or the selection that was studied.
    used : int
        Number of tables that the study uses.
    rest : str, default "left out"
        Why the study does not use the other tables that are made.

    Returns
    -------
    str
    """
    of = "selected tables" if len(atlas) < atlas.sweep.tables else "tables"
    impossible = sum(each.record is None and bool(each.why) for each in atlas)
    missing = sum(each.record is None for each in atlas) - impossible
    counts = {"not made": missing, "break a rule of scenarios": impossible}
    counts[rest] = len(atlas) - missing - impossible - used
    return ", ".join([f"{used} of {len(atlas)} {of}", *(f"{number} {why}" for why, number in counts.items() if number)])


def levels_of(atlas: Atlas, name: str) -> tuple[Any, ...]:
    """Return the different values of a parameter, sorted: numbers, then texts, then lists."""
    keys = {key_of(each.values[name]) for each in atlas}
    return tuple(sorted(keys, key=lambda level: (isinstance(level, str) + 2 * isinstance(level, tuple), level)))


def key_of(value: Any) -> Any:
    """Return a value of a parameter, with lists as tuples."""
    return tuple(map(key_of, value)) if isinstance(value, list | tuple) else value


def quantity_of(entry: AtlasEntry, quantity: str) -> float:
    """Return a quantity of the record of a table, or NaN if the table is not made or has no such quantity."""
    value = (entry.record or {}).get(quantity)
    return math.nan if value is None else float(value)


def require_names(atlas: Atlas, names: Sequence[str]) -> None:
    """Raise AtlasError if a name is no parameter of the atlas, or is given twice."""
    known = ", ".join(atlas.parameters)
    mistakes = [
        Mistake("parameter", name, f"is no parameter of this atlas ({known}){suggestion(name, atlas.parameters)}")
        for name in names
        if name not in atlas.parameters
    ]
    if not mistakes and len(set(names)) < len(names):
        mistakes = [Mistake("parameter", names[0], "is given for both axes; x and y must be two parameters")]
    if mistakes:
        raise AtlasError(mistakes)


def require_made(atlas: Atlas, study: str) -> None:
    """Raise AtlasError if the atlas has no point, or none of its tables is made."""
    if not len(atlas):
        raise AtlasError(Mistake("study", study, "the selection has no tables"))
    if all(each.record is None for each in atlas):
        rule = f"none of the {len(atlas)} tables is made; `needleplan atlas` makes them"
        raise AtlasError(Mistake("study", study, rule))


def require_quantity(atlas: Atlas, quantity: str) -> None:
    """Raise AtlasError if the name of the quantity is unknown, or no table of the atlas has the quantity."""
    require_quantity_name(quantity)
    if all(math.isnan(quantity_of(each, quantity)) for each in atlas):
        reason = {
            "start_success": "it is recorded for [entry] start of the sweep, in a plane",
            "clearance_mm": "a scenario without obstacles has no clearance",
        }
        because = f": {reason[quantity]}" if quantity in reason else ""
        raise AtlasError(Mistake("quantity", quantity, f"no table of the selection has this quantity{because}"))


def require_quantity_name(quantity: str) -> None:
    """Raise AtlasError if the name of the quantity is unknown."""
    if quantity not in QUANTITIES:
        rule = f"must be one of {', '.join(QUANTITIES)}{suggestion(quantity, QUANTITIES)}"
        raise AtlasError(Mistake("quantity", quantity, rule))


def require_others_fixed(atlas: Atlas, study: str, names: Sequence[str]) -> None:
    """Raise AtlasError if parameters other than the named ones vary. The message says what to give."""
    others = [name for name in varying(atlas) if name not in names]
    if not others:
        return
    listed = "; ".join(f"{name} is {_values(atlas, name)}" for name in others)
    rule = f"shows {' and '.join(names)}, but other parameters vary: {listed}. {_advice(atlas, others)}"
    raise AtlasError(Mistake("study", study, rule))


def require_grid(atlas: Atlas, study: str, names: Sequence[str]) -> None:
    """Raise AtlasError unless the atlas has exactly one point for each combination of the values of the parameters."""
    cells = math.prod(len(levels_of(atlas, name)) for name in names)
    points = len({tuple(key_of(each.values[name]) for name in names) for each in atlas})
    if points == cells == len(atlas):
        return
    rule = (
        f"needs one table for each combination of {' and '.join(names)}; the selection has {len(atlas)} tables with "
        f"{points} of {cells} combinations. {_advice(atlas, ())}"
    )
    raise AtlasError(Mistake("study", study, rule))


def _advice(atlas: Atlas, others: Sequence[str]) -> str:
    """Return what to do about other parameters that vary, or about tables that are no grid."""
    if others and atlas.sweep.design is Design.PRODUCT:
        example = " ".join(f"--select {name}={_given(levels_of(atlas, name)[0])}" for name in others)
        return f"Give one value of each, such as {example}"
    what = "sampled" if atlas.sweep.design is Design.SAMPLED else "a list"
    return f"The sweep is {what}, not a product: `needleplan study sensitivity` fits such tables"


def _values(atlas: Atlas, name: str) -> str:
    """Return the values of a parameter as a text for messages: a list if there are few, else the range."""
    levels = levels_of(atlas, name)
    if len(levels) <= _LISTED:
        return " or ".join(map(_given, levels)) or "unknown: the atlas has no points"
    first, last = (f"{each:.4g}" if isinstance(each, float) else _given(each) for each in (levels[0], levels[-1]))
    return f"one of {len(levels)} values from {first} to {last}"


def _given(level: Any) -> str:
    """Return a value as the command line takes it: without quotation marks and spaces."""
    return level if isinstance(level, str) else shown(level).replace(" ", "")


def _wanted(value: Any) -> str:
    """Return a selected value, or a range, as the command line takes it."""
    return f"{value[0]:g}:{value[1]:g}" if isinstance(value, tuple) else _given(value)
