"""Simulated devices behind TCP ports and pseudo-terminals, for clients that open them like real devices."""

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

_LONGEST = 65_536


class Answering(Protocol):
    """A device that answers bytes with bytes."""

    def answer(self, data: bytes) -> bytes:
        """Take bytes and return the answer of the device."""


class Endpoint(Closing):
    """Abstract server of one device."""

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
        """Send bytes without a request."""

    @abstractmethod
    def _serve(self) -> None:
        """Answer until `_stopping` is set."""

    def _ready(self, descriptor: int) -> bool:
        """Wait for input; return False if the endpoint is stopping."""
        readable, _, _ = select.select([descriptor, self._woken], [], [])
        return self._woken not in readable

    def close(self) -> None:
        """Stop serving; clients find their link closed. Closing again does nothing."""
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
    """A device behind a TCP port, for one client after another."""

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
    """A device behind a pseudo-terminal; if the device has another `baud` than the line, it receives nothing."""

    def __init__(self, device: Answering) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
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
        # On Linux the master has the attributes of the line.
        return bool(termios.tcgetattr(self._master)[4] == getattr(termios, f"B{baud}", None))

    def _release(self) -> None:
        os.close(self._slave)
        os.close(self._master)
