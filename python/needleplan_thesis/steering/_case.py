"""What is tried: a scenario, the lab in which it is tried, and how the needle is guided."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache

from needleplan.planning import PolicyTable, Pose, plan
from needleplan.scenario import Scenario
from needleplan.simulation import Experiment, SimulatedStation, simulated_station

__all__ = ["Guidance", "SteeringCase", "SteeringTask"]


class Guidance(StrEnum):
    """How the needle is guided."""

    REPLANNED = "closed loop"
    """As `needleplan insert` does it."""

    KEPT = "closed loop, one table"
    """The same without planning again."""

    OPEN = "open loop"
    """The moves of the planned path, torsional lag compensated, whatever the tracker says."""

    AIMED = "aimed, not steered"
    """The same needle from the same place, its heading at the target, never turned."""

    STRAIGHT = "straight needle"
    """A needle that does not bend, from the same place, its heading at the target."""

    @property
    def feels(self) -> bool:
        """Whether there is feedback."""
        return self in (Guidance.REPLANNED, Guidance.KEPT)


@dataclass(frozen=True)
class SteeringCase:
    """A scenario, and the lab it is tried in: a needle that bends as planned, but for the effects of the experiment.

    `start` is x_mm, y_mm, heading_rad (the best entry where none is given), with the bevel of the lower cost. The servo
    of the robot runs at `servo_hz`, less than the twin's own: its samples are most of what an insertion costs.
    """

    name: str
    scenario: Scenario
    experiment: Experiment
    start: tuple[float, float, float] | None = None
    velocity_mm_s: float = 10.0
    velocity_rad_s: float = 10.0
    servo_hz: int = 400

    @property
    def table(self) -> PolicyTable:
        """The plan; made once in a process."""
        return _planned(self.scenario)

    @property
    def pose(self) -> Pose:
        """The start."""
        return self.table.start(self.start) if self.start else self.table.best_entry().pose

    def station(self, seed: int, curvature_error: float = 0.0) -> SimulatedStation:
        """Return the devices of a lab of its own."""
        setup = self.experiment.setup
        effects = replace(setup.effects, curvature_error=curvature_error)
        setup = replace(setup, effects=effects, robot=replace(setup.robot, servo_hz=self.servo_hz))
        return simulated_station(replace(self.experiment, setup=setup), self.table, self.pose, seed)


@dataclass(frozen=True)
class SteeringTask:
    """One insertion: `curvature_error` is the share by which the true curvature is above that of the plan."""

    course: SteeringCase
    guidance: Guidance
    seed: int
    curvature_error: float = 0.0


@lru_cache(maxsize=16)
def _planned(scenario: Scenario) -> PolicyTable:
    return plan(scenario)
