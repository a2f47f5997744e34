"""The two axes of a robot: the interface of their drives, and the monitoring of their measured positions.

Limits of a robot, and the counts of its datagrams.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from needleplan.artifacts import CallRepr
from needleplan.devices.robot.messages import Fault, MotionLimits
from needleplan.stopping import WINDOW_S

__all__ = [
    "DriveLimits",
    "DriveRest",
    "DriveStandstill",
    "DriveStop",
    "DriveWatch",
    "RangeWatch",
    "RobotCounts",
    "RobotDrive",
    "RobotDriveState",
    "RobotLimits",
]


@dataclass(frozen=True)
class RobotLimits(CallRepr):
    """Limits of the robot itself. A controller may request narrower limits of motion for its session, never wider ones.

    While the robot moves, it stops after `silence_s` without a datagram from the controller. The controller may request
    another time from `shortest_silence_s` to `longest_silence_s`. After `release_s` without a datagram, the robot ends
    the session and accepts another one. `longest_valid_s` is the longest time from the present to the deadline of a
    motion.
    """

    silence_s: float = 0.03
    shortest_silence_s: float = 0.005
    longest_silence_s: float = 0.34
    release_s: float = 5.0
    least_mm: float = -200.0
    most_mm: float = 200.0
    fastest_mm_s: float = 50.0
    roll_rad: float = 200.0
    fastest_rad_s: float = 20.0
    longest_valid_s: float = 1.5

    @property
    def motion(self) -> MotionLimits:
        """The limits of motion, as HELLO has them."""
        return MotionLimits(
            self.least_mm, self.most_mm, self.fastest_mm_s, self.roll_rad, self.fastest_rad_s,
            round(1e6 * self.longest_valid_s),
        )  # fmt: skip


@dataclass
class RobotCounts:
    """Numbers of datagrams by problem; one datagram may have several problems."""

    malformed: int = 0
    other_versions: int = 0
    refused: int = 0
    late: int = 0
    not_authentic: int = 0
    """Datagrams that are not authenticated with the key of the robot."""

    foreign_stops: int = 0
    """STOP datagrams without a session, from any sender."""

    repeated: int = 0
    """Datagrams whose sequence number is not higher than that of an earlier datagram."""


# Changes of depth (mm) and roll (rad) above which an axis that was stopped has moved on
_MOVED_MM, _MOVED_RAD = 0.01, 0.002
# Changes of depth (mm) and roll (rad) above which an axis has left its place, whatever its drive reports. Half of the
# default following errors, which end every motion: encoder noise, relaxing tissue and a servo that settles stay below.
_LEFT_MM, _LEFT_RAD = 0.1, 0.02


@dataclass(frozen=True, slots=True)
class RobotDriveState(CallRepr):
    """State of the drives: measured and commanded positions, measured velocities, and faults.

    `wanted_depth_mm` and `wanted_roll_rad` are the commanded positions. `faults` holds only faults that the drives
    report: a drive fault, a limit switch, the emergency stop.
    """

    depth_mm: float
    velocity_mm_s: float
    roll_rad: float
    velocity_rad_s: float
    wanted_depth_mm: float
    wanted_roll_rad: float
    moving: bool
    faults: Fault = Fault(0)


class RobotDrive(Protocol):
    """Interface of the two axes with their servo controllers."""

    def advance(self, time_s: float) -> RobotDriveState:
        """Advance to the time `time_s`, and return the state of the drives."""

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin a motion to a depth. Raises DeviceFault if the axis cannot execute it."""

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin a rotation to a roll angle. Raises DeviceFault if the axis cannot execute it."""

    def stop(self) -> None:
        """Stop both axes as fast as possible."""


@dataclass(frozen=True)
class DriveLimits:
    """Limits at which the monitoring of the axes reports a fault.

    - `following_mm`, `following_rad`: largest permitted difference between commanded and measured position, and largest
      permitted distance of a measured position beyond the range of the session.
    - `fastest_mm_s`, `fastest_rad_s`: measured speed above which the encoder is assumed to have jumped.
    - `still`: an axis counts as not moving if its measured motion is less than this share of the commanded motion.
    """

    following_mm: float = 0.2
    following_rad: float = 0.05
    fastest_mm_s: float = 200.0
    fastest_rad_s: float = 50.0
    still: float = 0.1


class DriveStop:
    """Stops `drive`, and repeats the stop in every tick in which the drive still moves, until `end`.

    A drive may miss a stop. A motion is seen in the measured positions or in the report of the drive.
    """

    def __init__(self, drive: RobotDrive) -> None:
        self._drive = drive
        self._is_wanted = False
        self._last: tuple[float, float] | None = None

    def begin(self) -> None:
        """Stop both axes, and watch them from now on."""
        self._is_wanted, self._last = True, None
        self._drive.stop()

    def end(self) -> None:
        """End the repetition, because a new motion begins."""
        self._is_wanted = False

    def see(self, state: RobotDriveState) -> None:
        """Stop both axes again if they are to stand, and `state` shows a motion."""
        if not self._is_wanted:
            return
        last = (state.depth_mm, state.roll_rad) if self._last is None else self._last
        moved_mm, moved_rad = abs(state.depth_mm - last[0]), abs(state.roll_rad - last[1])
        rests = moved_mm <= _MOVED_MM and moved_rad <= _MOVED_RAD  # False also if a position is no number
        self._last = last if rests else (state.depth_mm, state.roll_rad)
        if state.moving or not rests:
            self._drive.stop()


class DriveStandstill:
    """Compares measured positions with those at the begin of a standstill: a drive may move and not report it."""

    def __init__(self) -> None:
        self._begin: tuple[float, float] | None = None

    def forget(self) -> None:
        """Begin a standstill with the next state."""
        self._begin = None

    def is_left(self, state: RobotDriveState) -> bool:
        """Return whether an axis has left its position in the first state after `forget`."""
        depth_mm, roll_rad = self._begin = self._begin or (state.depth_mm, state.roll_rad)
        stays = abs(state.depth_mm - depth_mm) <= _LEFT_MM and abs(state.roll_rad - roll_rad) <= _LEFT_RAD
        return not stays  # a position that is no number is no standstill


class DriveRest:
    """Measures how long both axes have stood: their positions stay within 0.01 mm and 0.002 rad."""

    def __init__(self) -> None:
        self._begin: tuple[float, float, float] | None = None

    def stands(self, state: RobotDriveState, time_s: float) -> bool:
        """Record a state at a time (s), and return whether both axes have stood for 50 ms."""
        begin = self._begin or (state.depth_mm, state.roll_rad, time_s)
        stays = abs(state.depth_mm - begin[0]) <= _MOVED_MM and abs(state.roll_rad - begin[1]) <= _MOVED_RAD
        self._begin = begin if stays else (state.depth_mm, state.roll_rad, time_s)
        return time_s - self._begin[2] >= WINDOW_S


class RangeWatch:
    """Compares the measured position of an axis with the range of the session, apart from any command.

    Let `e` be the distance (mm or rad) of the axis beyond its range, 0 within. A session may begin beyond its range, so
    that a needle that lies too deep can be pulled out. The allowed distance is therefore the smallest `e` since
    `forget`: the axis may return into its range, but may not move away from the range again by more than the tolerance.
    """

    def __init__(self, tolerance: float) -> None:
        self._tolerance = tolerance
        self._allowed = math.inf

    def forget(self) -> None:
        """Allow the distance beyond the range at which the axis is next seen."""
        self._allowed = math.inf

    def beyond(self, measured: float, least: float, most: float) -> bool:
        """Record a position. Return True if it is not finite, or is beyond its range by more than allowed."""
        if not math.isfinite(measured):
            return True
        distance = max(least - measured, measured - most, 0.0)
        is_beyond = distance > self._allowed + self._tolerance
        self._allowed = min(self._allowed, distance)
        return is_beyond


class DriveWatch:
    """Compares the measured positions of both axes with the commanded, the previous and the permitted ones."""

    def __init__(self, limits: DriveLimits | None = None) -> None:
        limits = DriveLimits() if limits is None else limits
        self._insertion = _AxisWatch(limits.following_mm, limits.fastest_mm_s, limits.still)
        self._roll = _AxisWatch(limits.following_rad, limits.fastest_rad_s, limits.still)
        self._depths, self._rolls = RangeWatch(limits.following_mm), RangeWatch(limits.following_rad)

    def forget(self) -> None:
        """Forget the previous positions, so that the next state may have any position."""
        self._insertion.begin = self._insertion.last = self._roll.begin = self._roll.last = None
        self.begin_session()

    def begin_session(self) -> None:
        """Allow the next positions, even beyond the range of a new session; from there, both axes may only return."""
        self._depths.forget()
        self._rolls.forget()

    def see(self, state: RobotDriveState, time_s: float, motion: MotionLimits) -> Fault:
        """Record a state and return its faults: those reported by the drives and those found by the comparisons.

        `motion` has the ranges of depth and roll that are in force.
        """
        depth_beyond = self._depths.beyond(state.depth_mm, motion.least_mm, motion.most_mm)
        roll_beyond = self._rolls.beyond(state.roll_rad, -motion.roll_rad, motion.roll_rad)
        return (
            state.faults
            | self._insertion.see(state.wanted_depth_mm, state.depth_mm, time_s)
            | self._roll.see(state.wanted_roll_rad, state.roll_rad, time_s)
            | (Fault.BEYOND if depth_beyond or roll_beyond else Fault(0))
        )


class _AxisWatch:
    def __init__(self, following: float, fastest: float, still: float) -> None:
        self._following, self._fastest, self._still = following, fastest, still
        self.last: tuple[float, float] | None = None
        self.begin: tuple[float, float] | None = None
        """Commanded and measured position when their difference was last less than a quarter of the limit."""

    def see(self, wanted: float, measured: float, time_s: float) -> Fault:
        last, self.last = self.last, (measured, time_s)
        if last is not None and abs(measured - last[0]) > self._following + self._fastest * (time_s - last[1]):
            return Fault.ENCODER
        error = abs(wanted - measured)
        if self.begin is None or error < self._following / 4:
            self.begin = wanted, measured
        if error <= self._following:
            return Fault(0)
        asked, went = wanted - self.begin[0], measured - self.begin[1]
        if abs(went) < self._still * abs(asked):
            return Fault.NO_MOTION
        return Fault.ENCODER if asked * went < 0 else Fault.FOLLOWING
