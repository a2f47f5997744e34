"""A CAN bus through the library `canopen`, which is optional: frames that came, with their time, and frames to send."""

from __future__ import annotations

import contextlib
import queue
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from needleplan.devices.cia402.objects import Service
from needleplan.devices.clock import Clock
from needleplan.devices.closing import Closing
from needleplan.errors import ConfigurationError, DeviceFault, LinkClosed, Mistake

__all__ = ["CanBus", "Frame", "library"]

_SYNC = 0x80
_CYCLE_S = 0.02


@dataclass(frozen=True)
class Frame:
    """What a node sent by itself."""

    node: int
    service: Service
    data: bytes
    received_ns: int


def library(name: str = "canopen") -> Any:
    """Return `canopen` or a part of it. Raises ConfigurationError that names the extra where it is not installed."""
    try:
        return import_module(name)
    except ImportError as error:
        rule = "needs the library canopen: install it with `pip install needleplan[canopen]`"
        raise ConfigurationError(Mistake("canopen", "", rule)) from error


class CanBus(Closing):
    """A bus; a context manager. Raises ConfigurationError without the library, DeviceFault where there is no bus."""

    def __init__(self, channel: str, interface: str, clock: Clock, **options: Any) -> None:
        canopen = library()
        self._errors: tuple[type[Exception], ...] = (library("can").CanError, OSError, RuntimeError)
        self.name = f"canopen://{channel}"
        self.clock = clock
        self.network = canopen.Network()
        self.network.NOTIFIER_CYCLE = _CYCLE_S  # so long closing takes at most
        self.frames: queue.SimpleQueue[Frame] = queue.SimpleQueue()
        self._closed = False
        try:
            self.network.connect(channel=channel, interface=interface, **options)
        except (*self._errors, ValueError, NotImplementedError, ImportError) as error:
            raise DeviceFault(f"{self.name} cannot be opened by {interface}: {error}") from error

    def listen(self, node: int, *services: Service) -> None:
        """Have what a node sends by itself put into `frames`."""
        for service in services:
            self.network.subscribe(service + node, self._put(node, service))

    def _put(self, node: int, service: Service) -> Any:
        def put(_identifier: int, data: bytearray, _timestamp: float) -> None:
            self.frames.put(Frame(node, service, bytes(data), self.clock.now_ns()))

        return put

    def send(self, identifier: int, data: bytes) -> None:
        """Send one frame. Raises LinkClosed where the bus is gone, or is off after too many errors."""
        if self._closed:
            raise LinkClosed(f"{self.name} is closed")
        try:
            self.network.send_message(identifier, data)
        except self._errors as error:
            raise LinkClosed(f"{self.name}: {error}") from error

    def sync(self) -> None:
        """Have all drives say where they are."""
        self.send(_SYNC, b"")

    def close(self) -> None:
        """Leave the bus."""
        if not self._closed:
            self._closed = True
            # Where the bus went before us, the library says so once more when all has been given back.
            with contextlib.suppress(*self._errors):
                self.network.disconnect()
