"""A robot that speaks the needleplan robot protocol, as a stage."""

from __future__ import annotations

import contextlib
import math
import secrets
from collections.abc import Callable
from dataclasses import dataclass

from needleplan.devices._base import Health, Stage, StageSample, Stamp
from needleplan.devices._clock import Clock, Deadline, SystemClock
from needleplan.devices._links import Link, UdpLink
from needleplan.devices._opening import Address, open_link, require_called_heartbeat
from needleplan.devices.robot.conversation import RobotClock, RobotConversation, StatusCounts
from needleplan.devices.robot.messages import (
    NAMES_OF_FAULTS,
    ROBOT_PORT,
    Result,
    RobotKind,
    RobotState,
    RobotStatus,
)
from needleplan.errors import AddressError, DeviceFault, LinkClosed, Mistake

__all__ = ["RobotStage", "RobotTiming"]

_WRAP = 1 << 32
_REASONS = {
    Result.BUSY: "it has another controller",
    Result.OLD_SESSION: "it does not know this session any more: it was restarted, or heard nothing for too long",
    Result.WRONG_VERSION: "it speaks another version of the protocol",
    Result.LATE: "the command came after its deadline",
    Result.SUPERSEDED: "a later command, as a stop, came before it",
    Result.NOT_ENABLED: "it is not enabled",
    Result.OUT_OF_RANGE: "the drive does not accept this target or speed",
    Result.IN_FAULT: "it is in a fault",
}


@dataclass(frozen=True)
class RobotTiming:
    """How long each side believes in the other."""

    silence_s: float = 0.03
    """The robot stops by itself where it hears nothing for so long while it moves."""

    valid_s: float = 0.03
    """A motion that comes to the robot later is not begun."""

    again_s: float = 0.005
    """A command is sent again after so long without an answer."""

    answer_s: float = 0.9
    """Hello, reset, enable and stop are sent again for so long."""

    lost_s: float = 0.1
    """The robot is given up where no status has come for so long."""


class RobotStage(Stage):
    """The robot over `link`.

    The watchdog of the robot is satisfied by commands and by `heartbeat`. Reading sends nothing: a thread that still
    reads must not hide that the loop has died.
    """

    def __init__(
        self,
        link: Link,
        *,
        timing: RobotTiming | None = None,
        clock: Clock | None = None,
        draw_session: Callable[[], int] = lambda: secrets.randbelow(_WRAP - 1) + 1,
    ) -> None:
        self._link, self._draw = link, draw_session
        self._clock: Clock = SystemClock() if clock is None else clock
        self.timing = RobotTiming() if timing is None else timing
        self._fault: DeviceFault | None = None
        self._closed = self._greeted = False
        self.last_status: RobotStatus | None = None
        """What the robot said last, also in a fault."""

        try:
            self.start()
        except BaseException:
            self.close()
            raise

    @classmethod
    def open(cls, address: str, *, timing: RobotTiming | None = None) -> RobotStage:
        """Open `udp://host[:5005][?watchdog_s=0.03&valid_s=0.03&local_port=n]` and take control.

        Raises AddressError if the address is wrong, DeviceFault if nobody answers or another controller has the robot.
        """
        parsed = Address.parse(address)
        if parsed.scheme != "udp":
            raise AddressError(Mistake("address", address, "a robot is reached by udp://host"))
        parsed.only(("watchdog_s", "valid_s", "alive", "local_port"))
        require_called_heartbeat(parsed)
        host, port = parsed.network(ROBOT_PORT)
        usual = RobotTiming() if timing is None else timing
        silence_s = parsed.option("watchdog_s", float, usual.silence_s)
        valid_s = parsed.option("valid_s", float, usual.valid_s)
        for name, value in (("watchdog_s", silence_s), ("valid_s", valid_s)):
            if not 0.001 <= value <= 60:
                raise AddressError(Mistake(name, f"{value:g}", "must be from 0.001 to 60 s"), address)
        local = {name: value for name, value in parsed.options.items() if name == "local_port"}
        asked = RobotTiming(silence_s, valid_s, usual.again_s, usual.answer_s, usual.lost_s)
        link = open_link(Address("udp", host, port, options=local))
        return cls(link, timing=asked)

    @property
    def counts(self) -> StatusCounts:
        """Statuses received, lost, repeated and unread, and datagrams that were none, since the start."""
        return self._talk.watch.counts

    @property
    def robot_clock(self) -> RobotClock:
        """The round trip, last and worst."""
        return self._talk.robot_clock

    @property
    def strangers(self) -> int:
        """Datagrams that somebody else sent to our port."""
        return self._link.strangers if isinstance(self._link, UdpLink) else 0

    def start(self) -> None:
        """Take control in a new session, reset a fault whose cause is gone, and enable; nothing moves.

        It is an act of a person: nothing here calls it after a fault. Raises DeviceFault.
        """
        timing = self.timing
        if self._greeted:
            self._leave()
        self._talk = RobotConversation(self._link, self._clock, self._draw(), timing.again_s, timing.silence_s)
        self._greeted = True
        self._fault = None
        for kind in (RobotKind.HELLO, RobotKind.RESET, RobotKind.ENABLE):
            result, _ = self._talk.command(kind, timing.answer_s, timely=kind is not RobotKind.HELLO)
            if result is not Result.ACCEPTED:
                raise self._give_up(f"{kind.name.lower()}: {self._why(result, timing.answer_s)}")
        # What was said before is said of the time before.
        self._talk.statuses.clear()
        self._since = self._begun = self._talk.last_number
        self._talk.heard_ns = self._clock.now_ns()

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin to move to a depth at a speed. Raises DeviceFault where the robot refuses or does not answer."""
        self._move(RobotKind.INSERT, depth_mm, velocity_mm_s)

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin to turn the base to a roll. Raises DeviceFault where the robot refuses or does not answer."""
        self._move(RobotKind.ROTATE, roll_rad, velocity_rad_s)

    def stop(self) -> None:
        """Stop both axes; sent again until the robot answers.

        Raises DeviceFault where it does not: it then stops by itself, because it hears nothing.
        """
        if self._closed:
            raise LinkClosed("the robot is closed")
        result, _ = self._talk.command(RobotKind.STOP, self.timing.answer_s, timely=False)
        if result not in (Result.ACCEPTED, Result.SUPERSEDED):
            raise self._give_up(f"stop: {self._why(result, self.timing.answer_s)}")

    def heartbeat(self) -> None:
        """Send a heartbeat, which is valid for `timing.silence_s`. Raises LinkClosed."""
        if self._closed:
            raise LinkClosed("the robot is closed")
        self._talk.heartbeat(self.timing.silence_s)

    def read(self, timeout_s: float) -> StageSample | None:
        """Return the next status, or None after `timeout_s`. Raises DeviceFault, again and again until `start`."""
        if self._closed:
            raise LinkClosed("the robot is closed")
        self._require_sound()
        deadline = Deadline(self._clock, timeout_s)
        while True:
            sample = self._next()
            if sample is not None:
                return sample
            if not self._talk.pump(deadline.left_s):
                self._require_heard()
                if deadline.passed:
                    return None

    def close(self) -> None:
        """Stop, give control up, and give the port back."""
        if not self._closed:
            self._closed = True
            self._leave()
            self._link.close()

    def _leave(self) -> None:
        with contextlib.suppress(DeviceFault):
            self._talk.command(RobotKind.GOODBYE, 10 * self.timing.again_s, timely=False)

    def _move(self, kind: RobotKind, target: float, speed: float) -> None:
        if self._closed:
            raise LinkClosed("the robot is closed")
        self._require_sound()
        if not (math.isfinite(target) and math.isfinite(speed) and speed > 0):
            raise DeviceFault(f"robot: {kind.name.lower()}: {target:g} at a speed of {speed:g} is not a motion")
        result, number = self._talk.command(kind, self.timing.valid_s, target, speed)
        if result is Result.ACCEPTED:
            self._begun = number
            return
        if result is None:
            # It may have come, and only its answer not: what is not known to move must not.
            self.stop()
        message = f"{kind.name.lower()}: {self._why(result, self.timing.valid_s)}"
        if result in (Result.LATE, Result.SUPERSEDED, Result.OUT_OF_RANGE, Result.NOT_ENABLED, None):
            raise DeviceFault(f"robot: {message}")
        raise self._give_up(message)

    def _next(self) -> StageSample | None:
        while self._talk.statuses:
            status, lost, now_ns = self._talk.statuses.popleft()
            if (status.head.number - self._since) % _WRAP >= _WRAP // 2:
                continue
            self.last_status = status
            if status.state is RobotState.FAULT:
                raise self._give_up(self._causes(status))
            stamp = Stamp(now_ns, status.head.sequence, lost, status.head.sent_ns / 1e9)
            sound = all(map(math.isfinite, (status.depth_mm, status.velocity_mm_s, status.roll_rad)))
            notes = () if sound else ("not finite",)
            # A status of before a motion was accepted does not know of it: who reads it next must not take it for done.
            moving = status.moving or (status.head.number - self._begun) % _WRAP >= _WRAP // 2
            return StageSample(
                stamp, status.depth_mm, status.velocity_mm_s, status.roll_rad, moving,
                Health.GOOD if sound else Health.SUSPECT, notes,
            )  # fmt: skip
        return None

    def _require_sound(self) -> None:
        if self._fault is not None:
            raise self._fault
        if self._talk.lost_control is not None:
            raise self._give_up(_REASONS[self._talk.lost_control])

    def _require_heard(self) -> None:
        if self._talk.lost_control is not None:
            raise self._give_up(_REASONS[self._talk.lost_control])
        silent_s = (self._clock.now_ns() - self._talk.heard_ns) / 1e9
        if silent_s >= self.timing.lost_s:
            raise self._give_up(f"silent for {silent_s:.3g} s; cable, power, or its process")

    def _why(self, result: Result | None, waited_s: float) -> str:
        if result is None:
            return f"no answer within {waited_s:g} s"
        patience = Deadline(self._clock, self.timing.lost_s)
        while result is Result.IN_FAULT and not self._talk.statuses and not patience.passed:
            self._talk.pump(patience.left_s)
        if result is Result.IN_FAULT and self._talk.statuses:
            return f"{_REASONS[result]}: {self._causes(self._talk.statuses[-1][0])}"
        return _REASONS[result]

    @staticmethod
    def _causes(status: RobotStatus) -> str:
        causes = [name for fault, name in NAMES_OF_FAULTS.items() if fault in status.faults]
        return ", ".join(causes) or f"fault {status.faults:#x}"

    def _give_up(self, why: str) -> DeviceFault:
        self._fault = DeviceFault(f"robot: {why}")
        return self._fault
