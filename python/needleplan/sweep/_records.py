"""Numbers that describe a table: its best entry, the path from there, and how the solve went."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from needleplan.planning import Outcome, PolicyTable, SpaceTable, edge_profile, entry_map
from needleplan.planning import Path as Execution

__all__ = ["arc_points_mm", "clearance_mm", "plane_record", "space_record"]

# Digits of the success in the profile of an edge, which make up most of a record.
_PROFILE_DIGITS = 5

# Points of an arc at which its distance to the obstacles is measured.
_ARC_POINTS = 8


def plane_record(table: PolicyTable, edge: str, start: tuple[float, ...] | None) -> dict[str, Any]:
    """Return the record of a table in a plane.

    Parameters
    ----------
    table : PolicyTable
        The table.
    edge : str
        The edge whose best entry is described.
    start : tuple of float, optional
        A fixed pose (x_mm, y_mm, heading_deg) whose success is recorded too.

    Returns
    -------
    dict
        Numbers by name, with the unit in the name.
    """
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
        "rotations": len(path.turns),
        "clearance_mm": clearance_mm(path),
        "profile": {
            "position_mm": profile.position_mm.tolist(),
            "success": [round(each, _PROFILE_DIGITS) for each in profile.success.tolist()],
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


def space_record(table: SpaceTable) -> dict[str, Any]:
    """Return the record of a 3D table, with the best entry in RAS mm."""
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
        "rotations": best.rotations,
        "clearance_mm": best.clearance_mm,
        "shift_cost": best.shift_cost,
        "tilt_cost": best.tilt_cost,
        "impossible": entries.impossible,
        "status": str(table.stats.status),
        "states": table.stats.states,
        "seconds": table.stats.seconds,
    }


def clearance_mm(path: Execution) -> float | None:
    """Return the smallest distance (mm) of a path without noise to an obstacle, or None without obstacles."""
    if not path.scenario.obstacles:
        return None
    import shapely

    line = shapely.linestrings(arc_points_mm(path.poses)) if len(path.poses) > 1 else shapely.points(path.poses[0, :2])
    return min(float(shapely.distance(each.region(), line)) for each in path.scenario.obstacles)


def arc_points_mm(poses: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return points (n, 2) on the arcs between poses (k, 4), whose headings are not wrapped.

    A chord of a circle has the mean direction of its ends, so the part f of an arc that turns by a has a chord of
    sin(f a / 2) / sin(a / 2) times the length of the whole one.
    """
    share = np.linspace(0, 1, _ARC_POINTS + 1)[1:]
    chord = np.diff(poses[:, :2], axis=0)
    half = np.diff(poses[:, 2]) / 2
    ratio = share * np.sinc(np.outer(half, share) / np.pi) / np.sinc(half / np.pi)[:, None]
    angle = np.arctan2(chord[:, 1], chord[:, 0])[:, None] + np.outer(half, share - 1)
    length = np.hypot(chord[:, 0], chord[:, 1])[:, None] * ratio
    inner = poses[:-1, None, :2] + np.stack([length * np.cos(angle), length * np.sin(angle)], axis=-1)
    return np.vstack([poses[:1, :2], inner.reshape(-1, 2)])
