"""The session of a controller with a robot: commands, answers, statuses, and the clock of the robot.

The wire to a robot: its datagrams pass through the supervisor of Rust, which also sends without this program.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from needleplan import _ppvi
from needleplan.devices._base import Closing
from needleplan.devices._clock import Clock, Deadline, SystemClock
from needleplan.devices._links import Link, UdpLink
from needleplan.devices.robot._codes import Fault, RobotState
from needleplan.devices.robot._way import RobotWay
from needleplan.devices.robot.messages import (
    VERSION,
    Head,
    MotionLimits,
    OtherVersion,
    Result,
    RobotKind,
    RobotStatus,
    Seal,
)
from needleplan.devices.supervision import GuardNumbers, StageSupervisor, SupervisedLimits, SupervisedTimes
from needleplan.errors import LinkClosed, MotionRefused

if TYPE_CHECKING:
    from needleplan._ppvi_robot import RobotMessage

__all__ = ["RobotClock", "RobotConversation", "RobotWire", "StatusCounts"]


class RobotWire(Closing, StageSupervisor):
    """Sends to a robot and receives from it over `link`.

    On a UDP link with the clock of this machine, two threads of Rust own the socket. They never wait for the Python
    interpreter: a STOP and the heartbeats leave while Python computes or hangs. On any other link, such as a simulated
    one with a virtual clock, the same decisions are made whenever this program sends or receives. The link to a robot
    on a serial line is a UDP link to the threads of Rust that own the line, its `way`.
    """

    def __init__(self, link: Link, clock: Clock, way: RobotWay | None = None) -> None:
        self._link, self._clock, self._way = link, clock, way
        self.supervisor: _ppvi.RobotSupervisor = _ppvi.RobotSupervisor(clock.now_ns())
        self.is_native: bool = type(link) is UdpLink and isinstance(clock, SystemClock)
        """Whether the threads of Rust own the socket."""

        self.local_port: int = link.local_port if isinstance(link, UdpLink) else 0
        """The port of this machine that receives the datagrams of the robot; 0 if the link is not UDP."""

        if self.is_native:
            assert isinstance(link, UdpLink)
            self.supervisor.serve(link.hand_over(), *link.peer, clock.now_ns())

    def begin(self, session: int, silence_s: float, limits: MotionLimits, key: bytes | None) -> None:
        """Begin a session; nothing is sent."""
        numbers = (limits.least_mm, limits.most_mm, limits.speed_mm_s, limits.roll_rad, limits.rotation_rad_s)
        self.supervisor.begin(session, numbers, round(silence_s * 1e6), limits.valid_us, key, self._clock.now_ns())

    def send(self, kind: RobotKind, number: int, deadline_ns: int = 0, target: float = 0.0, speed: float = 0.0) -> bool:
        """Send a datagram; return whether the supervisor has let it pass. Raises LinkClosed."""
        data = self.supervisor.send(kind, number, deadline_ns, (target, speed), self._clock.now_ns())
        if data:
            self._link.send(data)
        return data is not None

    def receive(self, timeout_s: float) -> RobotMessage | None:
        """Return the next datagram of the robot, decoded; None after `timeout_s`. Raises LinkClosed."""
        if self._way is not None and self._way.failure:
            raise LinkClosed(f"robot: {self._way.failure}")
        if self.is_native:
            try:
                return self.supervisor.receive(timeout_s)
            except OSError as error:
                raise LinkClosed(f"udp: {error}") from error
        data = self._link.receive(timeout_s)
        message = self.supervisor.take(data, self._clock.now_ns()) if data else None
        self._act()
        return message

    def _act(self) -> None:
        """Send what the supervisor has decided to send."""
        if not self.is_native:
            for data in self.supervisor.due(self._clock.now_ns()):
                self._link.send(data)

    def seen(self, stage_age_s: float) -> tuple[int, int, int, int]:
        """Return the number of trips, the causes and time (ns) of the last trip, and the causes by old samples."""
        return self.supervisor.seen(stage_age_s, self._clock.now_ns())

    def post(self, limits: SupervisedLimits, state: GuardNumbers, trips: int | None, times: SupervisedTimes) -> None:
        """Post the state of the guard, and the times of its inputs."""
        self.supervisor.post(limits, state, trips, *times, self._clock.now_ns())

    def tick(self) -> None:
        """Note that the loop of the program runs."""
        self.supervisor.tick(self._clock.now_ns())
        self._act()

    def withhold(self) -> None:
        """Send no heartbeat until the next `tick`."""
        self.supervisor.withhold()

    def close(self) -> None:
        """End the threads, and close the link and the way to the robot."""
        self.supervisor.close()
        self._link.close()
        if self._way is not None:
            self._way.close()


@dataclass(frozen=True)
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


@dataclass(frozen=True)
class RobotClock:
    """Round-trip times of datagrams (s): the last one, None before the first, and the longest one."""

    round_trip_s: float | None
    worst_round_trip_s: float


_CATCH_UP_S = 0.02  # longest time (s) for which unread datagrams are read before a motion command is sent
_KEPT = 2000  # largest number of unread statuses; if more arrive, the oldest is discarded
# Kinds of messages of the supervisor
_STATUS: Final = 0
_ANSWER: Final = 1
_OTHER_VERSION: Final = 2
_MOVING, _HOMED, _STANDING = 1, 2, 4  # bits of `flags` of a status


class RobotConversation:
    """One session with a robot over `wire`.

    Any thread that waits dispatches the received messages for all threads: it passes each answer to the waiting
    command, and appends each status to `statuses` as (status, number of statuses lost before it, time of arrival in
    ns). HELLO requests `limits` for the session. With a `key`, every datagram must be authenticated with it.

    Sending does not wait for a received datagram to be dispatched, so a STOP is on its way at once.
    """

    def __init__(
        self, wire: RobotWire, clock: Clock, session: int, again_s: float, silence_s: float,
        limits: MotionLimits | None = None, key: bytes | None = None,
    ) -> None:  # fmt: skip
        if key is not None:
            Seal(key)  # raises ProtocolError if the key is too short
        self.wire = wire
        self.session = session
        self._clock, self._again_s = clock, again_s
        self._supervisor = wire.supervisor
        wire.begin(session, silence_s, MotionLimits() if limits is None else limits, key)
        self.statuses: deque[tuple[RobotStatus, int, int]] = deque()
        self.begun_ns: int = clock.now_ns()
        """Time (ns) since which the robot is expected to send statuses."""

        self._unread = 0
        self._receiving = threading.Lock()
        self._answers: dict[int, Result | None] = {}

    @property
    def last_number(self) -> int:
        """Number of the last command that was sent."""
        return self._supervisor.last_number

    @property
    def version(self) -> int:
        """Version of the protocol in this session: that of the robot, if it is older."""
        return self._supervisor.version

    @property
    def lost_control(self) -> Result | None:
        """Reason why the robot no longer obeys this session, or None."""
        reason = self._supervisor.lost_control
        return None if reason is None else Result(reason)

    @property
    def received_ns(self) -> int:
        """Time of arrival (ns) of the last status."""
        return max(self._supervisor.received_ns, self.begun_ns)

    @property
    def counts(self) -> StatusCounts:
        """Numbers of datagrams in this session."""
        received, lost, repeated, unread, malformed, foreign, not_authentic = self._supervisor.counts
        return StatusCounts(received, lost, repeated, unread + self._unread, malformed, foreign, not_authentic)

    @property
    def robot_clock(self) -> RobotClock:
        """The last and the longest round-trip time."""
        last_ns, worst_ns = self._supervisor.round_trip_ns
        return RobotClock(None if last_ns is None else last_ns / 1e9, worst_ns / 1e9)

    def command(
        self, kind: RobotKind, within_s: float, target: float = 0.0, speed: float = 0.0, *, timely: bool = True
    ) -> tuple[Result | None, int]:
        """Send a command repeatedly until it is answered or `within_s` has passed; return its result and its number.

        The result is None without an answer. The robot refuses a `timely` command that arrives after `within_s`. Raises
        OtherVersion if the robot speaks neither this nor the oldest supported version of the protocol, MotionRefused
        if the supervisor has stopped the robot, and LinkClosed.
        """
        number = self._supervisor.next_number()
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
        deadline_ns = self._deadline_ns(within_s) if timely else 0
        deadline = Deadline(self._clock, within_s)
        while True:
            if not self.wire.send(kind, number, deadline_ns, target, speed):
                raise MotionRefused(f"robot: {kind.name.lower()}", ("stop_ordered",))
            patience = Deadline(self._clock, self._again_s)
            while True:
                self.pump(patience.left_s)
                result = self._answers[number]
                if result is not None:
                    return result
                if self._supervisor.accepted == number:
                    return Result.ACCEPTED
                if patience.passed:
                    break
            if deadline.passed:
                return None

    def send_stop(self) -> None:
        """Send one STOP with a number of its own, and do not wait for its answer. Raises LinkClosed."""
        self.wire.send(RobotKind.STOP, self._supervisor.next_number())

    def heartbeat(self, within_s: float) -> None:
        """Send a heartbeat, which the robot ignores if it arrives after `within_s`. Raises LinkClosed."""
        self.wire.send(RobotKind.ALIVE, 0, self._deadline_ns(within_s))

    def _deadline_ns(self, within_s: float) -> int:
        return self._supervisor.deadline_ns(round(within_s * 1e9), self._clock.now_ns())

    def pump(self, timeout_s: float) -> bool:
        """Wait for a datagram for `timeout_s`, at most `again_s`; dispatch it, and return whether one arrived."""
        with self._receiving:
            message = self.wire.receive(min(timeout_s, self._again_s))
            if message is not None:
                self._take(message)
        return message is not None

    def _catch_up(self) -> None:
        """Dispatch the received datagrams, for at most 20 ms."""
        end = Deadline(self._clock, _CATCH_UP_S)
        while self.pump(0) and not end.passed:
            pass

    def _take(self, message: RobotMessage) -> None:
        if message[0] == _STATUS:
            _, received_ns, lost, head, values = message
            self.statuses.append((_status(Head(*head), *values), lost, received_ns))
            if len(self.statuses) > _KEPT:
                _, lost, _ = self.statuses.popleft()
                oldest, before, received_ns = self.statuses[0]
                self.statuses[0] = (oldest, before + lost + 1, received_ns)
                self._unread += 1
        elif message[0] == _ANSWER:
            _, number, result = message
            if number in self._answers:
                self._answers[number] = Result(result)
        elif message[0] == _OTHER_VERSION:
            raise OtherVersion(*message[1:])


def _status(
    head: Head, depth_mm: float, velocity_mm_s: float, roll_rad: float, velocity_rad_s: float, faults: int, state: int,
    flags: int, overruns: int, missed: int,
) -> RobotStatus:  # fmt: skip
    is_old = head.version < VERSION
    homed, standing = (None, None) if is_old else (bool(flags & _HOMED), bool(flags & _STANDING))
    return RobotStatus(
        head, depth_mm, velocity_mm_s, roll_rad, velocity_rad_s, Fault(faults), RobotState(state),
        bool(flags & _MOVING), overruns, missed, homed, standing,
    )  # fmt: skip
