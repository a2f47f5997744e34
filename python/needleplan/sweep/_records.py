"""Numbers that describe a table: its best entry, the path from there, and how the solve went."""

from __future__ import annotations

import math
from functools import singledispatch
from typing import Any

from needleplan.planning import Outcome, PolicyTable, SpaceTable, Table, edge_profile, entry_map

__all__ = ["record_of"]

# Digits of the success in the profile of an edge, which make up most of a record.
_PROFILE_DIGITS = 5


@singledispatch
def record_of(table: Table, edge: str, start: tuple[float, ...] | None) -> dict[str, Any]:
    """Return the record of a table.

    Parameters
    ----------
    table : Table
        The table.
    edge : str
        The edge of the plane whose best entry is described.
    start : tuple of float, optional
        A fixed pose in the plane (x_mm, y_mm, heading_deg) whose success is recorded too.

    Returns
    -------
    dict
        Numbers by name, with the unit in the name; the best entry in 3D in RAS mm.
    """
    raise NotImplementedError(type(table))


@record_of.register(PolicyTable)
def _plane_record(table: PolicyTable, edge: str, start: tuple[float, ...] | None) -> dict[str, Any]:
    profile = edge_profile(table, edge)
    best = profile.best or table.best_entry(edge)  # which says that all positions are in obstacles
    path, pose = table.path(best), best.pose
    record: dict[str, Any] = {
        "digest": table.digest,
        "success": best.success,
        "cost": best.value,
        "entry_x_mm": pose.x_mm,
        "entry_y_mm": pose.y_mm,
        "entry_heading_rad": pose.heading_rad,
        "entry_bevel": pose.bevel,
        "reached": path.outcome is Outcome.TARGET,
        "length_mm": path.length_mm,
        "turns": len(path.turns),
        "clearance_mm": path.clearance_mm if path.scenario.obstacles else None,
        "profile": {
            "position_mm": profile.position_mm.tolist(),
            "success": [round(probability, _PROFILE_DIGITS) for probability in profile.success.tolist()],
        },
        "status": str(table.stats.status),
        "states": table.scenario.states,
        "seconds": table.stats.seconds,
    }
    if start:
        x_mm, y_mm, heading_deg = start
        answer = table.lookup(table.start((x_mm, y_mm, math.radians(heading_deg))))
        record |= {"start_success": answer.success, "start_cost": answer.value}
    return record


@record_of.register(SpaceTable)
def _space_record(table: SpaceTable, *_: object) -> dict[str, Any]:
    entries = entry_map(table)
    first = entries.first()
    best = entries.entry(first)
    names = ("entry_r_mm", "entry_a_mm", "entry_s_mm", "direction_r", "direction_a", "direction_s")
    return {
        "digest": table.digest,
        **best.success.record(),
        "cost": float(entries.value[first]),
        **dict(zip(names, [*best.position_mm, *best.direction], strict=True)),
        "reached": best.reached,
        "length_mm": best.length_mm,
        "turns": best.turns,
        "clearance_mm": best.clearance_mm,
        "shift_cost": best.shift_cost,
        "tilt_cost": best.tilt_cost,
        "impossible": entries.impossible,
        "status": str(table.stats.status),
        "states": table.stats.states,
        "seconds": table.stats.seconds,
    }
