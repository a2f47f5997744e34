"""The robot side of the protocol, without socket and clock: the state machine, and the monitoring of its drives.

The robot obeys one controller in one session. It stops if it receives nothing from the controller while it moves, if a
drive or the emergency stop reports a fault, and if an axis is not at its commanded position. These faults latch: once
the cause is gone, RESET and then ENABLE permit motion again, which needs a new command.
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
    """What encoders and drives say, and where the axes should be by now."""

    depth_mm: float
    velocity_mm_s: float
    roll_rad: float
    velocity_rad_s: float
    wanted_depth_mm: float
    wanted_roll_rad: float
    moving: bool
    faults: Fault = Fault(0)
    """What the drives report themselves: a fault, a limit switch, the emergency stop."""


class RobotDrive(Protocol):
    """Two axes with their servo."""

    def advance(self, time_s: float) -> RobotDriveState:
        """Go on to a time, and say where the axes are."""

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin to move to a depth. Raises DeviceFault for what cannot be."""

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin to turn to a roll. Raises DeviceFault for what cannot be."""

    def stop(self) -> None:
        """Stop both axes as fast as can be."""


@dataclass(frozen=True)
class DriveLimits:
    """What the capture side takes for a fault of an axis."""

    following_mm: float = 0.2
    following_rad: float = 0.05
    fastest_mm_s: float = 200.0
    fastest_rad_s: float = 50.0
    """An encoder that goes faster has jumped."""

    still: float = 0.1
    """An axis that has gone less than this share of its way does not move."""


class DriveWatch:
    """Compares where the axes are with where they should be, and with where they were."""

    def __init__(self, limits: DriveLimits | None = None) -> None:
        limits = DriveLimits() if limits is None else limits
        self._insertion = _AxisWatch(limits.following_mm, limits.fastest_mm_s, limits.still)
        self._roll = _AxisWatch(limits.following_rad, limits.fastest_rad_s, limits.still)

    def forget(self) -> None:
        """What comes next may be anywhere, as after a repair."""
        self._insertion.begin = self._insertion.last = self._roll.begin = self._roll.last = None

    def see(self, state: RobotDriveState, time_s: float) -> Fault:
        """Return what is wrong."""
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
        """Where the axis should be and was when it last followed well."""

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
_MOST_OVERRUNS = 65_535
_REMEMBERED_SESSIONS = 64
_OF_CAPTURE_SIDE = 0x80
_TIMELESS = (RobotKind.HELLO, RobotKind.STOP, RobotKind.GOODBYE)


@dataclass(frozen=True)
class RobotLimits:
    """How long the robot believes in a controller that it does not hear."""

    silence_s: float = 0.03
    """It stops after so long where the controller does not ask for another time."""

    shortest_silence_s: float = 0.005
    longest_silence_s: float = 0.34
    release_s: float = 5.0
    """It takes another controller after so long."""


@dataclass
class RobotCounts:
    """What came from controllers, and was not obeyed."""

    malformed: int = 0
    other_versions: int = 0
    refused: int = 0
    late: int = 0
    repeated: int = 0
    """Datagrams that came twice, or behind a newer one."""


class _Session:
    """One controller, and what it said last."""

    def __init__(self, hello: RobotCommand, peer: Peer, now_ns: int) -> None:
        self.id, self.peer = hello.head.session, peer
        self.sequence, self.number = hello.head.sequence, hello.head.number
        self.result = Result.ACCEPTED
        self.accepted = self.number
        self.heard_ns = self.echo_received_ns = now_ns
        self.echo_ns = hello.head.sent_ns
        self.silence_ns = 0
        self.statuses = self.missed = 0


class RobotMachine:
    """A robot that moves `drive`; `overruns` is for who calls `tick` to count in."""

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
        """The direction in which the limit switch was reached."""

    @property
    def controller(self) -> Peer | None:
        """Who has the robot."""
        return None if self._session is None else self._session.peer

    def receive(self, datagram: bytes, sender: Peer, now_ns: int) -> bytes:
        """Obey a datagram, and return the answer to its sender; empty where there is none."""
        self._now_ns = now_ns
        try:
            command = decode(datagram)
        except OtherVersion as other:
            self.counts.other_versions += 1
            if other.kind & _OF_CAPTURE_SIDE:
                return b""  # two robots do not answer each other without end
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
        held_us = 0  # it is answered at once
        asked = command.head
        head = Head(asked.session, self._count(), now_ns, asked.sent_ns, held_us, asked.number)
        return self._encode(head, command.kind, result)

    def tick(self, now_ns: int) -> tuple[bytes, Peer] | None:
        """Go on to `now_ns`: see to drives and watchdog, and return the status and who is to have it."""
        self._now_ns = now_ns
        before, state = self._last, self.drive.advance(now_ns / _NANO)
        self._last = state
        found = self._watch.see(state, now_ns / _NANO)
        if before is not None and Fault.LIMIT in state.faults & before.faults:
            # It may be led back from where it is; `_move` sees to it that it is.
            found &= ~Fault.LIMIT
        elif Fault.LIMIT in state.faults:
            self._limited = math.copysign(1.0, state.velocity_mm_s)
        session = self._session
        if session is not None:
            silent_ns = now_ns - session.heard_ns
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
        self._hear(self._session, hello)
        return Result.ACCEPTED

    def _validate(self, command: RobotCommand, sender: Peer) -> Result | None:
        session, head = self._session, command.head
        if command.kind is RobotKind.STOP and head.session == 0:
            # Anybody may stop it, without having it.
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
            self._hear(session, command)
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

    def _hear(self, session: _Session, command: RobotCommand) -> None:
        limits = self.limits
        asked_s = command.silence_us / 1e6 or limits.silence_s
        session.silence_ns = round(_NANO * min(max(asked_s, limits.shortest_silence_s), limits.longest_silence_s))
        session.heard_ns = session.echo_received_ns = self._now_ns
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
        """Stop, disable, and be free for another controller."""
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
