"""Cases of the steering study: scenario and lab, guidance of the needle, and single insertions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache

from needleplan.control import rescaled
from needleplan.models.tissue import TargetPush
from needleplan.planning import PolicyTable, Pose, plan
from needleplan.scenario import Scenario
from needleplan.simulation import SimulatedStation, Simulation, simulated_station

__all__ = ["Guidance", "SteeringCase", "SteeringTask", "steering_simulation"]

# Tip noise (rad/sqrt(mm)) of the needle of the study, 0.4 degrees after 10 mm: the study compares guidances of a needle
# that goes astray by its curvature. The scenarios plan for more noise.
_HEADING_NOISE_RAD_SQRT_MM = 0.002


class Guidance(StrEnum):
    """Guidance of the needle, from feedback with replanning to a needle that does not bend."""

    REPLANNED = "closed loop"
    """Feedback and replanning, as in `needleplan insert`."""

    ONE_TABLE = "closed loop, one table"
    """Feedback with the first policy table, without replanning."""

    KNOWN = "closed loop, curvature known"
    """Feedback with a table that was planned with the true curvature, from the entry of the planned one."""

    OPEN = "open loop"
    """The moves of the planned path without feedback; the torsional lag is compensated."""

    AIMED = "aimed, not steered"
    """The same needle and entry position, heading towards the target, without rotations or feedback."""

    STRAIGHT = "straight needle"
    """A needle that does not bend, at the same entry position, heading towards the target."""

    @property
    def has_feedback(self) -> bool:
        """Whether the control loop uses the tracker to steer the needle."""
        return self in (Guidance.REPLANNED, Guidance.ONE_TABLE, Guidance.KNOWN)


@dataclass(frozen=True)
class SteeringCase:
    """A scenario, and a lab in which the needle bends as planned except for the effects of the simulation.

    `start` is x_mm, y_mm, heading_rad; None means the best entry. The bevel is that of the lower cost. `servo_hz` is
    the rate of the robot's servo; it is lower than in other labs, because servo samples dominate the computing time.
    `push` is that of the control loop. With `planned_noise` the needle has the tip noise of the plan.
    """

    name: str
    scenario: Scenario
    simulation: Simulation
    start: tuple[float, float, float] | None = None
    velocity_mm_s: float = 10.0
    velocity_rad_s: float = 10.0
    servo_hz: int = 400
    push: TargetPush | None = None
    planned_noise: bool = False

    @property
    def table(self) -> PolicyTable:
        """The policy table; planned once per process."""
        return _planned(self.scenario)

    @property
    def pose(self) -> Pose:
        """The start pose."""
        return self.table.start(self.start) if self.start else self.table.best_entry().pose

    def with_curvature(self, error: float) -> SteeringCase:
        """Return the case planned with all curvatures changed by this relative `error`, with the same entry."""
        pose = self.pose
        start = (pose.x_mm, pose.y_mm, pose.heading_rad)
        return replace(self, scenario=rescaled(self.scenario, 1 + error), start=start)

    def station(self, seed: int, curvature_error: float = 0.0) -> SimulatedStation:
        """Return the devices of a new lab with this seed and this `curvature_error` (see `SteeringTask`)."""
        setup = self.simulation.setup
        noise = None if self.planned_noise else setup.effects.heading_noise_rad_sqrt_mm or 0.0
        effects = replace(setup.effects, curvature_error=curvature_error, heading_noise_rad_sqrt_mm=noise)
        setup = replace(setup, effects=effects, robot=replace(setup.robot, servo_hz=self.servo_hz))
        return simulated_station(replace(self.simulation, setup=setup), self.table, self.pose, seed)


@dataclass(frozen=True)
class SteeringTask:
    """One insertion. `curvature_error` is the relative deviation of the true curvature from the planned curvature."""

    case: SteeringCase
    guidance: Guidance
    seed: int
    curvature_error: float = 0.0


@lru_cache(maxsize=16)
def _planned(scenario: Scenario) -> PolicyTable:
    return plan(scenario)


def steering_simulation() -> Simulation:
    """Return the shipped simulation `steering` with the tip noise of the study instead of that of the plan."""
    found = Simulation.read("steering")
    effects = replace(found.setup.effects, heading_noise_rad_sqrt_mm=_HEADING_NOISE_RAD_SQRT_MM)
    return replace(found, setup=replace(found.setup, effects=effects))
