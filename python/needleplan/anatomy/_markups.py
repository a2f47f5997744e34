"""Points that were marked in 3D Slicer: markups (.mrk.json) and the older fiducial lists (.fcsv)."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from needleplan.errors import Mistake, ScenarioError, reading

__all__ = ["POINT_ENDINGS", "MarkedPoint", "read_points"]

POINT_ENDINGS = (".mrk.json", ".fcsv")
# Factor on x and y of a position, by the name of its coordinate system; fiducial lists may number them.
_SYSTEMS = {"RAS": 1.0, "0": 1.0, "LPS": -1.0, "1": -1.0}
_MM = "mm"
# Columns of a fiducial list without a line on them.
_COLUMNS = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID"


@dataclass(frozen=True)
class MarkedPoint:
    """A point with its label; the position is in RAS mm."""

    label: str
    position_mm: tuple[float, float, float]
    source: str


def read_points(file: Path) -> list[MarkedPoint]:
    """Return the points of a file that have a position. Raises ScenarioError if it is wrong."""
    source = str(file)
    with reading(source, ScenarioError):
        text = file.read_text(encoding="utf-8-sig")
    points = _of_json if file.name.lower().endswith(".json") else _of_list
    return list(points(text, source))


def _of_json(text: str, source: str) -> Iterator[MarkedPoint]:
    try:
        markups = json.loads(text)["markups"]
        units = {_unit(markup.get("coordinateUnits", _MM)) for markup in markups}
        rows = [
            (str(markup["coordinateSystem"]), str(point.get("label", "")), point["position"])
            for markup in markups
            for point in markup.get("controlPoints", [])
            if point.get("positionStatus", "defined") == "defined"
        ]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ScenarioError(f"is no markups file of 3D Slicer: {error!r}", source) from None
    if units - {_MM}:
        raise ScenarioError(Mistake("coordinateUnits", ", ".join(sorted(units)), f"must be {_MM}"), source)
    for system, label, position in rows:
        yield _point(system, label, position, source)


def _unit(unit: Any) -> str:
    """Return the unit of coordinates, which may stand in a list with its coding scheme and meaning."""
    return str(unit[0] if isinstance(unit, list) else unit)


def _of_list(text: str, source: str) -> Iterator[MarkedPoint]:
    system, columns = "", _COLUMNS.split(",")
    for number, line in enumerate(text.splitlines(), start=1):
        key, _, value = line.lstrip("# ").partition("=")
        if line.startswith("#"):
            if key.strip() == "CoordinateSystem":
                system = value.strip()
            if key.strip() == "columns":
                columns = [cell.strip() for cell in value.split(",")]
        elif line.strip():
            try:
                row = dict(zip(columns, next(csv.reader([line])), strict=False))
            except csv.Error as error:
                raise ScenarioError(Mistake(f"line {number}", line[:60], f"cannot be read: {error}"), source) from None
            if not {"x", "y", "z"} <= set(row):
                raise ScenarioError(Mistake(f"line {number}", line[:60], "must have the columns x, y and z"), source)
            yield _point(system, row.get("label", ""), [row[axis] for axis in "xyz"], source)


def _point(system: str, label: str, position: Any, source: str) -> MarkedPoint:
    """Return a point in RAS. Raises ScenarioError."""
    if system.upper() not in _SYSTEMS:
        raise ScenarioError(Mistake("coordinate system", system, "must be RAS or LPS"), source)
    try:
        if not isinstance(position, list):
            raise TypeError
        x, y, z = (float(number) for number in position)
    except (OverflowError, TypeError, ValueError):
        raise ScenarioError(Mistake(label or "point", str(position)[:60], "must be three numbers"), source) from None
    if not all(map(math.isfinite, (x, y, z))):
        raise ScenarioError(Mistake(label or "point", str(position)[:60], "must be finite"), source)
    sign = _SYSTEMS[system.upper()]
    return MarkedPoint(label, (sign * x, sign * y, z), source)
