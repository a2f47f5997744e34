"""What the guard posts to the supervisor of its stage, and what it learns from it."""

from __future__ import annotations

import math

from needleplan.control.safety._causes import Cause, causes_of
from needleplan.control.safety._limits import SafetyLimits
from needleplan.control.safety._monitor import RunMonitor
from needleplan.control.safety._motion import VELOCITY_MARGIN
from needleplan.control.safety._states import SafetyState, numbers_of
from needleplan.devices import Health
from needleplan.devices.supervision import StageSupervisor, SupervisedLimits

__all__ = ["Supervision"]

_NONE: frozenset[Cause] = frozenset()
# causes that the age of the samples of the stage gives: a supervisor sees the samples before Python reads them
_OF_AGE = frozenset({Cause.STAGE_STALE, Cause.STAGE_SUSPECT})


class Supervision:
    """Access of the guard to the supervisor of a stage; without a supervisor, all methods do nothing.

    A supervisor stops the needle by itself (a *trip*) if the samples of the robot or the age of an input require it.
    """

    def __init__(self, supervisor: StageSupervisor | None) -> None:
        self._supervisor, self._trips = supervisor, 0
        if supervisor is not None:
            self._trips = supervisor.seen(math.inf)[0]

    def see(self, causes: set[Cause], limits: SafetyLimits) -> None:
        """Add the causes of a trip that was not seen before, and judge the age of the samples of the stage."""
        if self._supervisor is None:
            return
        trips, tripped, _, of_stage = self._supervisor.seen(limits.stage_age_s)
        causes -= _OF_AGE
        causes |= causes_of(of_stage) & _OF_AGE
        if trips != self._trips:
            self._trips = trips
            causes |= causes_of(tripped)

    def post(self, limits: SafetyLimits, state: SafetyState, monitor: RunMonitor, *, by_person: bool = False) -> None:
        """Post the state of the guard and the times of its inputs; a state ordered `by_person` always counts."""
        if self._supervisor is None:
            return
        force, pose = monitor.inputs.force, monitor.inputs.pose
        is_unseen = pose.last is not None and pose.last.health is Health.MISSING
        times = (
            (force.taken_ns, force.usable_ns, False), (pose.taken_ns, pose.usable_ns, is_unseen), monitor.deadman_ns,
        )  # fmt: skip
        trips = None if by_person else self._trips
        self._supervisor.post(_numbers(limits, monitor.needs_deadman), numbers_of(state), trips, times)

    def tick(self) -> bool:
        """Report that the loop runs; return whether the supervisor sends the heartbeats."""
        if self._supervisor is not None:
            self._supervisor.tick()
        return self._supervisor is not None

    def withhold(self) -> None:
        """Let the supervisor send no heartbeat until the next `tick`."""
        if self._supervisor is not None:
            self._supervisor.withhold()


def _numbers(limits: SafetyLimits, needs_deadman: bool) -> SupervisedLimits:
    ages = (
        limits.stage_age_s, limits.loop_age_s, limits.force_age_s, limits.pose_age_s,
        limits.deadman_age_s if needs_deadman else math.inf,
    )  # fmt: skip
    over_mm = limits.following_mm
    return (
        ages, (limits.shallowest_mm - over_mm, limits.deepest_mm + over_mm),
        (VELOCITY_MARGIN * limits.insertion_velocity_mm_s, VELOCITY_MARGIN * limits.retraction_velocity_mm_s),
        limits.roll_rad + limits.following_rad,
    )  # fmt: skip
