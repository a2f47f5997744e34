"""The robot side of the protocol, without socket and clock: the state machine and the monitoring of the drives.

The robot obeys one controller in one session, within the limits that the session has agreed in HELLO. The robot stops
if it receives nothing from the controller during a motion, if another sender orders a stop, if a drive or the emergency
stop reports a fault, if an axis is not at its commanded position, or if a measured position leaves the limits. Faults
latch: after the cause is gone, RESET and then ENABLE permit motion again. The robot then waits for a new motion
command. A stop is repeated to the drive in every tick in which an axis still moves, until the next motion command.
"""

from __future__ import annotations

import math
import secrets
from collections import deque

from needleplan.devices.robot._drives import (
    DriveLimits,
    DriveRest,
    DriveStandstill,
    DriveStop,
    DriveWatch,
    RobotCounts,
    RobotDrive,
    RobotDriveState,
    RobotLimits,
)
from needleplan.devices.robot._witnesses import StopWitnesses
from needleplan.devices.robot.messages import (
    Answer,
    Fault,
    Head,
    Hello,
    MotionLimits,
    NotAuthentic,
    OtherVersion,
    Result,
    RobotCommand,
    RobotKind,
    RobotState,
    RobotStatus,
    Seal,
    decode,
    encode,
)
from needleplan.errors import DeviceFault, ProtocolError

__all__ = ["Peer", "RobotMachine"]


Peer = tuple[str, int]

_NANO = 1_000_000_000
_WRAP = 1 << 32
_MOST_OVERRUNS = 65_535  # largest number of late ticks that fits into a status
_REMEMBERED_SESSIONS = 64  # number of ended sessions whose commands and new HELLO are refused
_COMPACT_NS = 2_500_000  # time (ns) between two compact statuses, for all recipients together: two thirds of a line
_SENT_BY_ROBOT = 0x80  # bit that is set in the kind of every datagram that a robot sends
_TIMELESS = (RobotKind.HELLO, RobotKind.STOP, RobotKind.GOODBYE, RobotKind.UNHOME)  # commands without a deadline


class _Session:
    """The session of one controller, with its limits, and the numbers and times of its last datagram."""

    def __init__(self, hello: Hello, limits: MotionLimits, peer: Peer, now_ns: int) -> None:
        self.id, self.peer, self.limits = hello.head.session, peer, limits
        self.version = hello.head.version
        self.nonce = secrets.randbits(64)
        self.sequence, self.number = hello.head.sequence, hello.head.number
        self.result = Result.ACCEPTED
        self.accepted = self.number
        self.received_ns = self.echo_received_ns = now_ns
        self.echo_ns = hello.head.sent_ns
        self.silence_ns = 0
        self.statuses = self.missed = 0
        self.silent, self.stopping = DriveStandstill(), DriveStandstill()
        """Standstill since the controller is silent for `silence_ns`, and since it sends nothing but STOP."""


class RobotMachine:
    """A robot that moves `drive`. The caller of `tick` counts its own late calls in `overruns`.

    With a `key`, the robot obeys only datagrams that are authenticated with it, except for a STOP without a session.
    `homed` tells whether the zero is known at the start: choose False for encoders that lose it with the power. An
    encoder that jumps loses the zero, too, until the controller orders HOME. Raises ProtocolError if the key is shorter
    than 16 bytes.
    """

    def __init__(
        self, drive: RobotDrive, limits: RobotLimits | None = None, axes: DriveLimits | None = None,
        key: bytes | None = None, *, homed: bool = True,
    ) -> None:  # fmt: skip
        self.drive = drive
        self.homed: bool = homed
        self.limits: RobotLimits = RobotLimits() if limits is None else limits
        self._seal = None if key is None else Seal(key)
        self.state: RobotState = RobotState.DISABLED
        self.faults: Fault = Fault(0)
        self.counts: RobotCounts = RobotCounts()
        self.overruns = 0
        self.compact: bool = False
        """Whether statuses are compact, and leave every 2.5 ms instead of at every tick, as on a serial line."""

        self._due_ns = 0
        self._watch = DriveWatch(axes)
        self._stop, self._rest, self._stands = DriveStop(drive), DriveRest(), False
        self._witnesses = StopWitnesses()
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
        if not isinstance(command, Hello | RobotCommand):
            self.counts.malformed += 1
            return b""
        if not self._is_authentic(command, datagram):
            self.counts.not_authentic += 1
            return self._answer(command, Result.NOT_AUTHENTIC)
        result = self._greet(command, sender) if isinstance(command, Hello) else self._validate(command, sender)
        if result is None:
            return b""
        self.counts.refused += result is not Result.ACCEPTED
        return self._answer(command, result)

    def _is_authentic(self, command: Hello | RobotCommand, datagram: bytes) -> bool:
        """Return whether the robot has no key, or the datagram has the tag of its session.

        HELLO has the tag with the nonce 0. A STOP without a session needs no tag: anyone may stop the robot.
        """
        if self._seal is None or _stops_for_any(command):
            return True
        try:
            decode(datagram, self._seal if isinstance(command, Hello) else self._session_seal())
        except NotAuthentic:
            return False
        return True

    def _session_seal(self) -> Seal | None:
        if self._seal is None or self._session is None:
            return self._seal
        return Seal(self._seal.key, self._session.nonce)

    def _answer(self, command: Hello | RobotCommand, result: Result) -> bytes:
        asked = command.head
        held_us = 0  # the answer is sent at once
        head = Head(asked.session, self._count(), self._now_ns, asked.sent_ns, held_us, asked.number, asked.version)
        return self._encode(head, command.kind, result)

    def tick(self, now_ns: int) -> tuple[bytes, Peer] | None:
        """Advance the drives to `now_ns`, and stop them on a fault, or if the controller is silent during a motion.

        End the session if the controller is silent for `release_s`. Return a status datagram and its recipient: the
        controller or, every 5 ms for a while, the sender of a STOP without a session; None if there is neither.
        """
        self._now_ns = now_ns
        before, state = self._last, self.drive.advance(now_ns / _NANO)
        self._last = state
        self._stop.see(state)
        self._stands = self._rest.stands(state, now_ns / _NANO)
        session = self._session
        motion = self.limits.motion if session is None else session.limits
        faults = self._watch.see(state, now_ns / _NANO, motion)
        if before is not None and Fault.LIMIT in state.faults & before.faults:
            # The axis may move away from the limit switch; `_move` refuses the other direction.
            faults &= ~Fault.LIMIT
        elif Fault.LIMIT in state.faults:
            self._limited = math.copysign(1.0, state.velocity_mm_s)
        if session is not None:
            silent_ns = now_ns - session.received_ns
            if silent_ns <= session.silence_ns:
                session.silent.forget()
            elif (session.silent.is_left(state) or state.moving) and self.state is RobotState.ENABLED:
                faults |= Fault.WATCHDOG
            if silent_ns > self.limits.release_s * _NANO:
                self._end()
        if faults:
            self.faults |= faults
            self.homed = self.homed and Fault.ENCODER not in faults
            if self.state is not RobotState.FAULT:
                self.state = RobotState.FAULT
                self._stop.begin()
        if self.compact:
            if now_ns < self._due_ns:
                return None
            self._due_ns = max(self._due_ns + _COMPACT_NS, now_ns)
        witness = self._witnesses.due(now_ns)
        if witness is not None:
            return encode(self._status_of(witness.head(now_ns), state, missed=0), self._seal), witness.peer
        if self._session is None:
            return None
        return encode(self._status(self._session, state), self._session_seal()), self._session.peer

    def _status(self, session: _Session, state: RobotDriveState) -> RobotStatus:
        session.statuses = (session.statuses + 1) % _WRAP
        held_us = min((self._now_ns - session.echo_received_ns) // 1000, _WRAP - 1)
        echo_ns, accepted = session.echo_ns, session.accepted
        head = Head(session.id, session.statuses, self._now_ns, echo_ns, held_us, accepted, session.version)
        return self._status_of(head, state, session.missed)

    def _status_of(self, head: Head, state: RobotDriveState, missed: int) -> RobotStatus:
        return RobotStatus(
            head, state.depth_mm, state.velocity_mm_s, state.roll_rad, state.velocity_rad_s, self.faults, self.state,
            state.moving, min(self.overruns, _MOST_OVERRUNS), missed, self.homed, self._stands, self.compact,
        )  # fmt: skip

    def _greet(self, hello: Hello, sender: Peer) -> Result:
        session, asked = self._session, hello.head.session
        if session is not None:
            return Result.ACCEPTED if (session.id, session.peer) == (asked, sender) else Result.BUSY
        if asked == 0 or asked in self._ended:
            return Result.OLD_SESSION
        limits = hello.limits.within(self.limits.motion)
        if isinstance(limits, Result):
            return limits
        self._session = _Session(hello, limits, sender, self._now_ns)
        self._watch.begin_session()
        self._renew(self._session, hello)
        return Result.ACCEPTED

    def _validate(self, command: RobotCommand, sender: Peer) -> Result | None:
        session, head = self._session, command.head
        if _stops_for_any(command):
            self._stop_for_any()
            self._witnesses.add(sender, head, self._now_ns)
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
        session.result = Result.LATE if late else self._obey(session, command)
        if session.result is Result.ACCEPTED:
            session.accepted = head.number
        return session.result

    def _stop_for_any(self) -> None:
        """Stop for a sender without a session. In a session this is a fault, because its controller does not know it.

        Thereby the next status shows the stop, and a motion that the controller sends meanwhile is refused.
        """
        self.counts.foreign_stops += 1
        self._stop.begin()
        if self._session is not None:
            self.faults |= Fault.FOREIGN_STOP
            self.state = RobotState.FAULT

    def _renew(self, session: _Session, command: Hello | RobotCommand) -> None:
        limits = self.limits
        asked_s = command.silence_us / 1e6 or limits.silence_s
        session.silence_ns = round(_NANO * min(max(asked_s, limits.shortest_silence_s), limits.longest_silence_s))
        session.echo_received_ns, session.echo_ns = self._now_ns, command.head.sent_ns
        # A STOP is no sign of life while the robot moves: else a controller that stops in vain would feed the watchdog.
        if command.kind is not RobotKind.STOP:
            session.stopping.forget()
        elif self._last is not None and (session.stopping.is_left(self._last) or self._last.moving):
            return
        session.received_ns = self._now_ns

    def _obey(self, session: _Session, command: RobotCommand) -> Result:
        if command.kind is RobotKind.STOP:
            self._stop.begin()
        elif command.kind is RobotKind.GOODBYE:
            self._end()
        elif command.kind is RobotKind.RESET:
            return self._reset()
        elif command.kind is RobotKind.UNHOME:
            self.homed = False
        elif self.state is RobotState.FAULT:
            return Result.IN_FAULT
        elif command.kind is RobotKind.HOME:
            self.homed = True
        elif command.kind is RobotKind.ENABLE:
            self.state = RobotState.ENABLED
        elif self.state is not RobotState.ENABLED:
            return Result.NOT_ENABLED
        else:
            return self._move(session, command)
        return Result.ACCEPTED

    def _move(self, session: _Session, command: RobotCommand) -> Result:
        against = session.limits.against(command, self._now_ns)
        if against is not None:
            return against
        state = self._last
        limited = state is not None and Fault.LIMIT in state.faults and command.kind is RobotKind.INSERT
        if state is not None and limited and (command.target - state.depth_mm) * self._limited > 0:
            return Result.OUT_OF_RANGE
        try:
            begin = self.drive.insert if command.kind is RobotKind.INSERT else self.drive.rotate
            begin(command.target, command.speed)
        except DeviceFault:
            return Result.OUT_OF_RANGE
        self._stop.end()
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
        self._stop.begin()
        if self.state is RobotState.ENABLED:
            self.state = RobotState.DISABLED
        if self._session is not None:
            self._ended.append(self._session.id)
        self._session = None

    def _count(self) -> int:
        self._answers = (self._answers + 1) % _WRAP
        return self._answers

    def _encode(self, head: Head, asked: int, result: Result) -> bytes:
        """Encode an answer; only the answer to HELLO has the tag with the nonce 0, and contains the nonce."""
        session = self._session if head.session and self._session and head.session == self._session.id else None
        if asked == RobotKind.HELLO or session is None:
            nonce = session.nonce if session is not None and asked == RobotKind.HELLO else 0
            return encode(Answer(head, asked, result, self.state, nonce), self._seal)
        return encode(Answer(head, asked, result, self.state), self._session_seal())


def _stops_for_any(command: Hello | RobotCommand) -> bool:
    """Return whether the command is a STOP without a session, which any sender may send."""
    return command.kind is RobotKind.STOP and command.head.session == 0
