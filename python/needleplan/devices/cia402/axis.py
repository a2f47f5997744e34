"""What is known of one axis from the frames of its drive, and what is wrong with it."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from needleplan.devices.cia402.objects import Bit, DriveState, state_of
from needleplan.devices.cia402.setup import AxisSetup

__all__ = ["Axis"]

_STATUS = struct.Struct("<Hi")
_VELOCITY = struct.Struct("<i")
_LATENCY_S = 0.05


@dataclass(frozen=True)
class _Motion:
    target: float
    velocity: float


class Axis:
    """Follows one drive. `slack_s` is how late it may begin to move, or arrive."""

    def __init__(self, setup: AxisSetup, name: str, slack_s: float) -> None:
        self.setup, self.name, self.slack_s = setup, name, slack_s
        self.position = self.velocity = 0.0
        self.word = 0
        self.received_ns = 0
        self.stopped = False
        """Whether the drive was told to stop: then it may be in QUICK STOP ACTIVE."""

        self._motion: _Motion | None = None
        self._nearest = self._leeway = 0.0
        self._moved_ns = 0
        self._known_ns: int | None = None
        self.has_status = self.has_velocity = False

    @property
    def complete(self) -> bool:
        """Whether the drive has answered the last SYNC."""
        return self.has_status and self.has_velocity

    def expect(self) -> None:
        """Forget what was answered: a SYNC goes out."""
        self.has_status = self.has_velocity = False

    def begin(self, target: float, velocity: float, position: float, now_ns: int) -> None:
        """Know of a motion that begins, from `position`."""
        self._motion, self.stopped, self.position = _Motion(target, velocity), False, position
        # An axis that is sent back goes on for a while.
        speed, limits = abs(self.velocity), self.setup.limits
        self._leeway = speed**2 / (2 * limits.acceleration) + speed * _LATENCY_S
        self._nearest = abs(target - position)
        self._moved_ns = now_ns

    def stop(self) -> None:
        """Know of a stop."""
        self._motion, self.stopped = None, True

    def enabled(self, position: float) -> None:
        """Know that the drive was enabled, at a place."""
        self._motion, self.stopped, self._known_ns = None, False, None
        self.position = position

    @property
    def moving(self) -> bool:
        """Whether the axis is on its way, or not yet at rest after a stop."""
        reached = bool(self.word & Bit.TARGET_REACHED)
        if self._motion is None:
            return self.stopped and not reached
        return not reached or abs(self._motion.target - self.position) > self.setup.limits.margin

    def take_velocity(self, data: bytes) -> str:
        """Take the velocity; return what is wrong."""
        if len(data) != _VELOCITY.size:
            return f"a velocity of {len(data)} bytes"
        self.velocity, self.has_velocity = self.setup.velocity(_VELOCITY.unpack(data)[0]), True
        return ""

    def take_status(self, data: bytes, asked_ns: int, now_ns: int) -> str:
        """Take statusword and position, as they were between `asked_ns` and `now_ns`; return what is wrong."""
        if len(data) != _STATUS.size:
            return f"a status of {len(data)} bytes"
        self.word, counts = _STATUS.unpack(data)
        before, self.position = self.position, self.setup.position(counts)
        since_ns, self._known_ns = self._known_ns, asked_ns
        self.has_status, self.received_ns = True, now_ns
        return self._wrong_state() or self._wrong_step(before, since_ns, now_ns) or self._wrong_motion(now_ns)

    def _wrong_state(self) -> str:
        state = state_of(self.word)
        if state in (DriveState.FAULT, DriveState.FAULT_REACTION):
            return "FAULT"
        if state is not DriveState.ENABLED and not (self.stopped and state is DriveState.QUICK_STOP):
            return f"left OPERATION ENABLED for {state}: emergency stop, STO, or it did not hear us"
        if self.word & Bit.FOLLOWING_ERROR and not self.stopped:
            return "following error"
        if self.word & Bit.LIMIT:
            return "a limit is active: limit switch or an internal one"
        return ""

    def _wrong_step(self, before: float, since_ns: int | None, now_ns: int) -> str:
        """A step is too far where no speed that is allowed, in the longest time that it can have taken, explains it."""
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
            return "it moves away from its target: is its direction set right?"
        if left < self._nearest - margin / 2:
            self._nearest, self._leeway, self._moved_ns = left, 0.0, now_ns
        idle_s = (now_ns - self._moved_ns) / 1e9
        if self.moving and idle_s > self.slack_s + margin / motion.velocity:
            return f"it does not move: {left:.3g} from its target for {idle_s:.2g} s"
        return ""
