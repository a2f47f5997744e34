"""Causes of stops and refusals, and the severity of each.

Each cause names a fault or a reason for a refusal. An empty set of causes means that the system is healthy, as with
PX4's failsafe flags. No flag reports health, so a wrong flag cannot hide a fault.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from enum import StrEnum

from needleplan._ppvi import guard_causes

__all__ = ["Cause", "Owner", "Severity", "bits_of", "causes_of"]


class Severity(StrEnum):
    """Effect of a cause on the operating state of the guard."""

    REFUSAL = "refusal"
    """One command is refused; the state does not change."""

    PAUSE = "pause"
    """The motion stops; the order RESUME continues the run when the cause is gone."""

    FAULT = "fault"
    """The motion stops, and the cause is latched: when the cause is gone, a person must reset and enable the guard."""


class Owner(StrEnum):
    """Who ordered or caused a stop, a pause or a motion; an earlier owner has more authority than a later one."""

    PERSON = "person"
    ROBOT = "robot"
    SENSOR = "sensor"
    LOOP = "loop"


class Cause(StrEnum):
    """Cause of a stop or of a refusal.

    A cause that concerns an input or a motion is present while the fault lasts. A cause of the severity REFUSAL
    only refuses one command or order.
    """

    FORCE_STALE = "force_stale"
    """No force sample, usable or not, has arrived within `force_age_s`."""
    FORCE_SUSPECT = "force_suspect"
    """Force samples arrive, but none within `force_age_s` is usable: saturated, frozen, stuck or not finite."""
    FORCE_FAULT = "force_fault"
    """Reading the force sensor has raised an error, and no usable sample has followed."""
    FORCE_EXCEEDED = "force_exceeded"
    """The magnitude of the force is larger than `force_n`."""
    FORCE_RISING = "force_rising"
    """The magnitude of the force rises faster than `force_rate_n_s`."""
    POSE_STALE = "pose_stale"
    """No pose, usable or not, has arrived within `pose_age_s`."""
    POSE_SUSPECT = "pose_suspect"
    """Poses arrive, but none within `pose_age_s` is usable."""
    POSE_UNSEEN = "pose_unseen"
    """As POSE_SUSPECT, but in the last pose the tracker does not see the coil."""
    POSE_JUMPED = "pose_jumped"
    """The coil moved farther than the stage can have moved it by more than `pose_jump_mm`, for example because another
    tool is tracked or the field is distorted."""
    POSE_FROZEN = "pose_frozen"
    """Poses arrive but repeat bit for bit, 0.25 s after the stage began to move: the tracker or its program hangs."""
    POSE_FAULT = "pose_fault"
    """Reading the tracker has raised an error, and no usable pose has followed."""
    TIP_UNKNOWN = "tip_unknown"
    """There is a pose, but no finite estimate of the tip."""
    OUT_OF_PLANE = "out_of_plane"
    """The tip is farther from the plane of the plan than `out_of_plane_mm`."""
    OUT_OF_WORKSPACE = "out_of_workspace"
    """The tip is outside `workspace_x_mm` or `workspace_y_mm`, or outside the workspace of the plan."""
    IN_OBSTACLE = "in_obstacle"
    """The tip is in an obstacle of the plan."""
    DEADMAN_RELEASED = "deadman_released"
    """The person does not hold the deadman switch, or its signal does not arrive."""
    STAGE_STALE = "stage_stale"
    """No stage sample, usable or not, has arrived within `stage_age_s`."""
    STAGE_SUSPECT = "stage_suspect"
    """Stage samples arrive, but none that was taken within `stage_age_s` is usable."""
    STAGE_FAULT = "stage_fault"
    """Reading the stage, or sending a command, a stop or a heartbeat has raised an error, and no usable sample has
    followed."""
    STAGE_JUMPED = "stage_jumped"
    """Depth or roll changed by more than the stage can move, or the stage has restarted. The stage must be homed."""
    DEPTH_EXCEEDED = "depth_exceeded"
    """The depth is outside `shallowest_mm` to `deepest_mm` by more than `following_mm`."""
    ROLL_EXCEEDED = "roll_exceeded"
    """The measured roll is beyond `roll_rad` by more than `following_rad`."""
    OVERSPEED = "overspeed"
    """The stage moves faster than 1.5 times the velocity limit of its direction."""
    WRONG_WAY = "wrong_way"
    """An axis moves against its command, beyond the goal of its command, or while only the other axis has a command."""
    NO_MOTION = "no_motion"
    """An axis has moved less than a tenth of its way within `motion_s` after its command."""
    STILL_MOVING = "still_moving"
    """The stage moves without a command, later than `motion_s` after the last stop."""
    LOOP_LATE = "loop_late"
    """The loop has not called `tick` within `loop_age_s`, or a command blocks the guard."""
    CLOCK_MISMATCH = "clock_mismatch"
    """A sample is more than 5 ms later than the clock, or the clock has gone back, so ages cannot be computed."""
    TIME_EXCEEDED = "time_exceeded"
    """The run is longer than `run_s`."""
    RECORDING_BEHIND = "recording_behind"
    """The recorder is late by more than `recording_age_s`, or its disk does not accept data at the moment."""
    RECORDING_LOST = "recording_lost"
    """The recorder has lost a message, has failed or is closed, or the listener of the guard has raised an error."""
    GUARD_FAILED = "guard_failed"
    """A validation has raised an unexpected exception, so the inputs are not validated."""
    PLAN_LOST = "plan_lost"
    """The plan has no action for the present pose of the needle."""
    STOP_ORDERED = "stop_ordered"
    """A person or a program ordered a stop."""

    NOT_POSSIBLE = "not_possible"
    """The order is not allowed in this state."""
    NOT_AUTHORIZED = "not_authorized"
    """Only a person may give the order: a person holds the needle, or the order needs the authority of a person."""
    NOT_ENABLED = "not_enabled"
    """The guard is not in the state ENABLED."""
    NOT_HOMED = "not_homed"
    """The zero of the stage is not known."""
    NOT_RESET = "not_reset"
    """A cause is latched, and no person has reset the guard."""
    NOT_FINITE = "not_finite"
    """A value of the command is not a finite number."""
    DEPTH_BEYOND = "depth_beyond"
    """The commanded depth is outside `shallowest_mm` to `deepest_mm`."""
    VELOCITY_BEYOND = "velocity_beyond"
    """The commanded velocity is not positive, or is above its limit."""
    ROLL_BEYOND = "roll_beyond"
    """The commanded roll is beyond `roll_rad`."""
    ROTATION_BEYOND = "rotation_beyond"
    """The commanded rotation speed is not positive, or is above `rotation_velocity_rad_s`."""
    SECOND_COMMANDER = "second_commander"
    """Another thread already commands the stage, or the stage already has a guard."""
    NOT_A_RETRACTION = "not_a_retraction"
    """The commanded depth is deeper than the present depth or, if this is unknown, deeper than `shallowest_mm`."""
    LIMITS_IN_USE = "limits_in_use"
    """Limits can be replaced only in the state DISABLED."""

    @property
    def severity(self) -> Severity:
        """Severity of this cause."""
        return _SEVERITIES[self]

    @property
    def owner(self) -> Owner:
        """Owner of this cause: the robot, a sensor or the loop; a person for STOP_ORDERED."""
        return _OWNERS[self]


# The guard of Rust numbers the causes, and knows the owner and the severity of each. There, a set of causes is a mask.
_CAUSES = [(Cause(name), tuple(Owner)[owner], tuple(Severity)[severity]) for name, owner, severity in guard_causes()]
_OWNERS = {cause: owner for cause, owner, _ in _CAUSES}
_SEVERITIES = {cause: severity for cause, _, severity in _CAUSES}
_BITS = {cause: 1 << number for number, cause in enumerate(_OWNERS)}


def bits_of(causes: Iterable[Cause]) -> int:
    """Return the bit mask of causes."""
    bits = 0
    for cause in causes:
        bits |= _BITS[cause]
    return bits


@functools.lru_cache(1024)
def causes_of(bits: int) -> frozenset[Cause]:
    """Return the causes of a bit mask."""
    return frozenset(cause for cause, bit in _BITS.items() if bits & bit)
