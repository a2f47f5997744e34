"""Codes of the needleplan robot protocol: kinds of datagrams, results of commands, states and faults of the robot."""

from __future__ import annotations

from enum import IntEnum, IntFlag

__all__ = ["NAMES_OF_FAULTS", "REASONS_OF_RESULTS", "Fault", "Result", "RobotKind", "RobotState"]


class RobotKind(IntEnum):
    """Kind of a datagram; kinds sent by the robot have the highest bit set."""

    HELLO = 0x01
    """Requests control of the robot in a new session, whose number the controller has chosen at random, and sets the
    limits of the session."""

    ENABLE = 0x02
    INSERT = 0x03
    """Moves to the depth `target` (mm) at `speed` (mm/s)."""

    ROTATE = 0x04
    """Rotates to the roll `target` (rad) at `speed` (rad/s)."""

    STOP = 0x05
    ALIVE = 0x06
    """Heartbeat. The robot sends no answer, but repeats the sending time of the heartbeat in the next status."""

    RESET = 0x07
    """Changes the state from FAULT to DISABLED if the cause is gone."""

    GOODBYE = 0x08
    """Stops and disables the robot, and releases control."""

    HOME = 0x09
    """Declares that the zero of the robot is known, by order of a person. Since version 3, as UNHOME."""

    UNHOME = 0x0A
    """Declares that the zero of the robot is lost."""

    STATUS = 0x80
    ANSWER = 0x81
    COMPACT = 0x82
    """Status with numbers of 4 bytes, on a serial line."""


class Result(IntEnum):
    """Result of a command."""

    ACCEPTED = 0
    BUSY = 1
    """Another controller has the robot."""

    OLD_SESSION = 2
    """The session of the command has ended, or was never accepted."""

    WRONG_VERSION = 3
    LATE = 4
    """The command arrived after its deadline, or has no deadline although its kind needs one."""

    SUPERSEDED = 5
    """A later command (with a higher number) arrived before this command."""

    NOT_ENABLED = 6
    OUT_OF_RANGE = 7
    """The drive does not accept the target or the speed, or a value is not finite or not positive."""

    IN_FAULT = 8
    DEPTH_BEYOND = 9
    """The depth, or a depth limit in HELLO, is outside the limits of the session or of the robot."""

    SPEED_BEYOND = 10
    ROLL_BEYOND = 11
    ROTATION_BEYOND = 12
    """The rotation speed is above its limit."""

    DEADLINE_BEYOND = 13
    """The deadline of a motion is too far in the future."""

    NOT_AUTHENTIC = 14
    """The robot has a key, and the datagram is not authenticated with it."""


class RobotState(IntEnum):
    """State of the robot, named as in CRTK."""

    DISABLED = 0
    ENABLED = 1
    FAULT = 3


class Fault(IntFlag):
    """Causes of a stop as bits; a set bit stays set until RESET. `NAMES_OF_FAULTS` has their texts."""

    WATCHDOG = 0x01
    ESTOP = 0x02
    DRIVE = 0x04
    FOLLOWING = 0x08
    LIMIT = 0x10
    ENCODER = 0x20
    NO_MOTION = 0x40
    FOREIGN_STOP = 0x80
    BEYOND = 0x100


NAMES_OF_FAULTS = {
    Fault.WATCHDOG: "nothing was received from the controller while the robot moved",
    Fault.ESTOP: "the emergency stop was pressed",
    Fault.DRIVE: "a drive reports a fault",
    Fault.FOLLOWING: "an axis does not follow",
    Fault.LIMIT: "a limit switch was reached",
    Fault.ENCODER: "an encoder has jumped or counts in the wrong direction",
    Fault.NO_MOTION: "an axis does not move",
    Fault.FOREIGN_STOP: "another sender ordered a stop",
    Fault.BEYOND: "the measured depth or roll is beyond the limits of the session",
}

REASONS_OF_RESULTS = {
    Result.BUSY: "the robot has another controller",
    Result.OLD_SESSION: "the robot has ended this session: it was restarted, or received nothing for too long",
    Result.WRONG_VERSION: "the robot speaks another version of the protocol",
    Result.LATE: "the command arrived after its deadline",
    Result.SUPERSEDED: "a later command such as a stop arrived before it",
    Result.NOT_ENABLED: "the robot is not enabled",
    Result.OUT_OF_RANGE: "the drive does not accept this target or speed",
    Result.IN_FAULT: "the robot is in a fault",
    Result.DEPTH_BEYOND: "the depth is outside the limits of the robot or of this session",
    Result.SPEED_BEYOND: "the speed is above the limit of the robot or of this session",
    Result.ROLL_BEYOND: "the roll is beyond the limit of the robot or of this session",
    Result.ROTATION_BEYOND: "the rotation speed is above the limit of the robot or of this session",
    Result.DEADLINE_BEYOND: "the deadline is farther in the future than the robot permits; reduce valid_s",
    Result.NOT_AUTHENTIC: "the robot requires another key: set key_file in its address",
}
"""What a result means for the controller."""
