"""The robot side of the protocol, without socket and clock: the state machine and the monitoring of the drives.

The robot obeys one controller in one session. The robot stops if it receives nothing from the controller during a
motion, if a drive or the emergency stop reports a fault, or if an axis is not at its commanded position. Faults latch:
after the cause is gone, RESET and then ENABLE permit motion again. The robot then waits for a new motion command.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

from needleplan.devices.robot.messages import (
    Answer,
    Fault,
    Head,
    OtherVersion,
    Result,
    RobotCommand,
    RobotKind,
    RobotState,
    RobotStatus,
    decode,
    encode,
)
from needleplan.errors import DeviceFault, ProtocolError

__all__ = [
    "DriveLimits",
    "DriveWatch",
    "Peer",
    "RobotCounts",
    "RobotDrive",
    "RobotDriveState",
    "RobotLimits",
    "RobotMachine",
]


@dataclass(frozen=True, slots=True)
class RobotDriveState:
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

    - `following_mm`, `following_rad`: largest permitted difference between commanded and measured position.
    - `fastest_mm_s`, `fastest_rad_s`: measured speed above which the encoder is assumed to have jumped.
    - `still`: an axis counts as not moving if its measured motion is less than this share of the commanded motion.
    """

    following_mm: float = 0.2
    following_rad: float = 0.05
    fastest_mm_s: float = 200.0
    fastest_rad_s: float = 50.0
    still: float = 0.1


class DriveWatch:
    """Compares the measured positions of both axes with the commanded positions and with the previous ones."""

    def __init__(self, limits: DriveLimits | None = None) -> None:
        limits = DriveLimits() if limits is None else limits
        self._insertion = _AxisWatch(limits.following_mm, limits.fastest_mm_s, limits.still)
        self._roll = _AxisWatch(limits.following_rad, limits.fastest_rad_s, limits.still)

    def forget(self) -> None:
        """Forget the previous positions, so that the next state may have any position."""
        self._insertion.begin = self._insertion.last = self._roll.begin = self._roll.last = None

    def see(self, state: RobotDriveState, time_s: float) -> Fault:
        """Record a state and return its faults: those reported by the drives and those found by the comparison."""
        return (
            state.faults
            | self._insertion.see(state.wanted_depth_mm, state.depth_mm, time_s)
            | self._roll.see(state.wanted_roll_rad, state.roll_rad, time_s)
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


Peer = tuple[str, int]

_NANO = 1_000_000_000
_WRAP = 1 << 32
_MOST_OVERRUNS = 65_535  # largest number of late ticks that fits into a status
_REMEMBERED_SESSIONS = 64  # number of ended sessions whose commands and new HELLO are refused
_SENT_BY_ROBOT = 0x80  # bit that is set in the kind of every datagram that a robot sends
_TIMELESS = (RobotKind.HELLO, RobotKind.STOP, RobotKind.GOODBYE)  # commands without a deadline


@dataclass(frozen=True)
class RobotLimits:
    """Times without a datagram from the controller after which the robot reacts.

    While the robot moves, it stops after `silence_s`. The controller may request another time, which is limited to
    `shortest_silence_s` to `longest_silence_s`. After `release_s` the robot ends the session and accepts another one.
    """

    silence_s: float = 0.03
    shortest_silence_s: float = 0.005
    longest_silence_s: float = 0.34
    release_s: float = 5.0


@dataclass
class RobotCounts:
    """Numbers of datagrams by problem; one datagram may have several problems."""

    malformed: int = 0
    other_versions: int = 0
    refused: int = 0
    late: int = 0
    repeated: int = 0
    """Datagrams whose sequence number is not higher than that of an earlier datagram."""


class _Session:
    """The session of one controller, with the numbers and times of its last datagram."""

    def __init__(self, hello: RobotCommand, peer: Peer, now_ns: int) -> None:
        self.id, self.peer = hello.head.session, peer
        self.sequence, self.number = hello.head.sequence, hello.head.number
        self.result = Result.ACCEPTED
        self.accepted = self.number
        self.received_ns = self.echo_received_ns = now_ns
        self.echo_ns = hello.head.sent_ns
        self.silence_ns = 0
        self.statuses = self.missed = 0


class RobotMachine:
    """A robot that moves `drive`. The caller of `tick` counts its own late calls in `overruns`."""

    def __init__(self, drive: RobotDrive, limits: RobotLimits | None = None, axes: DriveLimits | None = None) -> None:
        self.drive = drive
        self.limits = RobotLimits() if limits is None else limits
        self.state = RobotState.DISABLED
        self.faults = Fault(0)
        self.counts = RobotCounts()
        self.overruns = 0
        self._watch = DriveWatch(axes)
        self._session: _Session | None = None
        self._ended: deque[int] = deque(maxlen=_REMEMBERED_SESSIONS)
        self._answers = 0
        self._now_ns = 0
        self._last: RobotDriveState | None = None
        self._limited = 0.0
        """Direction in which the limit switch was reached: 1 inwards, -1 outwards, 0 if never reached."""

    @property
    def controller(self) -> Peer | None:
        """Host and port of the controller in the present session, or None without a session."""
        return None if self._session is None else self._session.peer

    def receive(self, datagram: bytes, sender: Peer, now_ns: int) -> bytes:
        """Execute a received datagram and return the answer to its sender; b"" if the datagram gets no answer."""
        self._now_ns = now_ns
        try:
            command = decode(datagram)
        except OtherVersion as other:
            self.counts.other_versions += 1
            if other.kind & _SENT_BY_ROBOT:
                return b""  # otherwise two robots would answer each other without end
            return self._encode(Head(0, self._count(), now_ns), other.kind, Result.WRONG_VERSION)
        except ProtocolError:
            self.counts.malformed += 1
            return b""
        if not isinstance(command, RobotCommand):
            self.counts.malformed += 1
            return b""
        result = self._greet(command, sender) if command.kind is RobotKind.HELLO else self._validate(command, sender)
        if result is None:
            return b""
        self.counts.refused += result is not Result.ACCEPTED
        held_us = 0  # the answer is sent at once
        asked = command.head
        head = Head(asked.session, self._count(), now_ns, asked.sent_ns, held_us, asked.number)
        return self._encode(head, command.kind, result)

    def tick(self, now_ns: int) -> tuple[bytes, Peer] | None:
        """Advance the drives to `now_ns`, and stop them on a fault, or if the controller is silent during a motion.

        End the session if the controller is silent for `release_s`. Return the status datagram and its recipient, or
        None without a session.
        """
        self._now_ns = now_ns
        before, state = self._last, self.drive.advance(now_ns / _NANO)
        self._last = state
        found = self._watch.see(state, now_ns / _NANO)
        if before is not None and Fault.LIMIT in state.faults & before.faults:
            # The axis may move away from the limit switch; `_move` refuses the other direction.
            found &= ~Fault.LIMIT
        elif Fault.LIMIT in state.faults:
            self._limited = math.copysign(1.0, state.velocity_mm_s)
        session = self._session
        if session is not None:
            silent_ns = now_ns - session.received_ns
            if state.moving and self.state is RobotState.ENABLED and silent_ns > session.silence_ns:
                found |= Fault.WATCHDOG
            if silent_ns > self.limits.release_s * _NANO:
                self._end()
        if found:
            self.faults |= found
            if self.state is not RobotState.FAULT:
                self.state = RobotState.FAULT
                self.drive.stop()
        if self._session is None:
            return None
        return encode(self._status(self._session, state)), self._session.peer

    def _status(self, session: _Session, state: RobotDriveState) -> RobotStatus:
        session.statuses = (session.statuses + 1) % _WRAP
        held_us = min((self._now_ns - session.echo_received_ns) // 1000, _WRAP - 1)
        head = Head(session.id, session.statuses, self._now_ns, session.echo_ns, held_us, session.accepted)
        return RobotStatus(
            head, state.depth_mm, state.velocity_mm_s, state.roll_rad, state.velocity_rad_s, self.faults, self.state,
            state.moving, min(self.overruns, _MOST_OVERRUNS), session.missed,
        )  # fmt: skip

    def _greet(self, hello: RobotCommand, sender: Peer) -> Result:
        session, asked = self._session, hello.head.session
        if session is not None:
            return Result.ACCEPTED if (session.id, session.peer) == (asked, sender) else Result.BUSY
        if asked == 0 or asked in self._ended:
            return Result.OLD_SESSION
        self._session = _Session(hello, sender, self._now_ns)
        self._renew(self._session, hello)
        return Result.ACCEPTED

    def _validate(self, command: RobotCommand, sender: Peer) -> Result | None:
        session, head = self._session, command.head
        if command.kind is RobotKind.STOP and head.session == 0:
            # Any sender may stop the robot, also without a session.
            self.drive.stop()
            return Result.ACCEPTED
        if session is None or head.session != session.id:
            return Result.OLD_SESSION
        if sender != session.peer:
            return Result.BUSY
        ahead = (head.sequence - session.sequence) % _WRAP
        newer = 0 < ahead < _WRAP // 2
        if newer:
            session.sequence = head.sequence
            session.missed = (session.missed + ahead - 1) % _WRAP
        else:
            self.counts.repeated += 1
        late = command.kind not in _TIMELESS and self._now_ns > command.deadline_ns
        self.counts.late += late
        if newer and not late:
            self._renew(session, command)
        if command.kind is RobotKind.ALIVE:
            return None
        after = (head.number - session.number) % _WRAP
        if after == 0:
            return session.result
        if after >= _WRAP // 2:
            return Result.SUPERSEDED
        session.number = head.number
        session.result = Result.LATE if late else self._obey(command)
        if session.result is Result.ACCEPTED:
            session.accepted = head.number
        return session.result

    def _renew(self, session: _Session, command: RobotCommand) -> None:
        limits = self.limits
        asked_s = command.silence_us / 1e6 or limits.silence_s
        session.silence_ns = round(_NANO * min(max(asked_s, limits.shortest_silence_s), limits.longest_silence_s))
        session.received_ns = session.echo_received_ns = self._now_ns
        session.echo_ns = command.head.sent_ns

    def _obey(self, command: RobotCommand) -> Result:
        if command.kind is RobotKind.STOP:
            self.drive.stop()
        elif command.kind is RobotKind.GOODBYE:
            self._end()
        elif command.kind is RobotKind.RESET:
            return self._reset()
        elif self.state is RobotState.FAULT:
            return Result.IN_FAULT
        elif command.kind is RobotKind.ENABLE:
            self.state = RobotState.ENABLED
        elif self.state is not RobotState.ENABLED:
            return Result.NOT_ENABLED
        else:
            return self._move(command)
        return Result.ACCEPTED

    def _move(self, command: RobotCommand) -> Result:
        if not (math.isfinite(command.target) and math.isfinite(command.speed) and command.speed > 0):
            return Result.OUT_OF_RANGE
        state = self._last
        limited = state is not None and Fault.LIMIT in state.faults and command.kind is RobotKind.INSERT
        if state is not None and limited and (command.target - state.depth_mm) * self._limited > 0:
            return Result.OUT_OF_RANGE
        try:
            begin = self.drive.insert if command.kind is RobotKind.INSERT else self.drive.rotate
            begin(command.target, command.speed)
        except DeviceFault:
            return Result.OUT_OF_RANGE
        return Result.ACCEPTED

    def _reset(self) -> Result:
        self._last = self.drive.advance(self._now_ns / _NANO)
        if self._last.faults & ~Fault.LIMIT:
            return Result.IN_FAULT
        if self.state is RobotState.FAULT:
            self.state, self.faults = RobotState.DISABLED, Fault(0)
            self._watch.forget()
        return Result.ACCEPTED

    def _end(self) -> None:
        """Stop the drives, disable the robot if it is enabled, and end the session."""
        self.drive.stop()
        if self.state is RobotState.ENABLED:
            self.state = RobotState.DISABLED
        if self._session is not None:
            self._ended.append(self._session.id)
        self._session = None

    def _count(self) -> int:
        self._answers = (self._answers + 1) % _WRAP
        return self._answers

    def _encode(self, head: Head, asked: int, result: Result) -> bytes:
        return encode(Answer(head, asked, result, self.state))
