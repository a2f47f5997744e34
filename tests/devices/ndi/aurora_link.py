"""A link to a simulated tracker within one process, on a virtual clock."""

from __future__ import annotations

from collections import deque

from needleplan.devices import Link, VirtualClock
from needleplan.devices.ndi import AuroraDevice
from needleplan.errors import LinkClosed

_NANO = 1_000_000_000


class AuroraLink(Link):
    """Connects a client to `device` within one process; a reply arrives after 1 ms plus `device.faults.delay_s`."""

    device: AuroraDevice

    def __init__(self, device: AuroraDevice, clock: VirtualClock) -> None:
        self.device, self._clock = device, clock
        self._coming: deque[tuple[int, bytes]] = deque()
        self._closed = False

    def send(self, data: bytes) -> None:
        """Send bytes to the device. Raises LinkClosed after `close` or `unplug`."""
        self._check()
        self.say(self.device.answer(data))

    def say(self, data: bytes) -> None:
        """Queue bytes that the device sends to the client, also without a request."""
        due_ns = self._clock.now_ns() + round((0.001 + self.device.faults.delay_s) * _NANO)
        if data:
            self._coming.append((due_ns, data))

    def receive(self, timeout_s: float) -> bytes:
        """Advance the clock, and return the next bytes from the device; b"" after `timeout_s`.

        Raises LinkClosed after `close` or `unplug`.
        """
        self._check()
        end_ns = self._clock.now_ns() + round(timeout_s * _NANO)
        if self._coming and self._coming[0][0] <= end_ns:
            due_ns, data = self._coming.popleft()
            self._clock.advance((due_ns - self._clock.now_ns()) / _NANO)
            return data
        self._clock.advance((end_ns - self._clock.now_ns()) / _NANO)
        return b""

    def unplug(self) -> None:
        """Simulate an unplugged cable: further calls of `send` and `receive` raise LinkClosed."""
        self._closed = True

    def close(self) -> None:
        """Close the link."""
        self._closed = True

    def _check(self) -> None:
        if self._closed:
            raise LinkClosed("the link to the tracker is closed")
