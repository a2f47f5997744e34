"""Links over a serial port, and over a pseudo-terminal in its place.

A pseudo-terminal has no modem lines: it answers ENOTTY where they are asked for. So nothing here asks.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import serial

from needleplan.devices.link import Link
from needleplan.errors import AddressError, DeviceFault, LinkClosed, Mistake

__all__ = ["SerialLink"]

_LONGEST = 65_536
_GONE = (OSError, TypeError)  # pyserial reads from the descriptor None, a TypeError, where another thread has closed it


class SerialLink(Link):
    """A stream of bytes over a serial port with 8 data bits, no parity, 1 stop bit, no handshake."""

    def __init__(self, path: str, baud: int = 9600) -> None:
        if baud <= 0:
            raise AddressError(Mistake("baud", str(baud), "must be positive"))
        self.path = path
        if not Path(path).exists():
            raise DeviceFault(f"serial://{path}: there is no such port")
        try:
            self._port = serial.Serial(path, baud, timeout=0, write_timeout=2.0, exclusive=True)
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise DeviceFault(f"serial://{path} cannot be opened: {error}") from error

    @property
    def baud(self) -> int:
        """Bits in a second."""
        return int(self._port.baudrate)

    @baud.setter
    def baud(self, baud: int) -> None:
        try:
            self._port.flush()
            self._port.baudrate = baud
        except (*_GONE, ValueError) as error:
            raise LinkClosed(f"serial://{self.path}: {baud} baud: {error}") from error

    def send_break(self, seconds: float = 0.25) -> None:
        """Hold the line low, which resets some devices."""
        try:
            self._port.send_break(seconds)
        except _GONE as error:
            raise LinkClosed(f"serial://{self.path}: {error}") from error

    def send(self, data: bytes) -> None:
        """Send all of `data`."""
        try:
            self._port.write(data)
        except _GONE as error:
            raise LinkClosed(f"serial://{self.path}: {error}") from error

    def receive(self, timeout_s: float) -> bytes:
        """Return the bytes that are there; empty after `timeout_s`. Raises LinkClosed where the cable is out."""
        try:
            self._port.timeout = max(timeout_s, 0.0)
            first = bytes(self._port.read(1))
            waiting = self._port.in_waiting if first else 0
            return first + bytes(self._port.read(min(waiting, _LONGEST))) if waiting else first
        except _GONE as error:
            raise LinkClosed(f"serial://{self.path}: {error}") from error

    def close(self) -> None:
        """Give the port back."""
        with contextlib.suppress(*_GONE):
            self._port.close()
