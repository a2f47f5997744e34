"""Relays between `needleplan insert` and the devices of a lab, which delay, drop, change and add datagrams.

A relay passes everything that it receives to a filter of its direction. A filter returns what is sent instead: pairs of
a delay (s) and bytes. One thread serves all relays, so that filters need no locks.
"""

import contextlib
import heapq
import itertools
import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable

from needleplan.devices import Closing

Sent = Iterable[tuple[float, bytes]]
Filter = Callable[[bytes], Sent]
Tap = Callable[[bytes, float], None]


def as_it_is(data: bytes) -> Sent:
    """Pass data on at once."""
    return [(0.0, data)]


def nothing(_: bytes) -> Sent:
    """Drop data."""
    return []


class Relay(ABC):
    """One link through the proxy. `to_device` and `to_client` are the filters of its two directions.

    `tap_to_device` and `tap_to_client` are called with everything that arrives from the client or from the device, and
    its time (s), before the filter.
    """

    def __init__(self) -> None:
        self.to_device: Filter = as_it_is
        self.to_client: Filter = as_it_is
        self.tap_to_device: Tap = lambda *_: None
        self.tap_to_client: Tap = lambda *_: None

    @abstractmethod
    def sockets(self) -> list[socket.socket]:
        """Return the sockets that are read now."""

    @abstractmethod
    def serve(self, which: socket.socket) -> tuple[bytes, bool] | None:
        """Receive from a socket; return the data and whether they are for the device, or None."""

    @abstractmethod
    def send(self, data: bytes, to_device: bool) -> None:
        """Send data to the device or to the client."""

    @abstractmethod
    def close(self) -> None:
        """Close all sockets."""


class UdpRelay(Relay):
    """Relay for datagrams; `port` is the port for the client, and the last sender there is the client."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        self.device = (host, port)
        self.client: tuple[str, int] | None = None
        self.front, self.back = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        for each in (self.front, self.back):
            each.bind(("127.0.0.1", 0))
        self.port = int(self.front.getsockname()[1])

    def sockets(self) -> list[socket.socket]:
        """Return the sockets that are read now."""
        return [self.front, self.back]

    def serve(self, which: socket.socket) -> tuple[bytes, bool] | None:
        """Receive from a socket; return the data and whether they are for the device, or None."""
        try:
            data, sender = which.recvfrom(65_536)
        except OSError:
            return None
        if which is self.front:
            self.client = sender
        return data, which is self.front

    def send(self, data: bytes, to_device: bool) -> None:
        """Send data to the device or to the client."""
        with contextlib.suppress(OSError):
            if to_device:
                self.back.sendto(data, self.device)
            elif self.client is not None:
                self.front.sendto(data, self.client)

    def close(self) -> None:
        """Close all sockets."""
        self.front.close()
        self.back.close()


class TcpRelay(Relay):
    """Relay for one TCP connection; `port` is the port for the client."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__()
        self.device = (host, port)
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self.listener.getsockname()[1])
        self.front: socket.socket | None = None
        self.back: socket.socket | None = None

    def sockets(self) -> list[socket.socket]:
        """Return the sockets that are read now."""
        return [each for each in (self.listener, self.front, self.back) if each is not None]

    def serve(self, which: socket.socket) -> tuple[bytes, bool] | None:
        """Receive from a socket; return the data and whether they are for the device, or None."""
        if which is self.listener:
            self.cut()
            self.front, _ = self.listener.accept()
            self.back = socket.create_connection(self.device)
            for each in (self.front, self.back):
                each.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return None
        data = b""
        with contextlib.suppress(OSError):
            data = which.recv(65_536)
        if not data:
            self.cut()
            return None
        return data, which is self.front

    def send(self, data: bytes, to_device: bool) -> None:
        """Send data to the device or to the client."""
        end = self.back if to_device else self.front
        if end is not None:
            with contextlib.suppress(OSError):
                end.sendall(data)

    def cut(self) -> None:
        """Close the connection on both sides."""
        for each in (self.front, self.back):
            if each is not None:
                each.close()
        self.front = self.back = None

    def close(self) -> None:
        """Close all sockets."""
        self.cut()
        self.listener.close()


class Proxy(Closing):
    """Serves relays in a thread of its own until it is closed."""

    def __init__(self, relays: Iterable[Relay]) -> None:
        self._relays = list(relays)
        self._waiting: list[tuple[float, int, Relay, bytes, bool]] = []
        self._count = itertools.count()
        self._calls: list[Callable[[], object]] = []
        self.worst_pause_s = 0.0
        """Longest time that the thread did not run although it should, because the machine paused."""

        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def call(self, what: Callable[[], object]) -> None:
        """Call a function in the thread of the relays, between two datagrams."""
        self._calls.append(what)

    def later(self, relay: Relay, delay_s: float, data: bytes, *, to_device: bool) -> None:
        """Send data through a relay after a delay, without a filter. Call it in the thread of the relays only."""
        heapq.heappush(self._waiting, (time.monotonic() + delay_s, next(self._count), relay, data, to_device))

    def _run(self) -> None:
        while not self._closing.is_set():
            while self._calls:
                self._calls.pop(0)()
            now_s = time.monotonic()
            while self._waiting and self._waiting[0][0] <= now_s:
                _, _, relay, data, to_device = heapq.heappop(self._waiting)
                relay.send(data, to_device)
            wait_s = max(min(self._waiting[0][0] - now_s, 0.002), 0.0) if self._waiting else 0.002
            ends = {end: relay for relay in self._relays for end in relay.sockets()}
            with contextlib.suppress(OSError, ValueError):
                for end in select.select(list(ends), [], [], wait_s)[0]:
                    self._pass(ends[end], end)
            self.worst_pause_s = max(self.worst_pause_s, time.monotonic() - now_s - wait_s)

    def _pass(self, relay: Relay, end: socket.socket) -> None:
        found = relay.serve(end)
        if found is None:
            return
        data, to_device = found
        (relay.tap_to_device if to_device else relay.tap_to_client)(data, time.monotonic())
        for delay_s, sent in (relay.to_device if to_device else relay.to_client)(data):
            if delay_s <= 0:
                relay.send(sent, to_device)
            else:
                self.later(relay, delay_s, sent, to_device=to_device)

    def close(self) -> None:
        """Stop the thread and close all relays."""
        self._closing.set()
        self._thread.join()
        for each in self._relays:
            each.close()
