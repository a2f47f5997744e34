"""Causes of stops and refusals, and the severity of each.

Each cause names a fault, and an empty set of causes means that the system is healthy (as PX4's failsafe flags). There
is no flag that reports health, so a wrong flag cannot hide a fault.
"""

from __future__ import annotations

from enum import StrEnum

__all__ = ["Cause", "Severity"]


class Severity(StrEnum):
    """Effect of a cause on the operating state of the guard."""

    REFUSAL = "refusal"
    """One command is refused; the state does not change."""

    PAUSE = "pause"
    """The motion stops and can be resumed as soon as the cause is gone."""

    FAULT = "fault"
    """The motion stops, and the stop is latched: when the cause is gone, a person must reset and enable the guard."""


class Cause(StrEnum):
    """Cause of a stop or of a refusal.

    A cause that concerns an input is present as long as the input is faulty. A cause that concerns a command only
    refuses this command.
    """

    FORCE_STALE = "force_stale"
    """The last force sample is older than `force_age_s`, or there is none."""
    FORCE_SUSPECT = "force_suspect"
    """Force samples arrive, but none is usable: they are saturated, frozen, stuck or not finite."""
    FORCE_FAULT = "force_fault"
    """The force sensor has reported a fault."""
    FORCE_EXCEEDED = "force_exceeded"
    """The force is larger than `force_n`."""
    POSE_STALE = "pose_stale"
    """The last pose is older than `pose_age_s`, or there is none."""
    POSE_SUSPECT = "pose_suspect"
    """Poses arrive, but none is usable."""
    POSE_UNSEEN = "pose_unseen"
    """The tracker answers, but does not see the coil."""
    POSE_JUMPED = "pose_jumped"
    """The coil moved farther than the stage can have moved it: another tool is tracked, or the field is distorted."""
    POSE_FAULT = "pose_fault"
    """The tracker has reported a fault."""
    TIP_UNKNOWN = "tip_unknown"
    """There is a pose, but no estimate of the tip."""
    OUT_OF_PLANE = "out_of_plane"
    """The tip is farther from the plane of the plan than `out_of_plane_mm`."""
    OUT_OF_WORKSPACE = "out_of_workspace"
    """The tip is outside `workspace_x_mm` or `workspace_y_mm`."""
    STAGE_STALE = "stage_stale"
    """The last stage sample is older than `stage_age_s`, or there is none."""
    STAGE_SUSPECT = "stage_suspect"
    """Stage samples arrive, but none is usable."""
    STAGE_FAULT = "stage_fault"
    """The stage has reported a fault, or a command, a stop or a heartbeat did not reach the stage."""
    STAGE_JUMPED = "stage_jumped"
    """The position changed by more than the stage can move, or the stage has restarted. Its zero is no longer known."""
    DEPTH_EXCEEDED = "depth_exceeded"
    """The depth is outside `shallowest_mm` to `deepest_mm`."""
    OVERSPEED = "overspeed"
    """The stage moves faster than the velocity limit."""
    WRONG_WAY = "wrong_way"
    """The stage moves against its command."""
    NO_MOTION = "no_motion"
    """The stage has accepted a command but does not move."""
    STILL_MOVING = "still_moving"
    """The stage moves after a stop, or without any command."""
    LOOP_LATE = "loop_late"
    """The loop has not called `tick` within `loop_age_s`, or a command blocks the guard."""
    CLOCK_MISMATCH = "clock_mismatch"
    """A sample has a later time than the clock, or the clock has gone back, so ages cannot be computed."""
    TIME_EXCEEDED = "time_exceeded"
    """The run is longer than `run_s`."""
    RECORDING_BEHIND = "recording_behind"
    """The recorder is too slow, or its disk does not accept data at the moment."""
    RECORDING_LOST = "recording_lost"
    """Part of the run is missing in the recording and cannot be recovered."""
    PLAN_LOST = "plan_lost"
    """The plan has no action for the present pose of the needle."""
    STOP_ORDERED = "stop_ordered"
    """A person or a program ordered a stop."""

    NOT_POSSIBLE = "not_possible"
    """The order is not allowed in this state."""
    NOT_ENABLED = "not_enabled"
    """The guard is not in the state ENABLED."""
    NOT_HOMED = "not_homed"
    """The zero of the stage is not known."""
    NOT_RESET = "not_reset"
    """A stop is latched, and no person has reset the guard."""
    NOT_FINITE = "not_finite"
    """A value of the command is not a finite number."""
    DEPTH_BEYOND = "depth_beyond"
    """The commanded depth is outside `shallowest_mm` to `deepest_mm`."""
    VELOCITY_BEYOND = "velocity_beyond"
    """The commanded velocity is not above 0, or above its limit."""
    ROLL_BEYOND = "roll_beyond"
    """The commanded roll is beyond `roll_rad`."""
    ROTATION_BEYOND = "rotation_beyond"
    """The commanded rotation speed is not above 0, or above `rotation_velocity_rad_s`."""
    SECOND_COMMANDER = "second_commander"
    """Another thread already commands the stage, or the stage already has a guard."""
    NOT_A_RETRACTION = "not_a_retraction"
    """The commanded depth is deeper than the present depth."""
    LIMITS_IN_USE = "limits_in_use"
    """Limits can be replaced only in the state DISABLED."""

    @property
    def severity(self) -> Severity:
        """Severity of this cause."""
        return _REFUSALS.get(self) or _PAUSES.get(self) or Severity.FAULT


_REFUSALS = dict.fromkeys(
    (Cause.NOT_POSSIBLE, Cause.NOT_ENABLED, Cause.NOT_HOMED, Cause.NOT_RESET, Cause.NOT_FINITE, Cause.DEPTH_BEYOND,
     Cause.VELOCITY_BEYOND, Cause.ROLL_BEYOND, Cause.ROTATION_BEYOND, Cause.SECOND_COMMANDER, Cause.NOT_A_RETRACTION,
     Cause.LIMITS_IN_USE),
    Severity.REFUSAL,
)  # fmt: skip
# Causes of a pause: the tip is unknown for a moment, or the plan or the disk is late. The robot itself works.
_PAUSES = dict.fromkeys(
    (Cause.POSE_STALE, Cause.POSE_SUSPECT, Cause.POSE_UNSEEN, Cause.TIP_UNKNOWN, Cause.PLAN_LOST,
     Cause.RECORDING_BEHIND),
    Severity.PAUSE,
)  # fmt: skip
