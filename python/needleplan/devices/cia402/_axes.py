"""Requests for the states of both axes by SYNC messages, and validation of the reported states."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from needleplan.artifacts import CallRepr
from needleplan.devices._base import StageSample, Stamp
from needleplan.devices.cia402._drive import CanBus
from needleplan.devices.cia402.objects import Bit, Cia402State, state_of
from needleplan.devices.cia402.setup import AxisSetup

__all__ = ["Cia402Axis", "DriveTiming", "Rounds"]


@dataclass(frozen=True)
class DriveTiming(CallRepr):
    """Times of the communication with the drives, in s.

    - `sync_s`: interval between two SYNC messages, which request the positions.
    - `heartbeat_s`: interval between heartbeats of the controller, and of each drive.
    - `watchdog_s`: a drive stops by itself after this time without a heartbeat of the controller.
    - `silence_s`: the stage raises DeviceFault after this time without positions from a drive.
    - `answer_s`: longest time for a drive to answer a request.
    - `change_s`: longest time for a drive to change its state or to accept a new target.
    - `slack_s`: longest delay of the start of a motion, and longest pause within a motion.
    """

    sync_s: float = 0.005
    heartbeat_s: float = 0.01
    watchdog_s: float = 0.04
    silence_s: float = 0.04
    answer_s: float = 0.3
    change_s: float = 0.5
    slack_s: float = 0.3


_STATUS = struct.Struct("<Hi")
_VELOCITY = struct.Struct("<i")
_LATENCY_S = 0.05  # time (s) for which an axis may continue at its old velocity after a new target is sent


@dataclass(frozen=True)
class _Motion:
    target: float
    velocity: float


class Cia402Axis:
    """State of one axis; validates each received frame of its drive.

    After `slack_s` (s) without approaching its target, an axis in motion counts as stuck.
    """

    def __init__(self, setup: AxisSetup, name: str, slack_s: float) -> None:
        self.setup = setup
        self.name = name
        self.slack_s = slack_s
        self.position = self.velocity = 0.0
        self.word = 0
        self.received_ns = 0
        self.stopped = False
        """Whether the drive was commanded to stop; the state QUICK STOP ACTIVE is then not a fault."""

        self._motion: _Motion | None = None
        self._nearest = self._leeway = 0.0
        self._moved_ns = 0
        self._known_ns: int | None = None
        self.has_status = self.has_velocity = False

    @property
    def complete(self) -> bool:
        """Whether status and velocity have arrived since the last SYNC."""
        return self.has_status and self.has_velocity

    def expect(self) -> None:
        """Mark status and velocity as missing, because a new SYNC requests them."""
        self.has_status = self.has_velocity = False

    def begin(self, target: float, velocity: float, position: float, now_ns: int) -> None:
        """Record that a motion has begun from `position` to `target` (mm or rad) at `velocity` (mm/s or rad/s)."""
        self._motion, self.stopped, self.position = _Motion(target, velocity), False, position
        # An axis that reverses continues in its old direction for a while.
        speed, limits = abs(self.velocity), self.setup.limits
        self._leeway = speed**2 / (2 * limits.acceleration) + speed * _LATENCY_S
        self._nearest = abs(target - position)
        self._moved_ns = now_ns

    def stop(self) -> None:
        """Record that the drive was commanded to stop."""
        self._motion, self.stopped = None, True

    def enabled(self, position: float) -> None:
        """Record that the drive was enabled at `position`."""
        self._motion, self.stopped, self._known_ns = None, False, None
        self.position = position

    @property
    def moving(self) -> bool:
        """Whether the axis has not reached its target, or has not come to rest after a stop."""
        reached = bool(self.word & Bit.TARGET_REACHED)
        if self._motion is None:
            return self.stopped and not reached
        return not reached or abs(self._motion.target - self.position) > self.setup.limits.margin

    def take_velocity(self, data: bytes) -> str:
        """Store a received velocity. Return a description of its problem, or "" if it is valid."""
        if len(data) != _VELOCITY.size:
            return f"sent a velocity of {len(data)} bytes instead of {_VELOCITY.size}"
        self.velocity, self.has_velocity = self.setup.velocity(_VELOCITY.unpack(data)[0]), True
        return ""

    def take_status(self, data: bytes, asked_ns: int, now_ns: int) -> str:
        """Store statusword and position, which the drive measured between the times `asked_ns` and `now_ns`.

        Return a description of the problem, or "" if state and position are plausible.
        """
        if len(data) != _STATUS.size:
            return f"sent a status of {len(data)} bytes instead of {_STATUS.size}"
        self.word, counts = _STATUS.unpack(data)
        before, self.position = self.position, self.setup.position(counts)
        since_ns, self._known_ns = self._known_ns, asked_ns
        self.has_status, self.received_ns = True, now_ns
        return self._wrong_state() or self._wrong_step(before, since_ns, now_ns) or self._wrong_motion(now_ns)

    def _wrong_state(self) -> str:
        state = state_of(self.word)
        if state in (Cia402State.FAULT, Cia402State.FAULT_REACTION):
            return "FAULT"
        if state is not Cia402State.ENABLED and not (self.stopped and state is Cia402State.QUICK_STOP):
            return f"left OPERATION ENABLED for {state}: emergency stop, STO, or its watchdog"
        if self.word & Bit.FOLLOWING_ERROR and not self.stopped:
            return "following error"
        if self.word & Bit.LIMIT:
            return "a limit is active: a limit switch, or a limit within the drive"
        return ""

    def _wrong_step(self, before: float, since_ns: int | None, now_ns: int) -> str:
        """Return a problem if the position has changed by more than the highest permitted speed allows, else ""."""
        limits = self.setup.limits
        step = abs(self.position - before)
        if since_ns is None or step <= limits.margin + limits.fastest * (now_ns - since_ns) / 1e9:
            return ""
        return f"its encoder jumped by {step:.3g}"

    def _wrong_motion(self, now_ns: int) -> str:
        motion, margin = self._motion, self.setup.limits.margin
        if motion is None:
            return ""
        left = abs(motion.target - self.position)
        if left > self._nearest + self._leeway + margin:
            return "moves away from its target: is its direction set right?"
        if left < self._nearest - margin / 2:
            self._nearest, self._leeway, self._moved_ns = left, 0.0, now_ns
        idle_s = (now_ns - self._moved_ns) / 1e9
        if self.moving and idle_s > self.slack_s + margin / motion.velocity:
            return f"does not move: {left:.3g} from its target for {idle_s:.2g} s"
        return ""


_NANO = 1_000_000_000
_PATIENCE = 4  # time to wait for the answers of a round, in SYNC intervals

_MOST_OPEN = 8  # largest number of rounds whose answers may still arrive


class Rounds:
    """Requests the positions of both `axes` in rounds: one SYNC message, then the answers of both drives.

    The next round begins only when the present one is complete, or is counted as lost because an answer is missing
    after four SYNC intervals.
    """

    def __init__(self, bus: CanBus, axes: Sequence[Cia402Axis], timing: DriveTiming) -> None:
        self._bus, self._axes, self._clock = bus, axes, bus.clock
        self._sync_ns, self._silence_s = round(timing.sync_s * _NANO), timing.silence_s
        self._number = self._lost = 0
        self.asked_ns: int | None = None
        """Time (ns) of the SYNC of the present round, or None if no round is in progress."""

        self._due_ns = self._answered_ns = 0
        self._open: deque[int] = deque(maxlen=_MOST_OPEN)

    @property
    def earliest_ns(self) -> int | None:
        """Time (ns) of the earliest SYNC to which an arriving answer may belong, or None; answers may be late."""
        return self._open[0] if self._open else None

    def begin_anew(self) -> None:
        """Discard the present round and the number of lost rounds."""
        self.asked_ns, self._due_ns, self._lost = None, 0, 0
        self._open.clear()
        self._answered_ns = self._clock.now_ns()

    def forget(self) -> None:
        """Abandon the present round, if any, and count it as lost; its answers are ignored."""
        self._lost += self.asked_ns is not None
        self.asked_ns, self._due_ns = None, 0
        self._open.clear()
        for axis in self._axes:
            axis.expect()

    def ask(self) -> None:
        """Send a SYNC if a new round is due; count an incomplete round as lost. Raises LinkClosed."""
        now_ns = self._clock.now_ns()
        if self.asked_ns is None:
            if now_ns < self._due_ns:
                return
            # The caller did not read, so no positions were requested: the drives were not silent.
            if now_ns > self._due_ns + self._sync_ns:
                self._answered_ns = now_ns
        elif now_ns < self.asked_ns + _PATIENCE * self._sync_ns:
            return
        else:
            self._lost += 1
        for axis in self._axes:
            axis.expect()
        self._number += 1
        self.asked_ns = now_ns
        self._open.append(now_ns)
        self._bus.sync()

    def sample(self) -> StageSample | None:
        """If both drives have answered, end the present round and return its sample; else return None."""
        if self.asked_ns is None or not all(axis.complete for axis in self._axes):
            return None
        self._answered_ns, self._due_ns, self.asked_ns = self._clock.now_ns(), self.asked_ns + self._sync_ns, None
        self._open.popleft()
        insertion, roll = self._axes
        stamp = Stamp(max(insertion.received_ns, roll.received_ns), self._number, self._lost)
        self._lost = 0
        moving = insertion.moving or roll.moving
        return StageSample(stamp, insertion.position, insertion.velocity, roll.position, moving)

    def silent(self) -> str:
        """Return a message that names the drives that have been silent for `silence_s`; "" if there are none."""
        now_ns = self._clock.now_ns()
        silent_s = (now_ns - self._answered_ns) / _NANO
        if silent_s <= self._silence_s or self.asked_ns is None or now_ns <= self.asked_ns + self._sync_ns:
            return ""
        names = ", ".join(axis.name for axis in self._axes if not axis.complete)
        return f"{names}: silent for {silent_s:.3g} s: check power, cable, and whether the bus is off"
