"""Whether a table is that of the scenario and of the needle at hand, before anything moves."""

from __future__ import annotations

import math
from dataclasses import fields

from needleplan.errors import Mistake, TableError
from needleplan.planning import PolicyTable, Status
from needleplan.scenario import Identified, Scenario

__all__ = ["require_fitting"]

_UNSAID_SHARE = 0.05
"""How far the radii may be apart where the model has no interval."""


def require_fitting(
    table: PolicyTable, source: str, scenario: Scenario | None = None, needle: Identified | None = None
) -> None:
    """Raise TableError, with everything that differs, for a table of another scenario or of another needle.

    The needle fits where the radius of the table lies in the 95 % interval of the identified one.
    """
    mistakes = []
    if table.stats.status is not Status.CONVERGED:
        mistakes.append(Mistake("status", table.stats.status, "must be converged: what it promises is not proven"))
    if scenario is not None and scenario.digest != table.scenario.digest:
        for each in fields(Scenario):
            its, wanted = getattr(table.scenario, each.name), getattr(scenario, each.name)
            if its != wanted and each.name not in ("solver", "title"):
                mistakes.append(Mistake(each.name, str(its), f"must be that of the scenario, {wanted}"))
    if needle is not None:
        radius = table.scenario.needle.curvature_radius_mm
        low, high = needle.interval_mm
        if not math.isfinite(low):
            low, high = (needle.radius_mm * share for share in (1 - _UNSAID_SHARE, 1 + _UNSAID_SHARE))
        if not min(low, high) <= radius <= max(low, high):
            rule = f"must be that of the needle, {needle.radius_mm:.4g} mm, from {low:.4g} to {high:.4g} mm"
            mistakes.append(Mistake("needle.curvature_radius_mm", f"{radius:g}", rule))
    if mistakes:
        raise TableError(mistakes, source)
