"""Distances of paths and tips from the obstacles of a plan in a plane, for the page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from needleplan.scenario import Scenario

__all__ = ["nearest_risk", "risk_distances"]


def risk_distances(scenario: Scenario, points_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distances (mm) of points from each obstacle, shape (obstacles, n); 0 in an obstacle.

    Parameters
    ----------
    scenario : Scenario
        The scenario, whose obstacles are taken without their margins.
    points_mm : numpy.ndarray
        Points of the centre line of the needle, shape (n, 2).

    Returns
    -------
    numpy.ndarray
    """
    import shapely

    points = shapely.points(points_mm[:, :2])
    rows = [shapely.distance(obstacle.region(), points) for obstacle in scenario.obstacles]
    return np.array(rows, np.float64).reshape(len(rows), len(points_mm))


def nearest_risk(scenario: Scenario, points_mm: NDArray[np.float64]) -> dict[str, Any] | None:
    """Return name and distance (mm) of the obstacle that points come closest to; None without obstacles.

    Parameters
    ----------
    scenario : Scenario
        The scenario.
    points_mm : numpy.ndarray
        Points along a path, shape (n, 2).

    Returns
    -------
    dict or None
        `name`, "obstacle" with its name or number, and `distance_mm`.
    """
    least = risk_distances(scenario, points_mm).min(1, initial=np.inf)
    if not len(least):
        return None
    number = int(least.argmin())
    name = scenario.obstacles[number].name or number + 1
    return {"name": f"obstacle {name}", "distance_mm": float(least[number])}
