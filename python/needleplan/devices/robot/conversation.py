"""Commands to the robot and its answers: sent again until they are answered, read by any thread that waits."""

from __future__ import annotations

import threading
from collections import deque

from needleplan.devices.clock import Clock, Deadline
from needleplan.devices.link import Link
from needleplan.devices.robot.codec import OtherVersion, decode, encode
from needleplan.devices.robot.messages import Answer, Command, Head, Kind, Result, Status
from needleplan.devices.robot.statuses import RobotClock, StatusWatch
from needleplan.errors import DeviceFault, ProtocolError

__all__ = ["Conversation"]

_WRAP = 1 << 32
_KEPT = 2000
_GONE = (Result.OLD_SESSION, Result.BUSY)


class Conversation:
    """One session with a robot over `link`.

    Whoever waits reads for all: a status goes to `statuses` with how many are missing before it and when it came, an
    answer to whom it concerns.
    """

    def __init__(self, link: Link, clock: Clock, session: int, again_s: float, silence_s: float) -> None:
        self.link, self._clock, self.session = link, clock, session
        self._again_s, self._silence_us = again_s, round(silence_s * 1e6)
        self.watch, self.robot_clock = StatusWatch(), RobotClock()
        self.statuses: deque[tuple[Status, int, int]] = deque()
        self.heard_ns = clock.now_ns()
        self.lost_control: Result | None = None
        """Why the robot no longer obeys this session."""

        self._receiving, self._counting = threading.Lock(), threading.Lock()
        self._answers: dict[int, Answer | None] = {}
        self._accepted: int | None = None
        self._sequence = self._number = 0
        self._echo = (0, 0)

    @property
    def last_number(self) -> int:
        """The number of the last command."""
        return self._number

    def command(
        self, kind: Kind, within_s: float, target: float = 0.0, speed: float = 0.0, *, timely: bool = True
    ) -> tuple[Result | None, int]:
        """Send a command until it is answered; return what became of it, None where no answer came, and its number.

        A `timely` one is not to be executed after `within_s`. Raises OtherVersion, LinkClosed.
        """
        with self._counting:
            self._number = number = self._number % (_WRAP - 1) + 1
        self._answers[number] = None
        try:
            return self._until_answered(kind, number, within_s, target, speed, timely), number
        finally:
            del self._answers[number]

    def _until_answered(
        self, kind: Kind, number: int, within_s: float, target: float, speed: float, timely: bool
    ) -> Result | None:
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

    def heartbeat(self, within_s: float) -> None:
        """Send a heartbeat that is valid for `within_s`."""
        self._send(Kind.ALIVE, 0, self.robot_clock.at(self._clock.now_ns()) + round(within_s * 1e9))

    def pump(self, timeout_s: float) -> bool:
        """Take one datagram, if one comes, and put it where it belongs; whether one came."""
        with self._receiving:
            data = self.link.receive(min(timeout_s, self._again_s))
            if data:
                self._take(data)
        return bool(data)

    def _catch_up(self) -> None:
        """Take all that waits, so that the time of the robot is that of now."""
        for _ in range(_KEPT):
            if not self.pump(0):
                return

    def _send(self, kind: Kind, number: int, deadline_ns: int, target: float = 0.0, speed: float = 0.0) -> None:
        with self._counting:
            self._sequence = (self._sequence + 1) % _WRAP
            now_ns = self._clock.now_ns()
            echo_ns, received_ns = self._echo
            held_us = min((now_ns - received_ns) // 1000, _WRAP - 1) if echo_ns else 0
            head = Head(self.session, self._sequence, now_ns, echo_ns, held_us, number)
            self.link.send(encode(Command(head, kind, deadline_ns, target, speed, self._silence_us)))

    def _take(self, data: bytes) -> None:
        now_ns = self._clock.now_ns()
        try:
            message = decode(data)
        except OtherVersion:
            raise
        except ProtocolError:
            self.watch.counts.malformed += 1
            return
        if isinstance(message, Answer) and message.result is Result.WRONG_VERSION:
            raise DeviceFault("robot: it does not speak version 1 of the protocol")
        if isinstance(message, Command) or message.head.session != self.session:
            self.watch.counts.foreign += 1
            return
        head = message.head
        self.robot_clock.see(head, now_ns)
        if isinstance(message, Answer):
            if message.result in _GONE and message.asked != Kind.HELLO:
                self.lost_control = message.result
            if head.number in self._answers:
                self._answers[head.number] = message
            return
        lost = self.watch.see(head.sequence)
        if lost is None:
            return
        self.heard_ns, self._echo, self._accepted = now_ns, (head.sent_ns, now_ns), head.number
        self.statuses.append((message, lost, now_ns))
        if len(self.statuses) > _KEPT:
            _, lost, _ = self.statuses.popleft()
            oldest, before, received_ns = self.statuses[0]
            self.statuses[0] = (oldest, before + lost + 1, received_ns)
            self.watch.counts.unread += 1
