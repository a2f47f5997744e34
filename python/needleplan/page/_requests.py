"""What a request of the page asks for: its scenario, the draft of the scenario, and the start of the needle."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from needleplan.config import toml_text
from needleplan.errors import InputError, Mistake, PoseError
from needleplan.planning import Pose
from needleplan.scenario import Scenario

if TYPE_CHECKING:
    from needleplan.planning import Entry, PolicyTable

__all__ = ["Request", "best_success", "draft_of", "scenario_of", "start_of"]

# Largest number of states of a plan that is solved during a drag; 1.2 million take about 50 ms on two processors.
_DRAFT_STATES = 1_500_000

Request = dict[str, Any]
"""The JSON object of a request."""


def scenario_of(request: Request) -> Scenario:
    """Return the scenario of a request. Raises ScenarioError with all mistakes."""
    raw = request.get("scenario")
    if not isinstance(raw, dict):
        raise InputError(Mistake("scenario", "", "must be an object with the tables of a scenario file"))
    try:
        text = toml_text(_with_infinity(raw))
    except (TypeError, RecursionError) as error:
        raise InputError(Mistake("scenario", "", f"cannot be written as TOML: {error}")) from None
    return Scenario.from_toml(text)


def _with_infinity(value: Any, key: str = "") -> Any:
    """Return a copy in which radii that are the text "inf" are infinite, since JSON has no infinity."""
    if isinstance(value, dict):
        return {name: _with_infinity(each, name) for name, each in value.items() if each is not None}
    if isinstance(value, list):
        return [_with_infinity(each) for each in value]
    return math.inf if value == "inf" and key == "curvature_radius_mm" else value


def draft_of(scenario: Scenario) -> Scenario:
    """Return the scenario on a grid that is coarse enough to be solved during a drag, without refinements."""
    grid = replace(scenario.grid, refinement=1, success_refinement=1)
    coarser = math.sqrt(max(scenario.states / _DRAFT_STATES, 1))
    size = scenario.workspace
    dx, dy = grid.spacing_mm
    if coarser > 1:
        spacing = min(dx * coarser, size.width_mm), min(dy * coarser, size.height_mm)
        grid = replace(grid, spacing_mm=spacing)
    return scenario if grid == scenario.grid else replace(scenario, grid=grid)


# Best entries by table and edge; the search takes as long as a plan.
_entries: WeakKeyDictionary[PolicyTable, dict[str, Entry[Pose]]] = WeakKeyDictionary()


def _best_entry(table: PolicyTable, edge: str) -> Entry[Pose]:
    known = _entries.setdefault(table, {})
    if edge not in known:
        known[edge] = table.best_entry(edge)
    return known[edge]


def best_success(request: Request, table: PolicyTable) -> float:
    """Return the success by the table from the best entry on the edge of a request. The search takes 25 ms."""
    return _best_entry(table, str(request.get("edge", "left"))).success


def start_of(request: Request, table: PolicyTable, *, is_draft: bool = False) -> tuple[Pose, bool]:
    """Return the pose at which a request begins, and whether it is the best entry, as in a request without a start.

    In a draft, the best entry is that of the table's states, without a look one step ahead, which takes 25 ms.
    """
    start = request.get("start")
    if start is None:
        edge = str(request.get("edge", "left"))
        return table.best_entry(edge, nearest=True).pose if is_draft else _best_entry(table, edge).pose, True
    try:
        x_mm, y_mm, heading_deg = (float(start[key]) for key in ("x_mm", "y_mm", "heading_deg"))
        bevel = start.get("bevel")
    except (TypeError, KeyError, ValueError, AttributeError):
        raise PoseError(Mistake("start", "", "must have x_mm, y_mm and heading_deg, and may have a bevel")) from None
    return table.start(Pose.deg(x_mm, y_mm, heading_deg, bevel)), False
