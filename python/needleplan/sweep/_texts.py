"""Texts of parameters: their values, their names as words, and their units."""

from __future__ import annotations

from collections.abc import Mapping

from needleplan.sweep._swept_parameter import SweptParameter

__all__ = ["name_and_unit", "record_unit", "value_text", "values_text", "words_and_unit"]

# Endings of keys, with their units.
_UNITS = (("_per_mm", "1/mm"), ("_mm", "mm"), ("_deg", "degrees"), ("_rad", "rad"), ("_n", "N"), ("_s", "s"))

# Tables whose keys are understood without the name of the table.
_PLAIN_TABLES = ("", "needle", "motion", "grid", "lattice", "workspace", "objective", "solver", "anatomy")

# Units of the numbers of a record whose names do not state them. `at` has the form that xarray reads as dates.
_RECORD_UNITS = {
    "cost": "cost units",
    "start_cost": "cost units",
    "seconds": "s",
    "bytes": "byte",
    "at": "seconds since 1970-01-01",
    "direction_s": "",
}


def value_text(value: object) -> str:
    """Return the text of a value for answers: numbers with six digits, lists in brackets."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(value_text, value))}]"
    return str(value)


def values_text(values: Mapping[str, object]) -> str:
    """Return the text of the values of a point, such as `radius_mm = 40, rotation = 4`."""
    return ", ".join(f"{name} = {value_text(value)}" for name, value in values.items())


def words_and_unit(parameter: SweptParameter) -> tuple[str, str]:
    """Return the name of a parameter as words, and the unit that its key states; empty if it states none."""
    *_, table, key = ["", *parameter.scenario_key.split(".")]
    coordinate = len(key) == 1  # x, y, z, or the number of an entry
    text, unit = name_and_unit(table if coordinate else key)
    if coordinate:
        of = parameter.scenario_key.split(".")[:-2]
        text = " ".join([*of[-1:], text, key])
    elif table not in _PLAIN_TABLES:  # a radius or a margin of what?
        text = " ".join([*parameter.scenario_key.split(".")[-3 if table.isdecimal() else -2 : -1], text])
    if parameter.scenario_key.startswith("objective."):
        unit = {"1/mm": "cost units/mm", "": "cost units" if key != "discount" else ""}.get(unit, unit)
        text = text if unit in ("mm", "") else f"cost of {text}"
    if parameter.name:
        text = name_and_unit(parameter.name)[0]
    return text, unit


def name_and_unit(name: str) -> tuple[str, str]:
    """Return a name as words, and the unit that its ending states; empty if it states none."""
    for ending, unit in _UNITS:
        if name.endswith(ending):
            return name.removesuffix(ending).replace("_", " "), unit
    return name.replace("_", " "), ""


def record_unit(name: str) -> str:
    """Return the unit of a number of a record; empty if it has none."""
    return _RECORD_UNITS.get(name, name_and_unit(name)[1])
