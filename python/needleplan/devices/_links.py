"""Links, which carry bytes to and from a device: UDP, TCP, serial ports, and links within one process.

A link is used as a context manager, and read with a timeout. Datagram links (UDP) deliver whole datagrams, stream
links (TCP, serial) deliver bytes as they arrive. The protocols are in other modules, which do no input or output.
"""

from __future__ import annotations

import contextlib
import os
import socket
import time
from abc import abstractmethod
from pathlib import Path

import serial

from needleplan.devices._base import Closing
from needleplan.errors import AddressError, DeviceFault, LinkClosed, Mistake

__all__ = ["Link", "SerialLink", "TcpLink", "UdpLink"]


class Link(Closing):
    """Abstract connection to a device. One thread may send while another one receives."""

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Send all of `data`. Raises LinkClosed if the connection is closed."""

    @abstractmethod
    def receive(self, timeout_s: float) -> bytes:
        """Return the next datagram, or the available bytes of a stream; b"" after `timeout_s`. Raises LinkClosed."""

    @abstractmethod
    def close(self) -> None:
        """Close the connection; closing again does nothing."""


def _own_address(family: int, peer: tuple[str, int]) -> str:
    """Return the address of this machine from which datagrams to `peer` leave; "" (all) if there is no way to it."""
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(peer)  # of a datagram socket: chooses the way, sends nothing
            return str(probe.getsockname()[0])
        except OSError:
            return ""


_LONGEST = 65_536  # bytes that one call of `receive` reads at most


class UdpLink(Link):
    """Datagrams to and from one peer. Datagrams from other senders are dropped and counted in `unknown_senders`.

    Parameters
    ----------
    host : str
        Name or address of the peer.
    port : int
        UDP port of the peer.
    local_port : int, default 0
        UDP port of this machine; 0: any free port.
    local_host : str, optional
        Address of this machine that receives. Default: the address from which this machine reaches the peer. If the
        peer runs on this machine, this is the loopback address, and datagrams from the network are not received.

    Raises
    ------
    AddressError
        The host is unknown.
    DeviceFault
        The local port cannot be used.
    """

    # The socket is not connected, because the operating system would then drop datagrams of other senders uncounted.

    def __init__(self, host: str, port: int, local_port: int = 0, local_host: str = "") -> None:
        self.peer: tuple[str, int]
        family, self.peer = _resolve(host, port, socket.SOCK_DGRAM)
        self.unknown_senders: int = 0
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.bind((local_host or _own_address(family, self.peer), local_port))
        except OSError as error:
            self._socket.close()
            raise DeviceFault(f"UDP port {local_port} of this machine cannot be used: {error.strerror}") from error
        # Python waits for a socket with a timeout before it sends; meanwhile another thread may take the interpreter.
        self._sending = self._socket.dup()
        self._sending.setblocking(False)

        self.local_port: int = int(self._socket.getsockname()[1])
        """The port of this machine that receives the datagrams of the peer."""

    def hand_over(self) -> int:
        """Return the descriptor of the socket, which belongs to the caller from now on; this link is then closed."""
        self._sending.close()
        return self._socket.detach()

    def send(self, data: bytes) -> None:
        """Send one datagram at once; it is lost if the operating system has no room for it. Raises LinkClosed."""
        try:
            self._sending.sendto(data, self.peer)
        except BlockingIOError:
            return
        except OSError as error:
            raise LinkClosed(f"{_named('udp', self.peer)}: {error.strerror or error}") from error

    def receive(self, timeout_s: float) -> bytes:
        """Return the next datagram from the peer; b"" after `timeout_s`. Raises LinkClosed."""
        end = time.monotonic() + timeout_s
        while True:
            data, sender = self._next(max(end - time.monotonic(), 0.0))
            if sender is None or sender[:2] == self.peer[:2]:
                return data
            self.unknown_senders += 1

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
        """Close the socket, which frees its port."""
        self._sending.close()
        self._socket.close()


class TcpLink(Link):
    """A connection to a TCP server, which must accept it within `timeout_s`.

    Raises AddressError if the host is unknown, DeviceFault if the server cannot be reached.
    """

    def __init__(self, host: str, port: int, timeout_s: float = 3.0) -> None:
        self.peer: tuple[str, int]
        _, self.peer = _resolve(host, port, socket.SOCK_STREAM)
        try:
            self._socket = socket.create_connection(self.peer[:2], timeout=timeout_s)
        except OSError as error:
            raise DeviceFault(f"{_named('tcp', self.peer)} cannot be reached: {error.strerror or error}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, data: bytes) -> None:
        """Send all of `data`. Raises LinkClosed."""
        try:
            self._socket.settimeout(None)
            self._socket.sendall(data)
        except OSError as error:
            raise self._gone(error) from error

    def receive(self, timeout_s: float) -> bytes:
        """Return the available bytes; b"" after `timeout_s`. Raises LinkClosed."""
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
        raise AddressError(Mistake("host", host, "is not a host that this machine can find")) from error
    return family, (str(address[0]), int(address[1]))


def _named(scheme: str, peer: tuple[str, int]) -> str:
    return f"{scheme}://{peer[0]}:{peer[1]}"


_GONE = (
    OSError,
    TypeError,
)  # TypeError: pyserial reads from the descriptor None after another thread has closed the port


class SerialLink(Link):
    """A serial port with 8 data bits, no parity, 1 stop bit, and no handshake.

    The link also works on a pseudo-terminal, because it does not use the modem control lines, which a pseudo-terminal
    lacks. Raises AddressError if `baud` is not positive, DeviceFault if the port is missing or cannot be opened.
    """

    def __init__(self, path: str, baud: int = 9600) -> None:
        self.path = path
        if not Path(path).exists():
            raise DeviceFault(f"serial://{path}: there is no such port")
        try:
            self._port = serial.Serial(path, baud, timeout=0, write_timeout=2.0, exclusive=True)
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise DeviceFault(f"serial://{path} cannot be opened: {error}") from error

    def hand_over(self) -> int:
        """Return a descriptor of the open port, which belongs to the caller from now on; this link is then closed.

        An adapter that collects received bytes, as those of FTDI do for 16 ms, is told to pass them on at once.
        """
        with contextlib.suppress(OSError, ValueError, AttributeError, NotImplementedError):  # a pseudo-terminal
            self._port.set_low_latency_mode(True)
        descriptor = os.dup(self._port.fileno())  # the lock that keeps others out is that of the open port
        self.close()
        return descriptor

    @property
    def baud(self) -> int:
        """Speed of the line, bit/s. Setting a speed raises LinkClosed if the port does not accept the speed."""
        return int(self._port.baudrate)

    @baud.setter
    def baud(self, baud: int) -> None:
        try:
            self._port.flush()
            self._port.baudrate = baud
        except (*_GONE, ValueError) as error:
            raise LinkClosed(f"serial://{self.path}: {baud} baud: {error}") from error

    def send_break(self, seconds: float = 0.25) -> None:
        """Send a serial break of `seconds`, which resets some devices. Raises LinkClosed."""
        try:
            self._port.send_break(seconds)
        except _GONE as error:
            raise LinkClosed(f"serial://{self.path}: {error}") from error

    def send(self, data: bytes) -> None:
        """Send all of `data`. Raises LinkClosed."""
        try:
            self._port.write(data)
        except _GONE as error:
            raise LinkClosed(f"serial://{self.path}: {error}") from error

    def receive(self, timeout_s: float) -> bytes:
        """Return the available bytes; b"" after `timeout_s`. Raises LinkClosed if the port is closed or was removed."""
        try:
            self._port.timeout = max(timeout_s, 0.0)
            first = bytes(self._port.read(1))
            waiting = self._port.in_waiting if first else 0
            return first + bytes(self._port.read(min(waiting, _LONGEST))) if waiting else first
        except _GONE as error:
            raise LinkClosed(f"serial://{self.path}: {error}") from error

    def close(self) -> None:
        """Close the serial port."""
        with contextlib.suppress(*_GONE):
            self._port.close()
