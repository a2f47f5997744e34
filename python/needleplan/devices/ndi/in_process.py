"""A link to an NDI device in this process, on a clock that moves only when somebody waits."""

from __future__ import annotations

from collections import deque

from needleplan.devices.clock import VirtualClock
from needleplan.devices.link import Link
from needleplan.devices.ndi.simulator import AuroraDevice
from needleplan.errors import LinkClosed

__all__ = ["DeviceLink"]

_NANO = 1_000_000_000


class DeviceLink(Link):
    """Carries bytes to and from `device`; a reply takes a millisecond and what `device.faults.delay_s` adds."""

    def __init__(self, device: AuroraDevice, clock: VirtualClock) -> None:
        self.device, self._clock = device, clock
        self._coming: deque[tuple[int, bytes]] = deque()
        self._closed = False

    def send(self, data: bytes) -> None:
        """Give bytes to the device."""
        self._check()
        self.say(self.device.answer(data))

    def say(self, data: bytes) -> None:
        """Let the device send bytes."""
        due_ns = self._clock.now_ns() + round((0.001 + self.device.faults.delay_s) * _NANO)
        if data:
            self._coming.append((due_ns, data))

    def receive(self, timeout_s: float) -> bytes:
        """Return the next bytes, or let `timeout_s` pass."""
        self._check()
        end_ns = self._clock.now_ns() + round(timeout_s * _NANO)
        if self._coming and self._coming[0][0] <= end_ns:
            due_ns, data = self._coming.popleft()
            self._clock.advance((due_ns - self._clock.now_ns()) / _NANO)
            return data
        self._clock.advance((end_ns - self._clock.now_ns()) / _NANO)
        return b""

    def unplug(self) -> None:
        """Take the cable out."""
        self._closed = True

    def close(self) -> None:
        """Give the link up."""
        self._closed = True

    def _check(self) -> None:
        if self._closed:
            raise LinkClosed("the link to the tracker is closed")
