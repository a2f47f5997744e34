"""A link to a box in this process, on a clock that moves only when somebody waits."""

from __future__ import annotations

from collections import deque

from needleplan.devices.ati.simulator import NetFtBox
from needleplan.devices.clock import VirtualClock
from needleplan.devices.link import Link
from needleplan.errors import LinkClosed

__all__ = ["BoxLink"]

_HERE = ("in this process", 0)
_NANO = 1_000_000_000
_MEASUREMENTS_PER_S = 7000


class BoxLink(Link):
    """Carries datagrams to and from `box`; waiting on it moves `clock`, and the box measures as time passes."""

    def __init__(self, box: NetFtBox, clock: VirtualClock) -> None:
        self.box, self._clock = box, clock
        self._due_ns = clock.now_ns()
        self._waiting: deque[bytes] = deque()
        self._closed = False

    def send(self, data: bytes) -> None:
        """Give a request to the box."""
        if self._closed:
            raise LinkClosed("the link to the box is closed")
        self.box.request(data, _HERE)

    def receive(self, timeout_s: float) -> bytes:
        """Return the next datagram, or let `timeout_s` pass."""
        if self._closed:
            raise LinkClosed("the link to the box is closed")
        end_ns = self._clock.now_ns() + round(timeout_s * _NANO)
        while not self._waiting and self._due_ns <= end_ns:
            self._clock.advance((self._due_ns - self._clock.now_ns()) / _NANO)
            datagrams = self.box.step(self._due_ns / _NANO)
            # What goes to another client does not come here.
            self._waiting.extend(datagrams if self.box.client == _HERE else ())
            self._due_ns += round(self.box.settings.divisor / _MEASUREMENTS_PER_S * _NANO)
        if self._waiting:
            return self._waiting.popleft()
        self._clock.advance((end_ns - self._clock.now_ns()) / _NANO)
        return b""

    def close(self) -> None:
        """Give the link up."""
        self._closed = True
