"""The session of a controller with a robot: commands, answers, statuses, and the clock of the robot."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from itertools import count

from needleplan.devices._clock import Clock, Deadline
from needleplan.devices._links import Link
from needleplan.devices.robot.messages import (
    VERSION,
    Answer,
    Head,
    Hello,
    MotionLimits,
    NotAuthentic,
    OtherVersion,
    Result,
    RobotCommand,
    RobotKind,
    RobotMessage,
    RobotStatus,
    Seal,
    decode,
    encode,
)
from needleplan.errors import ProtocolError

__all__ = ["RobotClock", "RobotConversation", "StatusCounts", "StatusWatch"]

_WRAP = 1 << 32
_HALF = _WRAP // 2
_WINDOW_NS = 5_000_000_000  # length of a window of RobotClock, which uses the present and the previous window


@dataclass
class StatusCounts:
    """Numbers of received and lost statuses and of discarded datagrams in this session."""

    received: int = 0
    lost: int = 0
    repeated: int = 0
    """Statuses that are not newer than the last one; they are discarded."""

    unread: int = 0
    """Statuses discarded because the queue was full: nobody read them in time."""

    malformed: int = 0
    foreign: int = 0
    """Datagrams of another session, or of another controller."""

    not_authentic: int = 0
    """Datagrams that are not authenticated with the key of this session."""


class StatusWatch:
    """Checks the sequence numbers of the statuses, and counts received, lost and repeated statuses."""

    def __init__(self) -> None:
        self.counts = StatusCounts()
        self._last: int | None = None

    def see(self, sequence: int) -> int | None:
        """Count a status, and return the number of statuses lost before it; None if it is not newer than the last."""
        ahead = 1 if self._last is None else (sequence - self._last) % _WRAP
        if not 0 < ahead < _HALF:
            self.counts.repeated += 1
            return None
        self._last = sequence
        self.counts.received += 1
        self.counts.lost += ahead - 1
        return ahead - 1


class RobotClock:
    """Lower bound of the present time on the robot's clock, and the round-trip time of a datagram.

    A datagram contains the robot's time of sending. The unknown transmission time is taken as zero, so the bound is too
    low by the transmission time. The datagram with the shortest transmission in the last 5 to 10 s is used. Older
    datagrams are not used, because the two clocks drift apart.
    """

    def __init__(self) -> None:
        self.round_trip_s: float | None = None
        """Last measured round-trip time, s."""

        self.worst_round_trip_s = 0.0
        self._ahead_ns: list[int] = []
        self._since_ns = 0
        self._echo_ns = 0

    def see(self, head: Head, now_ns: int) -> None:
        """Update the bound and the round-trip time with the head of a datagram received at `now_ns`."""
        ahead_ns = head.sent_ns - now_ns
        if not self._ahead_ns or now_ns - self._since_ns > _WINDOW_NS:
            self._ahead_ns = [*self._ahead_ns[-1:], ahead_ns]
            self._since_ns = now_ns
        self._ahead_ns[-1] = max(self._ahead_ns[-1], ahead_ns)
        if head.echo_ns > self._echo_ns:
            self._echo_ns = head.echo_ns
            self.round_trip_s = max(now_ns - head.echo_ns - 1000 * head.held_us, 0) / 1e9
            self.worst_round_trip_s = max(self.worst_round_trip_s, self.round_trip_s)

    def at(self, now_ns: int) -> int:
        """Return a lower bound of the robot's time (ns) at the local time `now_ns`; 0 before the first datagram."""
        return max(now_ns + max(self._ahead_ns), 1) if self._ahead_ns else 0


_CATCH_UP_S = 0.02  # longest time (s) for which unread datagrams are read before a motion command is sent
_KEPT = 2000  # largest number of unread statuses; if more arrive, the oldest is discarded
_GONE = (Result.OLD_SESSION, Result.BUSY)  # results that mean that the robot no longer obeys this session


class RobotConversation:
    """One session with a robot over `link`.

    Any thread that waits dispatches the received datagrams for all threads: it passes each answer to the waiting
    command, and appends each status to `statuses` as (status, number of statuses lost before it, time of arrival in
    ns). HELLO requests `limits` for the session. With a `key`, every datagram must be authenticated with it.

    Sending takes no lock, because a thread that holds one may wait for the interpreter: only that a `count` advances is
    needed, which no other thread interrupts. So a STOP is on its way before any received datagram is read.
    """

    def __init__(
        self, link: Link, clock: Clock, session: int, again_s: float, silence_s: float,
        limits: MotionLimits | None = None, key: bytes | None = None,
    ) -> None:  # fmt: skip
        self.link, self._clock, self.session = link, clock, session
        self._again_s, self._silence_us = again_s, round(silence_s * 1e6)
        self._limits = MotionLimits() if limits is None else limits
        self._greeting = self._seal = None if key is None else Seal(key)
        self.watch, self.robot_clock = StatusWatch(), RobotClock()
        self.statuses: deque[tuple[RobotStatus, int, int]] = deque()
        self.received_ns = clock.now_ns()
        self.version = VERSION
        """Version of the protocol in this session: that of the robot, if it is older."""

        self.lost_control: Result | None = None
        """Reason why the robot no longer obeys this session, or None."""

        self._receiving = threading.Lock()
        self._answers: dict[int, Answer | None] = {}
        self._accepted: int | None = None
        self._sequences, self._numbers, self._number = count(1), count(), 0
        self._echo = (0, 0)

    @property
    def last_number(self) -> int:
        """Number of the last command that was sent."""
        return self._number

    def command(
        self, kind: RobotKind, within_s: float, target: float = 0.0, speed: float = 0.0, *, timely: bool = True
    ) -> tuple[Result | None, int]:
        """Send a command repeatedly until it is answered or `within_s` has passed; return its result and its number.

        The result is None without an answer. The robot refuses a `timely` command that arrives after `within_s`. Raises
        OtherVersion if the robot speaks neither this nor the oldest supported version of the protocol, and LinkClosed.
        """
        self._number = number = next(self._numbers) % (_WRAP - 1) + 1
        self._answers[number] = None
        try:
            return self._until_answered(kind, number, within_s, target, speed, timely), number
        finally:
            del self._answers[number]

    def _until_answered(
        self, kind: RobotKind, number: int, within_s: float, target: float, speed: float, timely: bool
    ) -> Result | None:
        if timely:
            self._catch_up()
        deadline_ns = self.robot_clock.at(self._clock.now_ns()) + round(within_s * 1e9) if timely else 0
        deadline = Deadline(self._clock, within_s)
        while True:
            self._send(kind, number, deadline_ns, target, speed)
            patience = Deadline(self._clock, self._again_s)
            while True:
                self.pump(patience.left_s)
                answer = self._answers[number]
                if answer is not None:
                    return answer.result
                if self._accepted == number:
                    return Result.ACCEPTED
                if patience.passed:
                    break
            if deadline.passed:
                return None

    def send_stop(self) -> None:
        """Send one STOP with a number of its own, and do not wait for its answer. Raises LinkClosed."""
        self._number = number = next(self._numbers) % (_WRAP - 1) + 1
        self._send(RobotKind.STOP, number, 0)

    def heartbeat(self, within_s: float) -> None:
        """Send a heartbeat, which the robot ignores if it arrives after `within_s`. Raises LinkClosed."""
        self._send(RobotKind.ALIVE, 0, self.robot_clock.at(self._clock.now_ns()) + round(within_s * 1e9))

    def pump(self, timeout_s: float) -> bool:
        """Wait for a datagram for `timeout_s`, at most `again_s`; dispatch it, and return whether one arrived."""
        with self._receiving:
            data = self.link.receive(min(timeout_s, self._again_s))
            if data:
                self._take(data)
        return bool(data)

    def _catch_up(self) -> None:
        """Dispatch the received datagrams, for at most 20 ms, so that `robot_clock` is up to date."""
        end = Deadline(self._clock, _CATCH_UP_S)
        while self.pump(0) and not end.passed:
            pass

    def _send(self, kind: RobotKind, number: int, deadline_ns: int, target: float = 0.0, speed: float = 0.0) -> None:
        sequence, now_ns = next(self._sequences) % _WRAP, self._clock.now_ns()
        echo_ns, received_ns = self._echo
        held_us = min((now_ns - received_ns) // 1000, _WRAP - 1) if echo_ns else 0
        head = Head(self.session, sequence, now_ns, echo_ns, held_us, number, self.version)
        if kind is RobotKind.HELLO:
            self.link.send(encode(Hello(head, self._limits, self._silence_us), self._greeting))
        else:
            command = RobotCommand(head, kind, deadline_ns, target, speed, self._silence_us)
            self.link.send(encode(command, self._seal))

    def _authentic(self, data: bytes) -> RobotMessage:
        """Decode a datagram of the robot. Only an answer may have the tag with the nonce 0, which needs no session."""
        try:
            return decode(data, self._seal)
        except NotAuthentic:
            message = decode(data, self._greeting)
            if not isinstance(message, Answer):
                raise
            return message

    def _take(self, data: bytes) -> None:
        now_ns = self._clock.now_ns()
        try:
            message = self._authentic(data)
        except OtherVersion:
            raise
        except NotAuthentic:
            self.watch.counts.not_authentic += 1
            return
        except ProtocolError:
            self.watch.counts.malformed += 1
            return
        if isinstance(message, Answer) and message.result is Result.WRONG_VERSION:
            if self._accepted is None:  # HELLO is sent again in the older version of the robot
                self.version = min(self.version, message.head.version)
            return
        if isinstance(message, Hello | RobotCommand) or message.head.session != self.session:
            self.watch.counts.foreign += 1
            return
        head = message.head
        self.robot_clock.see(head, now_ns)
        if isinstance(message, Answer):
            if self._seal is not None and message.asked == RobotKind.HELLO and message.result is Result.ACCEPTED:
                self._seal = Seal(self._seal.key, message.nonce)
            if message.result in _GONE and message.asked != RobotKind.HELLO:
                self.lost_control = message.result
            if head.number in self._answers:
                self._answers[head.number] = message
            return
        lost = self.watch.see(head.sequence)
        if lost is None:
            return
        self.received_ns, self._echo, self._accepted = now_ns, (head.sent_ns, now_ns), head.number
        self.statuses.append((message, lost, now_ns))
        if len(self.statuses) > _KEPT:
            _, lost, _ = self.statuses.popleft()
            oldest, before, received_ns = self.statuses[0]
            self.statuses[0] = (oldest, before + lost + 1, received_ns)
            self.watch.counts.unread += 1
