"""A link to a simulated PLUS server within one process, on a virtual clock."""

from __future__ import annotations

from collections import deque

from needleplan.devices import Link, VirtualClock
from needleplan.devices.igtl import PlusDevice
from needleplan.errors import LinkClosed

_NANO = 1_000_000_000


class PlusLink(Link):
    """Connects a client to `device` within one process; frames are queued for the client as the clock advances."""

    device: PlusDevice

    def __init__(self, device: PlusDevice, clock: VirtualClock) -> None:
        self.device, self._clock = device, clock
        self._began_ns = clock.now_ns()
        self._frames = 0
        self._coming: deque[bytes] = deque()
        self._closed = False

    def send(self, data: bytes) -> None:
        """Send bytes to the device. Raises LinkClosed after `close` or `unplug`."""
        self._check()
        if reply := self.device.answer(data):
            self._coming.append(reply)

    def receive(self, timeout_s: float) -> bytes:
        """Return all bytes that have arrived, or b"" after `timeout_s`.

        If no bytes have arrived, the clock advances until bytes arrive, at most by `timeout_s`. Raises LinkClosed after
        `close` or `unplug`.
        """
        self._check()
        end_ns = self._clock.now_ns() + round(timeout_s * _NANO)
        while True:
            self._catch_up()
            if self._coming:
                data = b"".join(self._coming)
                self._coming.clear()
                return data
            due_ns = min(self._due_ns, end_ns)
            if self._clock.now_ns() >= end_ns:
                return b""
            self._clock.advance((due_ns - self._clock.now_ns()) / _NANO)

    def say(self, data: bytes) -> None:
        """Queue bytes for the client that are not part of a frame or reply."""
        self._coming.append(data)

    def unplug(self) -> None:
        """Simulate an unplugged cable: further calls of `send` and `receive` raise LinkClosed."""
        self._closed = True

    def close(self) -> None:
        """Close the link."""
        self._closed = True

    @property
    def _due_ns(self) -> int:
        return self._began_ns + round((self._frames + 1) / self.device.rate_hz * _NANO)

    def _catch_up(self) -> None:
        while self._due_ns <= self._clock.now_ns():
            self._frames += 1
            if data := self.device.frame(self._frames / self.device.rate_hz):
                self._coming.append(data)

    def _check(self) -> None:
        if self._closed:
            raise LinkClosed("the link to the tracker is closed")
