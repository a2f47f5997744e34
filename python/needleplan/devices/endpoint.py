"""Servers that offer a simulated device at a TCP port or pseudo-terminal; clients connect as to a real device."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import sys
import termios
import threading
import tty
from abc import abstractmethod
from typing import Protocol

from needleplan.devices._base import Closing

__all__ = ["Answering", "Endpoint", "PtyEndpoint", "TcpEndpoint"]

_LONGEST = 65_536  # bytes that are read from a client at once, at most


class Answering(Protocol):
    """Protocol of a simulated device: it receives bytes and answers with bytes."""

    def answer(self, data: bytes) -> bytes:
        """Receive bytes and return the answer of the device; it may be b""."""


class Endpoint(Closing):
    """Abstract server that offers one simulated device; it serves in its own thread."""

    def __init__(self, device: Answering) -> None:
        self.device = device
        self._stopping = threading.Event()
        self._woken, self._wake = os.pipe()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    @abstractmethod
    def address(self) -> str:
        """The address by which a client opens the device."""

    @abstractmethod
    def say(self, data: bytes) -> None:
        """Send bytes to the client without a request."""

    @abstractmethod
    def _serve(self) -> None:
        """Answer the clients until `_ready` returns False."""

    def _ready(self, descriptor: int) -> bool:
        """Wait for input at `descriptor` and return True; return False if the endpoint is stopping."""
        readable, _, _ = select.select([descriptor, self._woken], [], [])
        return self._woken not in readable

    def close(self) -> None:
        """Stop serving and close the connection of the client. Closing again does nothing."""
        if self._stopping.is_set():
            return
        self._stopping.set()
        os.write(self._wake, b"x")
        self._thread.join()
        os.close(self._wake)
        os.close(self._woken)
        self._release()

    @abstractmethod
    def _release(self) -> None:
        """Release the port or terminal."""


class TcpEndpoint(Endpoint):
    """Offers a simulated device at a TCP port to one client at a time."""

    host: str
    port: int

    def __init__(self, device: Answering, host: str = "127.0.0.1", port: int = 0) -> None:
        self._server = socket.create_server((host, port))
        self.host, self.port = self._server.getsockname()[:2]
        self._client: socket.socket | None = None
        super().__init__(device)

    @property
    def address(self) -> str:
        """`tcp://host:port`."""
        return f"tcp://{self.host}:{self.port}"

    def say(self, data: bytes) -> None:
        """Send bytes to the client, if one is connected."""
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.sendall(data)

    def _serve(self) -> None:
        while self._ready(self._server.fileno()):
            self._client, _ = self._server.accept()
            with self._client:
                self._converse(self._client)
            self._client = None

    def _converse(self, client: socket.socket) -> None:
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with contextlib.suppress(OSError):
            while self._ready(client.fileno()):
                data = client.recv(_LONGEST)
                if not data:
                    return
                client.sendall(self.device.answer(data))

    def _release(self) -> None:
        self._server.close()


class PtyEndpoint(Endpoint):
    """Offers a simulated device at a pseudo-terminal.

    If the device has an attribute `baud` and the client sets another speed, the device receives nothing (Linux only).
    """

    def __init__(self, device: Answering) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path: str = os.ttyname(self._slave)
        super().__init__(device)

    @property
    def address(self) -> str:
        """`serial:///dev/pts/n`."""
        return f"serial://{self.path}"

    def say(self, data: bytes) -> None:
        """Send bytes to the client."""
        with contextlib.suppress(OSError):
            os.write(self._master, data)

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while self._ready(self._master):
                data = os.read(self._master, _LONGEST)
                if self._speeds_agree():
                    self.say(self.device.answer(data))

    def _speeds_agree(self) -> bool:
        baud = getattr(self.device, "baud", None)
        if baud is None or not sys.platform.startswith("linux"):
            return True
        # On Linux the attributes of the line can be read from the master descriptor.
        return bool(termios.tcgetattr(self._master)[4] == getattr(termios, f"B{baud}", None))

    def _release(self) -> None:
        os.close(self._slave)
        os.close(self._master)
