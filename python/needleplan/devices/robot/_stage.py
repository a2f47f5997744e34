"""Stage for a robot that speaks the needleplan robot protocol."""

from __future__ import annotations

import contextlib
import math
import secrets
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from needleplan.config import Number
from needleplan.devices._base import Health, Stage, StageSample, Stamp
from needleplan.devices._clock import Clock, Deadline, SystemClock
from needleplan.devices._links import Link
from needleplan.devices._opening import Address, open_link
from needleplan.devices.robot._codes import REASONS_OF_RESULTS
from needleplan.devices.robot._way import RobotWay, open_way, robot_address
from needleplan.devices.robot.conversation import RobotClock, RobotConversation, RobotWire, StatusCounts
from needleplan.devices.robot.messages import (
    NAMES_OF_FAULTS,
    VERSION,
    MotionLimits,
    Result,
    RobotKind,
    RobotState,
    RobotStatus,
)
from needleplan.devices.supervision import StageSupervisor
from needleplan.errors import AddressError, DeviceFault, Mistake

__all__ = ["RobotStage", "RobotTiming", "read_key"]

_WRAP = 1 << 32
# Distances (mm, rad) from the goal of a motion within which a robot at rest has arrived; farther away, it was stopped
_ARRIVED = {RobotKind.INSERT: 0.5, RobotKind.ROTATE: 0.1}
# Results that refuse one motion command; all others end the session
_REFUSED_MOTION = frozenset({
    Result.LATE, Result.SUPERSEDED, Result.OUT_OF_RANGE, Result.NOT_ENABLED, Result.DEPTH_BEYOND, Result.SPEED_BEYOND,
    Result.ROLL_BEYOND, Result.ROTATION_BEYOND, Result.DEADLINE_BEYOND, None,
})  # fmt: skip
# Results of a HELLO that asks for wider limits than those of the robot
_TOO_WIDE = (Result.DEPTH_BEYOND, Result.SPEED_BEYOND, Result.ROLL_BEYOND, Result.ROTATION_BEYOND)
# Rule for `silence_s` and `valid_s` in an address
_TIMES = Number("s", at_least=0.001, at_most=60)


@dataclass(frozen=True)
class RobotTiming:
    """Times of a session with the robot, in s.

    - `silence_s`: while the robot moves, it stops by itself after this time without a datagram from the controller.
    - `valid_s`: time after sending within which a motion command must arrive; the robot refuses a later command.
    - `again_s`: time without an answer after which a command is sent again.
    - `answer_s`: longest time for which HELLO, RESET, ENABLE and STOP are sent again.
    - `lost_s`: time without a status after which the stage raises DeviceFault.
    """

    silence_s: float = 0.03
    valid_s: float = 0.03
    again_s: float = 0.005
    answer_s: float = 0.9
    lost_s: float = 0.1


def read_key(path: str) -> bytes:
    """Return the shared key in a file of hexadecimal digits. Raises AddressError, which never shows the key."""
    try:
        key = bytes.fromhex(Path(path).read_text(encoding="ascii"))
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or "must contain hexadecimal digits only"
        raise AddressError(Mistake("key_file", path, why)) from None
    if len(key) < 16:
        raise AddressError(Mistake("key_file", path, f"must contain a key of at least 16 bytes, not {len(key)}"))
    return key


class RobotStage(Stage):
    """Stage that commands a robot over `link`.

    Only commands and `heartbeat` reset the watchdog of the robot. `read` sends nothing, so that the robot also stops if
    the control loop fails while another thread continues to read. `limits` are the limits of motion of the session, by
    default those of the robot. With a `key` of at least 16 bytes, all datagrams are authenticated. `close` also closes
    the `way` to the robot. The constructor takes control of the robot; raises DeviceFault if this fails, ProtocolError
    if the key is too short.
    """

    noun = "robot"

    def __init__(
        self,
        link: Link,
        *,
        timing: RobotTiming | None = None,
        limits: MotionLimits | None = None,
        key: bytes | None = None,
        clock: Clock | None = None,
        way: RobotWay | None = None,
        draw_session: Callable[[], int] = lambda: secrets.randbelow(_WRAP - 1) + 1,
    ) -> None:
        self._draw = draw_session
        self._clock: Clock = SystemClock() if clock is None else clock
        self._way = way
        self._wire = RobotWire(link, self._clock, way)
        self.timing: RobotTiming = RobotTiming() if timing is None else timing
        self.limits: MotionLimits = MotionLimits() if limits is None else limits
        self._key = key
        self._stops = 0
        self._goals: tuple[int, dict[RobotKind, float]] = (0, {})
        """Number of the last motion command, and the goal of each axis that has not been stopped since."""

        self._fault: DeviceFault | None = None
        self._closed = self._greeted = False
        self.last_status: RobotStatus | None = None
        """The status that was read last, or None; also updated by the status that reports a fault."""

        with self.closed_if_failing():
            self.start()

    @classmethod
    def open(cls, address: str, *, timing: RobotTiming | None = None, limits: MotionLimits | None = None) -> RobotStage:
        """Open `udp://host[:5005][?watchdog_s=0.03&valid_s=0.03&local_port=n&key_file=path]` and take control.

        Or open `serial:///dev/ttyUSB0[?baud=460800]`, with the same other options without `local_port`.
        `watchdog_s` is `silence_s` of RobotTiming, `valid_s` has the same name there. `local_port` is the receiving
        port of this machine, by default any free port. `key_file` is a file with the shared key in hexadecimal digits.
        Raises AddressError if the address or the key is wrong, DeviceFault if the robot does not answer, has another
        controller, does not accept the limits, or is in a fault that stays.
        """
        options = ("watchdog_s", "valid_s", "key_file")
        is_line = Address.parse(address).scheme == "serial"
        parsed = robot_address(address, options if is_line else (*options, "local_port"))
        usual = RobotTiming() if timing is None else timing
        silence_s = parsed.option("watchdog_s", _TIMES, usual.silence_s)
        valid_s = parsed.option("valid_s", _TIMES, usual.valid_s)
        key = read_key(parsed.options["key_file"]) if "key_file" in parsed.options else None
        local = {name: value for name, value in parsed.options.items() if name == "local_port"}
        asked = replace(usual, silence_s=silence_s, valid_s=valid_s)
        way = open_way(address)
        with way.closed_if_failing():
            link = open_link(Address("udp", way.host, way.port, options=local))
        return cls(link, timing=asked, limits=limits, key=key, way=way)

    @property
    def counts(self) -> StatusCounts:
        """Numbers of received, lost, repeated and discarded statuses and of other datagrams since `start`."""
        return self._conversation.counts

    @property
    def robot_clock(self) -> RobotClock:
        """The last and the longest round-trip time."""
        return self._conversation.robot_clock

    @property
    def unknown_senders(self) -> int:
        """Number of datagrams that were dropped because another sender sent them; 0 if the link is not UDP."""
        return self._wire.supervisor.unknown_senders

    @property
    def supervisor(self) -> StageSupervisor:
        """The supervisor, through which all datagrams of this stage pass."""
        return self._wire

    def start(self) -> None:
        """Take control in a new session, reset a fault if its cause is gone, and enable the robot; nothing moves.

        The constructor calls `start`. After a fault, only a person may decide to call it again. Raises DeviceFault if
        the robot refuses a step or does not answer within `timing.answer_s`.
        """
        timing = self.timing
        if self._greeted:
            self._leave()
        self._conversation = RobotConversation(
            self._wire, self._clock, self._draw(), timing.again_s, timing.silence_s, self.limits, self._key
        )
        self._greeted = True
        self._fault = None
        self._goals = (0, {})
        for kind in (RobotKind.HELLO, RobotKind.RESET, RobotKind.ENABLE):
            result, _ = self._conversation.command(kind, timing.answer_s, timely=kind is not RobotKind.HELLO)
            if result is not Result.ACCEPTED:
                hint = f"; narrow the limits of the run to those of the robot: {self.limits}" * (result in _TOO_WIDE)
                raise self._give_up(f"{kind.name.lower()}: {self._why(result, timing.answer_s)}{hint}")
        # Statuses received so far describe the robot before it was enabled.
        self._conversation.statuses.clear()
        self._since = self._begun = self._conversation.last_number
        self._conversation.begun_ns = self._clock.now_ns()

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin a motion to a depth. Raises DeviceFault if a value is invalid, or the robot refuses or is silent.

        If the robot is silent, the axes are stopped, because the command may have arrived.
        """
        self._move(RobotKind.INSERT, depth_mm, velocity_mm_s)

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin a rotation of the needle base to a roll angle. Raises DeviceFault in the same cases as `insert`."""
        self._move(RobotKind.ROTATE, roll_rad, velocity_rad_s)

    def stop(self) -> None:
        """Stop both axes; the command is sent again until the robot answers or `timing.answer_s` has passed.

        Raises DeviceFault if the robot refuses or does not answer, LinkClosed after `close`. A robot that receives
        nothing stops by its watchdog.
        """
        self._require_open()
        self._stops += 1
        self._goals = (0, {})
        result, _ = self._conversation.command(RobotKind.STOP, self.timing.answer_s, timely=False)
        if result not in (Result.ACCEPTED, Result.SUPERSEDED):
            raise self._give_up(f"stop: {self._why(result, self.timing.answer_s)}")

    def send_stop(self) -> None:
        """Send one STOP without waiting for its answer; no lock is taken. Raises LinkClosed after `close`."""
        self._require_open()
        self._stops += 1
        self._goals = (0, {})
        self._conversation.send_stop()

    @property
    def homed(self) -> bool | None:
        """Whether the robot knows its zero, by the last status that was read; None before one, or in version 2."""
        return None if self.last_status is None else self.last_status.homed

    def home(self) -> None:
        """Tell the robot that a person has found its zero. Raises DeviceFault if the robot refuses or is silent."""
        self._declare(RobotKind.HOME, self.timing.answer_s, homed=True)

    def unhome(self) -> None:
        """Tell the robot that its zero is lost, which it remembers for later sessions. Raises DeviceFault as `home`."""
        self._declare(RobotKind.UNHOME, 10 * self.timing.again_s, homed=False)

    def _declare(self, kind: RobotKind, within_s: float, *, homed: bool) -> None:
        self._require_open()
        if self._conversation.version < VERSION:
            return  # the robot has no place for it
        end = Deadline(self._clock, within_s)
        while True:
            result, number = self._conversation.command(kind, within_s, timely=kind is RobotKind.HOME)
            if result is not Result.SUPERSEDED or end.passed:  # a STOP that the supervisor repeats may overtake it
                break
        if result is not Result.ACCEPTED:
            raise DeviceFault(f"robot: {kind.name.lower()}: {self._why(result, within_s)}")
        self._since = number  # earlier statuses tell what was before
        if self.last_status is not None:
            self.last_status = replace(self.last_status, homed=homed)

    def measure(self, timeout_s: float) -> StageSample | None:
        """Return the next sample, also while the robot is in FAULT, or None after `timeout_s`. Raises LinkClosed."""
        self._require_open()
        deadline = Deadline(self._clock, timeout_s)
        while (sample := self._next(raises=False)) is None:
            if not self._conversation.pump(deadline.left_s) and deadline.passed:
                return None
        return sample

    def heartbeat(self) -> None:
        """Send a heartbeat that is valid for `timing.silence_s`. Raises LinkClosed."""
        self._require_open()
        self._conversation.heartbeat(self.timing.silence_s)

    def read(self, timeout_s: float) -> StageSample | None:
        """Return the next sample, or None after `timeout_s`.

        Raises DeviceFault if the robot reports a fault or is silent, and then at every call until `start`. Raises
        LinkClosed after `close`.
        """
        self._require_open()
        self._require_no_fault()
        deadline = Deadline(self._clock, timeout_s)
        while True:
            sample = self._next()
            if sample is not None:
                return sample
            if not self._conversation.pump(deadline.left_s):
                self._require_status()
                if deadline.passed:
                    return None

    def close(self) -> None:
        """Stop, release control, and close the link. Closing again does nothing."""
        if not self._closed:
            self._closed = True
            self._leave()
            self._wire.close()

    def _leave(self) -> None:
        with contextlib.suppress(DeviceFault):
            self._conversation.command(RobotKind.GOODBYE, 10 * self.timing.again_s, timely=False)

    def _move(self, kind: RobotKind, target: float, speed: float) -> None:
        self._require_open()
        self._require_no_fault()
        if not (math.isfinite(target) and math.isfinite(speed) and speed > 0):
            raise DeviceFault(
                f"robot: {kind.name.lower()}: target {target:g} and speed {speed:g} must be finite, the speed positive"
            )
        stops = self._stops
        result, number = self._conversation.command(kind, self.timing.valid_s, target, speed)
        if result is Result.ACCEPTED:
            self._begun = number
            if stops == self._stops:  # otherwise another thread has ordered a stop meanwhile
                self._goals = (number, self._goals[1] | {kind: target})
            return
        if result is None:
            # The command may have arrived although no answer came back, so the axis may move: stop it.
            self.stop()
        message = f"{kind.name.lower()}: {self._why(result, self.timing.valid_s)}"
        if result in _REFUSED_MOTION:
            raise DeviceFault(f"robot: {message}")
        raise self._give_up(message)

    def _next(self, *, raises: bool = True) -> StageSample | None:
        """Return the next sample that waits; `raises` tells whether a fault of the robot raises DeviceFault."""
        while self._conversation.statuses:
            status, lost, now_ns = self._conversation.statuses.popleft()
            if (status.head.number - self._since) % _WRAP >= _WRAP // 2:
                continue
            self.last_status = status
            if raises and status.state is RobotState.FAULT:
                raise self._give_up(self._causes(status))
            stamp = Stamp(now_ns, status.head.sequence, lost, status.head.sent_ns / 1e9)
            sound = all(map(math.isfinite, (status.depth_mm, status.velocity_mm_s, status.roll_rad)))
            notes = () if sound else ("not finite",)
            # A status sent before the robot accepted the motion must not report the motion as complete.
            moving = status.moving or (status.head.number - self._begun) % _WRAP >= _WRAP // 2
            if raises and sound and not moving:
                self._require_arrived(status)
            return StageSample(
                stamp, status.depth_mm, status.velocity_mm_s, status.roll_rad, moving,
                Health.GOOD if sound else Health.SUSPECT, notes,
            )  # fmt: skip
        return None

    def _require_arrived(self, status: RobotStatus) -> None:
        """Raise DeviceFault if the robot ends a motion before its goal, and this program has not stopped it."""
        number, goals = self._goals
        if not goals or (status.head.number - number) % _WRAP >= _WRAP // 2:
            return
        for kind, position in ((RobotKind.INSERT, status.depth_mm), (RobotKind.ROTATE, status.roll_rad)):
            if abs(goals.get(kind, position) - position) > _ARRIVED[kind]:
                where = f"{position:.4g} instead of {goals[kind]:.4g} {'mm' if kind is RobotKind.INSERT else 'rad'}"
                raise self._give_up(f"it has ended its motion at {where}, although this program has ordered no stop")

    def _require_no_fault(self) -> None:
        if self._fault is not None:
            raise self._fault
        if self._conversation.lost_control is not None:
            raise self._give_up(REASONS_OF_RESULTS[self._conversation.lost_control])

    def _require_status(self) -> None:
        if self._conversation.lost_control is not None:
            raise self._give_up(REASONS_OF_RESULTS[self._conversation.lost_control])
        silent_s = (self._clock.now_ns() - self._conversation.received_ns) / 1e9
        if silent_s >= self.timing.lost_s:
            raise self._give_up(f"silent for {silent_s:.3g} s; check its cable, power and control program")

    def _why(self, result: Result | None, waited_s: float) -> str:
        if result is None:
            if self._conversation.counts.not_authentic:
                return f"no answer within {waited_s:g} s that is authenticated with the key"
            hint = "" if self._way is None else self._way.hint
            return f"no answer within {waited_s:g} s" + f"; {hint}" * bool(hint)
        patience = Deadline(self._clock, self.timing.lost_s)
        while result is Result.IN_FAULT and not self._conversation.statuses and not patience.passed:
            self._conversation.pump(patience.left_s)
        if result is Result.IN_FAULT and self._conversation.statuses:
            return f"{REASONS_OF_RESULTS[result]}: {self._causes(self._conversation.statuses[-1][0])}"
        return REASONS_OF_RESULTS[result]

    @staticmethod
    def _causes(status: RobotStatus) -> str:
        causes = [name for fault, name in NAMES_OF_FAULTS.items() if fault in status.faults]
        return ", ".join(causes) or f"fault {status.faults:#x}"

    def _give_up(self, why: str) -> DeviceFault:
        self._fault = DeviceFault(f"robot: {why}")
        return self._fault
