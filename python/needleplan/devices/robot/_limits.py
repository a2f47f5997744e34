"""Limits of a robot, and the counts of its datagrams."""

from __future__ import annotations

from dataclasses import dataclass

from needleplan.artifacts import CallRepr
from needleplan.devices.robot.messages import MotionLimits

__all__ = ["RobotCounts", "RobotLimits"]


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
