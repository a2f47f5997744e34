"""A controller that sends single datagrams, right and wrong ones, and looks at what a robot makes of them."""

from __future__ import annotations

import math
import secrets
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace

from needleplan.devices._clock import Clock, Deadline
from needleplan.devices._links import Link
from needleplan.devices.robot._codes import Result, RobotKind, RobotState
from needleplan.devices.robot.messages import (
    VERSION,
    Answer,
    Head,
    Hello,
    MotionLimits,
    OtherVersion,
    RobotCommand,
    RobotStatus,
    Seal,
    decode,
    encode,
)
from needleplan.errors import DeviceFault, ProtocolError
from needleplan.stopping import Rest, StopLimits, StopProcedure

__all__ = ["ProbedMotion", "RobotAstray", "RobotProbe", "RuleBroken", "require", "sealed"]

_WRAP = 1 << 32
_ALIVE_S = 0.005  # time between two heartbeats (s)
_ANSWER_S, _ATTEMPTS = (
    0.1,
    5,
)  # time (s) without an answer after which a datagram is sent again, and how often it is sent
_VALID_S = 0.1  # time (s) from sending a command to its deadline
_SILENCE_S = 0.2  # watchdog time (s) of motions that are not to end by silence; a robot may permit at most 0.34 s
_RELEASE_S = 5.0  # silence (s) at rest after which a session ends
_SETTLE_S = 0.05  # duration (s) of a look at the measured positions
ASTRAY_MM = 1.5  # distance beyond the stated range (mm) at which the test is given up: braking and following error


class RuleBroken(DeviceFault):
    """A robot does not keep a rule of the protocol; the message says what the robot did instead."""


class RobotAstray(DeviceFault):
    """A robot has left the range within which a test may move it."""


def require(holds: bool, found: str) -> None:
    """Raise RuleBroken, with what was found, unless the rule holds."""
    if not holds:
        raise RuleBroken(found)


def sealed(begin: bytes) -> bytes:
    """Return the bytes `begin` with their checksum appended, also for a meaningless datagram."""
    return begin + struct.pack("<I", zlib.crc32(begin))


@dataclass(frozen=True)
class ProbedMotion:
    """The motion that a test may make: from `start_mm` to `far_mm`, and within `_ROLL_RAD` of `roll_rad`."""

    start_mm: float
    far_mm: float
    roll_rad: float
    speed_mm_s: float
    seconds: float
    roll_range_rad: float = 0.2
    speed_rad_s: float = 1.0

    @property
    def limits(self) -> MotionLimits:
        """The limits of a session: this motion, and no other."""
        least_mm, most_mm = sorted((self.start_mm, self.far_mm))
        roll_rad = abs(self.roll_rad) + self.roll_range_rad
        return MotionLimits(
            least_mm, most_mm, self.speed_mm_s, roll_rad, self.speed_rad_s, round(1e6 * _SILENCE_S)
        )  # fmt: skip


class RobotProbe:
    """One controller of a robot over a link of its own; `motion` is None before the place of the robot is known."""

    def __init__(
        self, connect: Callable[[], Link], clock: Clock, key: bytes | None, motion: ProbedMotion | None = None
    ) -> None:
        self.link: Link = connect()
        self.clock: Clock = clock
        self._motion = motion
        self.key: bytes | None = key
        self.seal: Seal | None = None if key is None else Seal(key)
        """Seal of the datagrams that are sent; a test may change it."""

        self.answered: Seal | None = self.seal
        """Seal of the datagrams that are received in a session."""

        self._unnumbered = self.seal
        self.session: int = secrets.randbelow(_WRAP - 1) + 1
        self.sequence: int = 0
        self.number: int = 0
        self.silence_s: float = _SILENCE_S
        self.answers: list[Answer] = []
        self.statuses: list[tuple[int, RobotStatus]] = []
        """Times of arrival (ns) and statuses."""

        self.other_versions: int = 0
        self.malformed: int = 0
        self._alive_ns = 0

    @property
    def last(self) -> RobotStatus:
        """The newest status. Raises RuleBroken if the robot sends none."""
        if not self.statuses:
            self.listen(_SETTLE_S, alive=False)
        require(bool(self.statuses), "the robot sends no status")
        return self.statuses[-1][1]

    def robot_ns(self) -> int:
        """Return the time on the clock of the robot, early by the transmission time of a status; 0 if unknown."""
        if not self.statuses:
            return 0
        arrived_ns, status = self.statuses[-1]
        return status.head.sent_ns + self.clock.now_ns() - arrived_ns

    def head(self, number: int | None = None) -> Head:
        """Return the head of the next datagram, by default with the next number."""
        self.sequence = (self.sequence + 1) % _WRAP
        if number is None:
            number = self.number = (self.number + 1) % _WRAP
        return Head(self.session, self.sequence, self.clock.now_ns(), number=number)

    def command(
        self, kind: RobotKind, target: float = 0.0, speed: float = 0.0, *, valid_s: float = _VALID_S,
        number: int | None = None,
    ) -> RobotCommand:  # fmt: skip
        """Return the next command, which is valid for `valid_s` from now."""
        patience = Deadline(self.clock, _SETTLE_S)
        while not self.statuses and not patience.passed:  # the first status tells the time of the robot
            self.pump(patience.left_s)
        deadline_ns = max(self.robot_ns() + round(1e9 * valid_s), 0)
        return RobotCommand(self.head(number), kind, deadline_ns, target, speed, round(1e6 * self.silence_s))

    def timeless(self, kind: RobotKind) -> RobotCommand:
        """Return the next command, of a kind that needs no deadline."""
        return RobotCommand(self.head(), kind, silence_us=round(1e6 * self.silence_s))

    def hello(self, limits: MotionLimits | None = None, **head: int) -> Hello:
        """Return a HELLO of the session, with the limits of the motion."""
        usual = MotionLimits() if self._motion is None else self._motion.limits
        return Hello(replace(self.head(), **head), usual if limits is None else limits, round(1e6 * self.silence_s))

    def post(self, message: Hello | RobotCommand | bytes) -> None:
        """Send a datagram, and wait for nothing. HELLO is authenticated with the nonce 0."""
        if not isinstance(message, bytes):
            seal = Seal(self.key) if self.key is not None and isinstance(message, Hello) else self.seal
            message = encode(message, seal)
        self.link.send(message)

    def ask(self, message: Hello | RobotCommand, *, attempts: int = _ATTEMPTS) -> Result | None:
        """Send a command until it is answered; return the result, None without an answer."""
        kind, number = message.kind, message.head.number
        for _ in range(attempts):
            self.post(message)
            begin, patience = len(self.answers), Deadline(self.clock, _ANSWER_S)
            while not patience.passed:
                self.pump(patience.left_s)
                for answer in self.answers[begin:]:
                    if (answer.asked, answer.head.number) == (kind, number):
                        if isinstance(message, Hello) and self.key is not None and answer.nonce:
                            self.seal = self.answered = Seal(self.key, answer.nonce)
                        return answer.result
            again = self.head(number)
            message = replace(message, head=replace(again, session=message.head.session, version=message.head.version))
        return None

    def expect(self, message: Hello | RobotCommand, *results: Result) -> None:
        """Send a command. Raises RuleBroken if its result is not one of `results`, by default ACCEPTED."""
        results = results or (Result.ACCEPTED,)
        result = self.ask(message)
        outcome = "gets no answer" if result is None else f"is answered with {result.name}"
        require(
            result in results,
            f"{message.kind.name} {outcome} instead of {' or '.join(expected.name for expected in results)}",
        )

    def enable(self) -> RobotProbe:
        """Take control, reset a fault, and enable the robot; return this probe."""
        for message in (self.hello, lambda: self.command(RobotKind.RESET), lambda: self.command(RobotKind.ENABLE)):
            self.expect(message())
        return self

    def pump(self, timeout_s: float) -> None:
        """Wait for a datagram for `timeout_s`, and keep it."""
        data = self.link.receive(timeout_s)
        if not data:
            return
        try:
            message = decode(data, self.answered)
        except OtherVersion as other:
            self.other_versions += other.version > VERSION
            return
        except ProtocolError:
            try:
                message = decode(data, self._unnumbered)
            except ProtocolError:
                self.malformed += 1
                return
        if isinstance(message, Answer):
            self.answers.append(message)
        elif isinstance(message, RobotStatus):
            self.statuses.append((self.clock.now_ns(), message))
            self._watch(message.depth_mm)

    def _watch(self, depth_mm: float) -> None:
        if self._motion is None:
            return
        limits = self._motion.limits
        if not limits.least_mm - ASTRAY_MM <= depth_mm <= limits.most_mm + ASTRAY_MM:
            self.post(self.timeless(RobotKind.STOP))
            raise RobotAstray(f"the robot is at {depth_mm:.2f} mm, outside the stated range: the test was given up")

    def listen(self, seconds: float, *, alive: bool = True) -> list[RobotStatus]:
        """Return the statuses of the next `seconds`; with heartbeats if `alive`."""
        begin, end = len(self.statuses), Deadline(self.clock, seconds)
        while not end.passed:
            if alive and self.clock.now_ns() - self._alive_ns >= 1e9 * _ALIVE_S:
                self._alive_ns = self.clock.now_ns()
                self.post(self.command(RobotKind.ALIVE, number=0))
            self.pump(min(end.left_s, _ALIVE_S))
        return [status for _, status in self.statuses[begin:]]

    def is_released(self) -> bool:
        """Ask for control until the robot gives it, for 6 s; return whether it does."""
        for _ in range(round(_RELEASE_S / 0.5) + 2):
            if self.ask(self.hello(), attempts=1) is Result.ACCEPTED:
                return True
            self.listen(0.5, alive=False)
        return False

    def stays(self, after: str) -> None:
        """Raise RuleBroken if the needle moves."""
        begin_mm = self.last.depth_mm
        moved_mm = max((abs(status.depth_mm - begin_mm) for status in self.listen(0.15)), default=math.inf)
        require(moved_mm <= 0.05, f"moves by {moved_mm:.2f} mm after {after}")

    def depart(self, seconds: float = 0.1) -> RobotProbe:
        """Begin a motion to an end of the range, and see that the needle moves; return this probe."""
        motion, depth_mm = self.motion, self.last.depth_mm
        span_mm = motion.far_mm - motion.start_mm
        share = (depth_mm - motion.start_mm) / span_mm
        if 0.1 < share < 0.9:
            self.go(motion.start_mm)
            share, depth_mm = 0.0, self.last.depth_mm
        target = motion.far_mm if share < 0.5 else motion.start_mm
        self.expect(self.command(RobotKind.INSERT, target, motion.speed_mm_s))
        self.listen(seconds)
        moved_mm = abs(self.last.depth_mm - depth_mm)
        require(moved_mm > 0.2 * motion.speed_mm_s * seconds, f"INSERT has moved the needle by {moved_mm:.2f} mm only")
        return self

    def go(self, depth_mm: float) -> None:
        """Move to a depth within the range, and see that the needle arrives and rests."""
        motion = self.motion
        self.expect(self.command(RobotKind.INSERT, depth_mm, motion.speed_mm_s))
        longest = Deadline(self.clock, 1.0 + 2 * abs(self.last.depth_mm - depth_mm) / motion.speed_mm_s)
        while self.listen(_SETTLE_S)[-1:] == [] or self.last.moving or abs(self.last.depth_mm - depth_mm) > 0.5:
            require(not longest.passed, f"INSERT to {depth_mm:.2f} mm ends at {self.last.depth_mm:.2f} mm")
        self.rests("a completed INSERT")

    def stop(self) -> None:
        """Order a STOP, and see that the needle rests."""
        self.expect(self.timeless(RobotKind.STOP))
        self.rests("STOP", self.motion.speed_mm_s)

    def rests(self, after: str, speed_mm_s: float = 0.0, *, alive: bool = True, within_s: float = 0.6) -> None:
        """Raise RuleBroken unless the measured positions show that the needle comes to rest within its braking."""
        begun_s, end = self.clock.now_ns() / 1e9, Deadline(self.clock, within_s)
        begin = len(self.statuses)
        while True:
            self.listen(_SETTLE_S, alive=alive)
            stop = StopProcedure(StopLimits(), begun_s, self.statuses[max(begin - 1, 0)][1].depth_mm, speed_mm_s)
            stop.arrived(begun_s)
            for arrived_ns, status in self.statuses[begin:]:
                sent_s = status.head.sent_ns / 1e9
                stop.see(arrived_ns / 1e9, status.depth_mm, status.velocity_mm_s, status.roll_rad, sent_s)
            rest = stop.rest(self.clock.now_ns() / 1e9)
            require(
                stop.moved_mm <= stop.limits.braking_mm(speed_mm_s), f"moves on by {stop.moved_mm:.2f} mm after {after}"
            )
            if rest is Rest.RESTS:
                return
            require(not end.passed, f"is not measured at rest {within_s:g} s after {after}")

    def ends_in_fault(self, fault: int, after: str, within_s: float) -> None:
        """Raise RuleBroken unless the robot has changed to FAULT with this cause, and the needle rests."""
        longest = Deadline(self.clock, within_s)
        while self.last.state is not RobotState.FAULT and not longest.passed:
            self.listen(_ALIVE_S, alive=False)
        require(self.last.state is RobotState.FAULT, f"is {self.last.state.name} instead of FAULT after {after}")
        require(
            bool(self.last.faults & fault), f"names the faults {self.last.faults:#x} without {fault:#x} after {after}"
        )
        self.rests(after, self.motion.speed_mm_s, alive=False)

    @property
    def motion(self) -> ProbedMotion:
        """The motion that the test may make."""
        assert self._motion is not None
        return self._motion

    def close(self) -> None:
        """Stop, release control, and close the link."""
        try:
            for kind in (RobotKind.STOP, RobotKind.GOODBYE) if self.session else ():
                self.ask(self.timeless(kind), attempts=2)
        finally:
            self.link.close()
