"""Where a robot receives and sends datagrams: a UDP socket, or the far end of a simulated serial line."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
from abc import abstractmethod

from needleplan.devices._base import Closing
from needleplan.devices.robot._frames import Unframer, framed
from needleplan.devices.robot._machine import Peer
from needleplan.devices.robot._way import LINE_BAUD

__all__ = ["PtyDoor", "RobotDoor", "UdpDoor"]

_LONGEST = 2048  # bytes that are read at once


class RobotDoor(Closing):
    """Abstract door of a robot. `address` is where a controller finds the robot; `host` and `port` are its parts."""

    address: str
    host: str
    port: int

    @abstractmethod
    def fileno(self) -> int:
        """Return the descriptor that is readable when datagrams have arrived."""

    @abstractmethod
    def receive(self) -> list[tuple[bytes, Peer]]:
        """Return the datagrams that have arrived, with their senders; wait for none."""

    @abstractmethod
    def send(self, datagram: bytes, peer: Peer) -> None:
        """Send a datagram; it may be lost."""


class UdpDoor(RobotDoor):
    """A UDP socket of this machine. Raises OSError if it cannot be opened."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self.host, self.port = self._socket.getsockname()
        self.address = f"udp://{self.host}:{self.port}"

    def fileno(self) -> int:
        """Return the descriptor of the socket."""
        return self._socket.fileno()

    def receive(self) -> list[tuple[bytes, Peer]]:
        """Return the next datagram, if one has arrived."""
        try:
            return [self._socket.recvfrom(_LONGEST)]
        except OSError:
            return []

    def send(self, datagram: bytes, peer: Peer) -> None:
        """Send a datagram; it is lost if the socket has no room."""
        with contextlib.suppress(OSError):
            self._socket.sendto(datagram, peer)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class PtyDoor(RobotDoor):
    """A pseudo-terminal, whose other end is the serial port of the controller.

    If the controller sets another speed than 460,800 bit/s, nothing arrives in either direction (Linux only).
    """

    host, port = "", 0

    def __init__(self) -> None:
        import termios
        import tty

        self._termios = termios
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self._set_speed()
        os.set_blocking(self._master, False)
        self._unframer = Unframer()
        self._is_closed = False
        self.address = f"serial://{os.ttyname(self._slave)}"

    def fileno(self) -> int:
        """Return the descriptor of the robot's end."""
        return self._master

    def receive(self) -> list[tuple[bytes, Peer]]:
        """Return the datagrams that have arrived; the senders are the numbers of their frames."""
        try:
            data = os.read(self._master, _LONGEST)
        except OSError:
            return []
        if not self._speeds_agree():
            return []
        return [(datagram, ("line", sender)) for sender, datagram in self._unframer.take(data)]

    def send(self, datagram: bytes, peer: Peer) -> None:
        """Send a datagram; it is lost if the line has no room."""
        if self._speeds_agree():
            with contextlib.suppress(OSError):
                os.write(self._master, framed(peer[1], datagram))

    def close(self) -> None:
        """Close both ends."""
        if not self._is_closed:
            self._is_closed = True
            os.close(self._slave)
            os.close(self._master)

    def _set_speed(self) -> None:
        termios = self._termios
        attributes = termios.tcgetattr(self._slave)
        attributes[4] = attributes[5] = getattr(termios, f"B{LINE_BAUD}", attributes[4])
        termios.tcsetattr(self._slave, termios.TCSANOW, attributes)

    def _speeds_agree(self) -> bool:
        if not sys.platform.startswith("linux"):
            return True
        # On Linux the attributes of the line can be read from the robot's end.
        termios = self._termios
        return bool(termios.tcgetattr(self._master)[4] == getattr(termios, f"B{LINE_BAUD}", None))
