"""Rounds of questions: a SYNC goes out, and every drive says where it is."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from needleplan.devices.base import StageSample, Stamp
from needleplan.devices.cia402.axis import Axis
from needleplan.devices.cia402.bus import CanBus
from needleplan.devices.cia402.timing import DriveTiming

__all__ = ["Rounds"]

_NANO = 1_000_000_000
_PATIENCE = 4
"""So many times the time between two rounds a round waits for its answers."""

_MOST_OPEN = 8


class Rounds:
    """One round at a time, by `axes`: insertion and roll. A round that is not answered is lost, and counted."""

    def __init__(self, bus: CanBus, axes: Sequence[Axis], timing: DriveTiming) -> None:
        self._bus, self._axes, self._clock = bus, axes, bus.clock
        self._sync_ns, self._silence_s = round(timing.sync_s * _NANO), timing.silence_s
        self._number = self._lost = 0
        self.asked_ns: int | None = None
        """When the round under way began; None where there is none."""

        self._due_ns = self._heard_ns = 0
        self._open: deque[int] = deque(maxlen=_MOST_OPEN)

    @property
    def earliest_ns(self) -> int | None:
        """When what is answered now was asked at the earliest: a round that was given up may be answered late."""
        return self._open[0] if self._open else None

    def begin_anew(self) -> None:
        """Forget the round under way, and what was lost before."""
        self.asked_ns, self._due_ns, self._lost = None, 0, 0
        self._open.clear()
        self._heard_ns = self._clock.now_ns()

    def forget(self) -> None:
        """Give the round under way up: what it asked is not told any more."""
        self._lost += self.asked_ns is not None
        self.asked_ns, self._due_ns = None, 0
        self._open.clear()
        for axis in self._axes:
            axis.expect()

    def ask(self) -> None:
        """Begin a round where one is due. Raises LinkClosed."""
        now_ns = self._clock.now_ns()
        if self.asked_ns is None:
            if now_ns < self._due_ns:
                return
            # Who did not read for a while has not asked either: that is nobody's silence.
            if now_ns > self._due_ns + self._sync_ns:
                self._heard_ns = now_ns
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
        """Return the sample of the round under way, where all have answered, and end it."""
        if self.asked_ns is None or not all(axis.complete for axis in self._axes):
            return None
        self._heard_ns, self._due_ns, self.asked_ns = self._clock.now_ns(), self.asked_ns + self._sync_ns, None
        self._open.popleft()
        insertion, roll = self._axes
        stamp = Stamp(max(insertion.received_ns, roll.received_ns), self._number, self._lost)
        self._lost = 0
        moving = insertion.moving or roll.moving
        return StageSample(stamp, insertion.position, insertion.velocity, roll.position, moving)

    def silent(self) -> str:
        """Return who has been silent for too long, and for how long; nothing where nobody was."""
        now_ns = self._clock.now_ns()
        silent_s = (now_ns - self._heard_ns) / _NANO
        if silent_s <= self._silence_s or self.asked_ns is None or now_ns <= self.asked_ns + self._sync_ns:
            return ""
        names = ", ".join(axis.name for axis in self._axes if not axis.complete)
        return f"{names}: silent for {silent_s:.3g} s: power, cable, or bus-off"
