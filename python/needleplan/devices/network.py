"""Links over the network: UDP for datagrams, TCP for a stream."""

from __future__ import annotations

import contextlib
import socket
import time

from needleplan.devices.link import Link
from needleplan.errors import AddressError, DeviceFault, LinkClosed, Mistake

__all__ = ["TcpLink", "UdpLink"]

_LONGEST = 65_536


class UdpLink(Link):
    """Datagrams to and from one peer; those of anybody else are counted in `strangers` and dropped.

    The socket is not connected in the sense of the operating system, which would drop strangers without a word.
    """

    def __init__(self, host: str, port: int, local_port: int = 0, local_host: str = "") -> None:
        family, self.peer = _resolve(host, port, socket.SOCK_DGRAM)
        self.strangers = 0
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.bind((local_host, local_port))
        except OSError as error:
            self._socket.close()
            raise DeviceFault(f"UDP port {local_port} of this machine cannot be used: {error.strerror}") from error

    @property
    def local_port(self) -> int:
        """The port of this machine that the peer answers to."""
        return int(self._socket.getsockname()[1])

    def send(self, data: bytes) -> None:
        """Send one datagram."""
        try:
            self._socket.sendto(data, self.peer)
        except OSError as error:
            raise LinkClosed(f"{_named('udp', self.peer)}: {error.strerror or error}") from error

    def receive(self, timeout_s: float) -> bytes:
        """Return the next datagram of the peer; empty after `timeout_s`."""
        end = time.monotonic() + timeout_s
        while True:
            data, sender = self._next(max(end - time.monotonic(), 0.0))
            if sender is None or sender[:2] == self.peer[:2]:
                return data
            self.strangers += 1

    def _next(self, timeout_s: float) -> tuple[bytes, tuple[str, int] | None]:
        try:
            self._socket.settimeout(timeout_s)
            data, sender = self._socket.recvfrom(_LONGEST)
        except (TimeoutError, BlockingIOError):
            return b"", None
        except OSError as error:
            raise LinkClosed(f"{_named('udp', self.peer)}: {error.strerror or error}") from error
        return data, sender

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()


class TcpLink(Link):
    """A stream of bytes to a server."""

    def __init__(self, host: str, port: int, timeout_s: float = 3.0) -> None:
        _, self.peer = _resolve(host, port, socket.SOCK_STREAM)
        try:
            self._socket = socket.create_connection(self.peer[:2], timeout=timeout_s)
        except OSError as error:
            raise DeviceFault(f"{_named('tcp', self.peer)} cannot be reached: {error.strerror or error}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, data: bytes) -> None:
        """Send all of `data`."""
        try:
            self._socket.settimeout(None)
            self._socket.sendall(data)
        except OSError as error:
            raise self._gone(error) from error

    def receive(self, timeout_s: float) -> bytes:
        """Return the bytes that are there; empty after `timeout_s`."""
        try:
            self._socket.settimeout(max(timeout_s, 0.0))
            data = self._socket.recv(_LONGEST)
        except (TimeoutError, BlockingIOError):
            return b""
        except OSError as error:
            raise self._gone(error) from error
        if not data:
            raise LinkClosed(f"{_named('tcp', self.peer)}: closed by the other end")
        return data

    def _gone(self, error: OSError) -> LinkClosed:
        return LinkClosed(f"{_named('tcp', self.peer)}: {error.strerror or error}")

    def close(self) -> None:
        """Close the connection."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


def _resolve(host: str, port: int, kind: socket.SocketKind) -> tuple[socket.AddressFamily, tuple[str, int]]:
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=kind)[0]
    except (OSError, UnicodeError) as error:
        raise AddressError(Mistake("host", host, "is not a name or number that this machine can find")) from error
    return family, (str(address[0]), int(address[1]))


def _named(scheme: str, peer: tuple[str, int]) -> str:
    return f"{scheme}://{peer[0]}:{peer[1]}"
