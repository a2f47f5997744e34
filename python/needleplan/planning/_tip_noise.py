"""The tip noise that a plan expects, as a random walk of the heading along the path."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from needleplan.anatomy import SpaceScenario

if TYPE_CHECKING:
    from needleplan.scenario import Scenario

__all__ = ["PlannedNoise", "planned_noise"]


class PlannedNoise(NamedTuple):
    """Tip noise of a plan: standard deviations of the change of the heading along the path.

    They grow with the square root of the path length. The plane is the plane in which the needle bends at the entry.
    """

    in_plane_rad_sqrt_mm: float = 0.0
    """Standard deviation in the plane after 1 mm of path (rad/sqrt(mm))."""

    out_of_plane_rad_sqrt_mm: float = 0.0
    """Standard deviation out of the plane after 1 mm of path (rad/sqrt(mm))."""


def planned_noise(scenario: Scenario | SpaceScenario) -> PlannedNoise:
    """Return the tip noise of a scenario.

    In the plane, a step of the length s (mm) changes the heading by k noise steps of d rad with the probability p_k for
    each sign, after the step. The variance of many steps is that of a random walk with the standard deviation
    d sqrt(2 sum(k^2 p_k) / s) after 1 mm. Nothing leaves the plane. In 3D both directions have the same noise.

    Parameters
    ----------
    scenario : Scenario or SpaceScenario
        The scenario of a plan.

    Returns
    -------
    PlannedNoise
    """
    if isinstance(scenario, SpaceScenario):
        return PlannedNoise(scenario.noise_rad_sqrt_mm, scenario.noise_rad_sqrt_mm)
    motion = scenario.motion
    variance = 2 * sum(steps**2 * share for steps, share in enumerate(motion.tip_noise))
    return PlannedNoise(motion.noise_step_rad * math.sqrt(variance / scenario.step_mm))
