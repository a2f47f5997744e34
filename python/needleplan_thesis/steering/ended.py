"""How an insertion ended, in truth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

from needleplan.control import ScenarioGeometry
from needleplan.scenario import Scenario
from needleplan.signals import Array

__all__ = ["Ended", "ended"]


@dataclass(frozen=True)
class Ended:
    """Where a path ended: `error_mm` from the centre of the target in the plane of the plan, `aside_mm` beside it.

    `touched` names the first obstacle on the path, if any; `left` says whether it left the workspace.
    """

    error_mm: float
    aside_mm: float
    touched: str
    left: bool

    @property
    def distance_mm(self) -> float:
        """Distance from the centre of the target in space."""
        return math.hypot(self.error_mm, self.aside_mm)


def ended(scenario: Scenario, path_mm: Array) -> Ended:
    """Return how a path, shape (n, 3), ended in a scenario."""
    scene, places = _scene(scenario), path_mm[:, :2].tolist()
    touched = next((name for place in places if (name := scene.touches(*place))), "")
    left = any(scene.outside(*place) for place in places)
    return Ended(scene.target_distance_mm(*places[-1]), abs(float(path_mm[-1, 2])), touched, left)


@lru_cache(maxsize=16)
def _scene(scenario: Scenario) -> ScenarioGeometry:
    return ScenarioGeometry(scenario)
