"""Why nothing moves: every cause of a stop and of a refusal, by name.

A cause is named so that its absence is health: no set of causes is better than the empty one, and a cause that nobody
has thought of yet can only be missing, not wrongly true (the rule of PX4's failsafe flags).
"""

from __future__ import annotations

from enum import StrEnum

__all__ = ["Cause", "Severity"]


class Severity(StrEnum):
    """What a cause leads to."""

    REFUSAL = "refusal"
    """One command is not carried out; nothing else changes."""

    PAUSE = "pause"
    """Motion stops; a person may resume as soon as the cause is gone."""

    FAULT = "fault"
    """Motion stops, and the stop latches: the cause must be gone, and a person must reset and enable again."""


class Cause(StrEnum):
    """A cause. Those of the inputs are there as long as the input is; those of a command end with it."""

    FORCE_STALE = "force_stale"
    """No sample of the force for longer than its age may be, or none at all."""
    FORCE_SUSPECT = "force_suspect"
    """Samples come, but none that may be used: saturated, frozen, stuck, not a number."""
    FORCE_FAULT = "force_fault"
    """The force sensor has given up."""
    FORCE_EXCEEDED = "force_exceeded"
    POSE_STALE = "pose_stale"
    POSE_SUSPECT = "pose_suspect"
    """Poses come, but none that may be used."""
    POSE_UNSEEN = "pose_unseen"
    """The tracker answers, but does not see the coil."""
    POSE_JUMPED = "pose_jumped"
    """The coil is where the needle cannot have taken it: another tool under the same name, or a field that is bent."""
    POSE_FAULT = "pose_fault"
    """The tracker has given up."""
    TIP_UNKNOWN = "tip_unknown"
    """There is a pose, but nobody has said where the tip is by it."""
    OUT_OF_PLANE = "out_of_plane"
    OUT_OF_WORKSPACE = "out_of_workspace"
    STAGE_STALE = "stage_stale"
    STAGE_SUSPECT = "stage_suspect"
    STAGE_FAULT = "stage_fault"
    """The stage has given up, or a command or a stop did not reach it."""
    STAGE_JUMPED = "stage_jumped"
    """Its position changed by more than it can move, or it was restarted: where zero is, is not known any more."""
    DEPTH_EXCEEDED = "depth_exceeded"
    OVERSPEED = "overspeed"
    WRONG_WAY = "wrong_way"
    """It moves against its command."""
    NO_MOTION = "no_motion"
    """It took a command and stands still."""
    STILL_MOVING = "still_moving"
    """It moves though it was told to stop, or was told nothing."""
    LOOP_LATE = "loop_late"
    """The loop has not said for too long that it is alive."""
    CLOCK_MISMATCH = "clock_mismatch"
    """A sample is from the future, or the clock went back: ages mean nothing."""
    TIME_EXCEEDED = "time_exceeded"
    RECORDING_BEHIND = "recording_behind"
    """The recorder cannot keep up, or its disk refuses for now."""
    RECORDING_LOST = "recording_lost"
    """Something of the run is not in the recording and never will be."""
    PLAN_LOST = "plan_lost"
    """The plan has no answer for where the needle is."""
    STOP_ORDERED = "stop_ordered"
    """A person or a program asked for a stop."""

    NOT_POSSIBLE = "not_possible"
    """The order does not belong to this state."""
    NOT_ENABLED = "not_enabled"
    NOT_HOMED = "not_homed"
    NOT_RESET = "not_reset"
    """A stop is latched that nobody has reset."""
    NOT_FINITE = "not_finite"
    DEPTH_BEYOND = "depth_beyond"
    VELOCITY_BEYOND = "velocity_beyond"
    ROLL_BEYOND = "roll_beyond"
    ROTATION_BEYOND = "rotation_beyond"
    SECOND_COMMANDER = "second_commander"
    NOT_A_RETRACTION = "not_a_retraction"
    LIMITS_IN_USE = "limits_in_use"
    """Limits are exchanged only while nothing is enabled."""

    @property
    def severity(self) -> Severity:
        """What it leads to."""
        return _REFUSALS.get(self) or _PAUSES.get(self) or Severity.FAULT


_REFUSALS = dict.fromkeys(
    (Cause.NOT_POSSIBLE, Cause.NOT_ENABLED, Cause.NOT_HOMED, Cause.NOT_RESET, Cause.NOT_FINITE, Cause.DEPTH_BEYOND,
     Cause.VELOCITY_BEYOND, Cause.ROLL_BEYOND, Cause.ROTATION_BEYOND, Cause.SECOND_COMMANDER, Cause.NOT_A_RETRACTION,
     Cause.LIMITS_IN_USE),
    Severity.REFUSAL,
)  # fmt: skip
# Where the tip is is not known for the moment, or the plan or the disk must catch up: the robot itself is well.
_PAUSES = dict.fromkeys(
    (Cause.POSE_STALE, Cause.POSE_SUSPECT, Cause.POSE_UNSEEN, Cause.TIP_UNKNOWN, Cause.PLAN_LOST,
     Cause.RECORDING_BEHIND),
    Severity.PAUSE,
)  # fmt: skip
