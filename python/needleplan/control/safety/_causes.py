"""Causes of stops and refusals, and the severity of each.

Each cause names a fault, so the empty set of causes means health (the rule of PX4's failsafe flags). A fault that no
cause describes yet can go unreported, but it cannot make an unhealthy system look healthy.
"""

from __future__ import annotations

from enum import StrEnum

__all__ = ["Cause", "Severity"]


class Severity(StrEnum):
    """Effect of a cause on the operating state."""

    REFUSAL = "refusal"
    """One command is refused; the state does not change."""

    PAUSE = "pause"
    """Motion stops; it may be resumed as soon as the cause is gone."""

    FAULT = "fault"
    """Motion stops and the stop latches: the cause must be gone, and a person must reset and enable again."""


class Cause(StrEnum):
    """Cause of a stop or of a refusal.

    A cause of an input is present as long as the input is faulty. A cause of a command ends with the command.
    """

    FORCE_STALE = "force_stale"
    """No force sample has arrived within `force_age_s`, or none at all."""
    FORCE_SUSPECT = "force_suspect"
    """Force samples arrive, but none is usable: saturated, frozen, stuck or not a number."""
    FORCE_FAULT = "force_fault"
    """The force sensor has reported a fault."""
    FORCE_EXCEEDED = "force_exceeded"
    """The force is larger than `force_n`."""
    POSE_STALE = "pose_stale"
    """No pose has arrived within `pose_age_s`, or none at all."""
    POSE_SUSPECT = "pose_suspect"
    """Poses arrive, but none is usable."""
    POSE_UNSEEN = "pose_unseen"
    """The tracker answers, but does not see the coil."""
    POSE_JUMPED = "pose_jumped"
    """The coil moved farther than the needle can have moved it: another tool, or a distorted field."""
    POSE_FAULT = "pose_fault"
    """The tracker has reported a fault."""
    TIP_UNKNOWN = "tip_unknown"
    """There is a pose, but no estimate of the tip."""
    OUT_OF_PLANE = "out_of_plane"
    """The tip is farther from the plane of the plan than `out_of_plane_mm`."""
    OUT_OF_WORKSPACE = "out_of_workspace"
    """The tip is outside `workspace_x_mm` or `workspace_y_mm`."""
    STAGE_STALE = "stage_stale"
    """No stage sample has arrived within `stage_age_s`, or none at all."""
    STAGE_SUSPECT = "stage_suspect"
    """Stage samples arrive, but none is usable."""
    STAGE_FAULT = "stage_fault"
    """The stage has reported a fault, or a command, stop or heartbeat did not reach it."""
    STAGE_JUMPED = "stage_jumped"
    """The position changed by more than the stage can move, or the stage restarted: its zero is no longer known."""
    DEPTH_EXCEEDED = "depth_exceeded"
    """The depth is outside `shallowest_mm` to `deepest_mm`."""
    OVERSPEED = "overspeed"
    """The stage moves faster than the velocity limit."""
    WRONG_WAY = "wrong_way"
    """The stage moves against its command."""
    NO_MOTION = "no_motion"
    """The stage accepted a command and does not move."""
    STILL_MOVING = "still_moving"
    """The stage moves after a stop, or without any command."""
    LOOP_LATE = "loop_late"
    """The loop has not called `tick` within `loop_age_s`, or a command blocks the guard."""
    CLOCK_MISMATCH = "clock_mismatch"
    """A sample is from the future, or the clock went back: ages cannot be computed."""
    TIME_EXCEEDED = "time_exceeded"
    """The run is longer than `run_s`."""
    RECORDING_BEHIND = "recording_behind"
    """The recorder does not keep up, or its disk refuses data at the moment."""
    RECORDING_LOST = "recording_lost"
    """Part of the run is missing from the recording for good."""
    PLAN_LOST = "plan_lost"
    """The plan has no action for the present pose of the needle."""
    STOP_ORDERED = "stop_ordered"
    """A person or a program ordered a stop."""

    NOT_POSSIBLE = "not_possible"
    """The order is not allowed in this state."""
    NOT_ENABLED = "not_enabled"
    """The guard is not ENABLED."""
    NOT_HOMED = "not_homed"
    """The zero of the stage is not known."""
    NOT_RESET = "not_reset"
    """A stop is latched that no person has reset."""
    NOT_FINITE = "not_finite"
    """A value of the command is not a finite number."""
    DEPTH_BEYOND = "depth_beyond"
    """The commanded depth is outside `shallowest_mm` to `deepest_mm`."""
    VELOCITY_BEYOND = "velocity_beyond"
    """The commanded velocity is not above 0 or beyond its limit."""
    ROLL_BEYOND = "roll_beyond"
    """The commanded roll is beyond `roll_rad`."""
    ROTATION_BEYOND = "rotation_beyond"
    """The commanded rotation speed is not above 0 or beyond `rotation_velocity_rad_s`."""
    SECOND_COMMANDER = "second_commander"
    """Another thread commands already, or another guard has the stage."""
    NOT_A_RETRACTION = "not_a_retraction"
    """The commanded depth is deeper than the present one."""
    LIMITS_IN_USE = "limits_in_use"
    """Limits can be exchanged only in DISABLED."""

    @property
    def severity(self) -> Severity:
        """Effect of this cause."""
        return _REFUSALS.get(self) or _PAUSES.get(self) or Severity.FAULT


_REFUSALS = dict.fromkeys(
    (Cause.NOT_POSSIBLE, Cause.NOT_ENABLED, Cause.NOT_HOMED, Cause.NOT_RESET, Cause.NOT_FINITE, Cause.DEPTH_BEYOND,
     Cause.VELOCITY_BEYOND, Cause.ROLL_BEYOND, Cause.ROTATION_BEYOND, Cause.SECOND_COMMANDER, Cause.NOT_A_RETRACTION,
     Cause.LIMITS_IN_USE),
    Severity.REFUSAL,
)  # fmt: skip
# Pauses: the position of the tip is unknown for a moment, or the plan or the disk must catch up. The robot is well.
_PAUSES = dict.fromkeys(
    (Cause.POSE_STALE, Cause.POSE_SUSPECT, Cause.POSE_UNSEEN, Cause.TIP_UNKNOWN, Cause.PLAN_LOST,
     Cause.RECORDING_BEHIND),
    Severity.PAUSE,
)  # fmt: skip
