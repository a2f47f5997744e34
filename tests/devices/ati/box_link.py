"""A link to a simulated force sensor within one process, on a virtual clock."""

from __future__ import annotations

from collections import deque

from needleplan.devices import Link, VirtualClock
from needleplan.devices.ati import NetFtBox
from needleplan.errors import LinkClosed

_NANO = 1_000_000_000
_MEASUREMENTS_PER_S = 7000
_HERE = ("in this process", 0)


class BoxLink(Link):
    """Connects a client to `box` within one process; while `receive` advances `clock`, the box measures."""

    box: NetFtBox

    def __init__(self, box: NetFtBox, clock: VirtualClock) -> None:
        self.box, self._clock = box, clock
        self._due_ns = clock.now_ns()
        self._waiting: deque[bytes] = deque()
        self._closed = False

    def send(self, data: bytes) -> None:
        """Send a request to the box. Raises LinkClosed after `close`."""
        if self._closed:
            raise LinkClosed("the link to the box is closed")
        self.box.request(data, _HERE)

    def receive(self, timeout_s: float) -> bytes:
        """Advance the clock, and return the next datagram from the box; b"" after `timeout_s`.

        Raises LinkClosed after `close`.
        """
        if self._closed:
            raise LinkClosed("the link to the box is closed")
        end_ns = self._clock.now_ns() + round(timeout_s * _NANO)
        while not self._waiting and self._due_ns <= end_ns:
            self._clock.advance((self._due_ns - self._clock.now_ns()) / _NANO)
            datagrams = self.box.step(self._due_ns / _NANO)
            # If another client has requested the stream, its datagrams do not arrive at this link.
            self._waiting.extend(datagrams if self.box.client == _HERE else ())
            self._due_ns += round(self.box.settings.divisor / _MEASUREMENTS_PER_S * _NANO)
        if self._waiting:
            return self._waiting.popleft()
        self._clock.advance((end_ns - self._clock.now_ns()) / _NANO)
        return b""

    def close(self) -> None:
        """Close the link."""
        self._closed = True
