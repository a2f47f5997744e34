"""Deadman switches: the needle moves only while a person holds a key, a pedal, or a program that sends heartbeats."""

from __future__ import annotations

import os
import select
import socket
import struct
import sys
import threading
import time
from abc import abstractmethod
from collections.abc import Callable
from typing import Any

from needleplan.devices import Address, Closing
from needleplan.errors import AddressError, DeviceFault, Mistake

__all__ = ["Deadman", "DeadmanThread", "KeyDeadman", "PedalDeadman", "UdpDeadman", "open_deadman"]

# time (s) after the first key, within which a terminal begins to repeat a key that is held
_FIRST_S = 0.7
# longest time (s) between two repetitions of a key, and between two heartbeats
_REPEAT_S, _HEARTBEAT_S = 0.15, 0.2
# time (s) between two reports to the guard
_REPORT_S = 0.02
# struct input_event of Linux on 64-bit machines: time (two numbers), type, code, value
_INPUT_EVENT = struct.Struct("qqHHi")
_KEY_EVENT, _RELEASED = 1, 0


class Deadman(Closing):
    """Abstract deadman switch."""

    @abstractmethod
    def is_held(self, timeout_s: float) -> bool:
        """Wait at most `timeout_s` for a signal, and return whether a person holds the switch now."""


class KeyDeadman(Deadman):
    """A key of the terminal on standard input. Terminals report keys, not releases, so the key must repeat.

    After the first key, the switch counts as held for 0.7 s, because terminals begin to repeat after this time; then
    the switch counts as released 0.15 s after the last repetition. Raises DeviceFault if standard input is no terminal.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        import termios  # not on every system
        import tty

        self._input = sys.stdin.fileno() if descriptor is None else descriptor
        if not os.isatty(self._input):
            raise DeviceFault("deadman: standard input is not a terminal; a key cannot be held")
        self._before = termios.tcgetattr(self._input)
        self._until_s = 0.0
        tty.setcbreak(self._input)

    def is_held(self, timeout_s: float) -> bool:
        """Wait at most `timeout_s` for a key, and return whether a person holds it."""
        if select.select([self._input], [], [], timeout_s)[0] and os.read(self._input, 1024):
            now_s = time.monotonic()
            self._until_s = now_s + (_REPEAT_S if now_s < self._until_s else _FIRST_S)
        return time.monotonic() < self._until_s

    def close(self) -> None:
        """Restore the settings of the terminal."""
        import termios

        termios.tcsetattr(self._input, termios.TCSADRAIN, self._before)


class UdpDeadman(Deadman):
    """Heartbeats in UDP datagrams: `1` means held, anything else released. Without a datagram for 0.2 s: released.

    While the switch is held, only datagrams of its sender count.
    """

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._until_s, self._sender = 0.0, None
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise DeviceFault(f"deadman: UDP port {port} of {host} cannot be used: {error.strerror}") from error

    @property
    def port(self) -> int:
        """The port at which heartbeats are received."""
        return int(self._socket.getsockname()[1])

    def is_held(self, timeout_s: float) -> bool:
        """Wait at most `timeout_s` for a heartbeat, and return whether a person holds the switch."""
        self._socket.settimeout(max(timeout_s, 0.001))
        try:
            data, sender = self._socket.recvfrom(64)
        except OSError:
            return time.monotonic() < self._until_s
        now_s = time.monotonic()
        if now_s >= self._until_s or sender == self._sender:
            self._sender = sender
            self._until_s = now_s + _HEARTBEAT_S if data.strip() == b"1" else 0.0
        return now_s < self._until_s

    def close(self) -> None:
        """Close the port."""
        self._socket.close()


class PedalDeadman(Deadman):
    """A pedal or key of an input device of Linux (evdev), such as /dev/input/event5, held between press and release.

    Raises DeviceFault if the device cannot be opened. If the device disappears, the switch counts as released.
    """

    def __init__(self, path: str) -> None:
        try:
            self._device = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise DeviceFault(f"deadman: {path}: {error.strerror}") from error
        self._held = False
        self._rest = b""

    def is_held(self, timeout_s: float) -> bool:
        """Wait at most `timeout_s` for an event, and return whether a person holds the pedal."""
        if not select.select([self._device], [], [], timeout_s)[0]:
            return self._held
        try:
            data = os.read(self._device, 64 * _INPUT_EVENT.size)
        except BlockingIOError:
            return self._held
        except OSError:
            data = b""
        if not data:  # the device is gone
            self._held = False
            time.sleep(timeout_s)
            return False
        data = self._rest + data
        whole = len(data) // _INPUT_EVENT.size * _INPUT_EVENT.size
        self._rest = data[whole:]
        for _, _, kind, _, value in _INPUT_EVENT.iter_unpack(data[:whole]):
            if kind == _KEY_EVENT:
                self._held = value != _RELEASED
        return self._held

    def close(self) -> None:
        """Close the device."""
        os.close(self._device)


def open_deadman(text: str, option: str = "--deadman") -> Deadman:
    """Open a deadman switch.

    Parameters
    ----------
    text : str
        `key`, `udp://host:port` or `evdev:///dev/input/event5`.
    option : str, default "--deadman"
        Command line option that gave the text, for messages.

    Returns
    -------
    Deadman

    Raises
    ------
    AddressError
        The text is something else.
    DeviceFault
        The switch cannot be used.
    """
    if text == "key":
        return KeyDeadman()
    if text.startswith("evdev:///"):
        return PedalDeadman(text.removeprefix("evdev://"))
    if text.startswith("udp://"):
        parsed = Address.parse(text)
        if parsed.port is not None:
            return UdpDeadman(parsed.host or "127.0.0.1", parsed.port)
    rule = "must be key, udp://HOST:PORT (an address of this machine), or evdev:///dev/input/eventN"
    raise AddressError(Mistake(option, text, rule))


class DeadmanThread(Closing):
    """A thread that calls `report(held)` at least every 20 ms until it is closed; closing closes the switch too.

    If the switch fails, `report` is not called any more, so that the guard takes the switch for released.
    """

    def __init__(self, deadman: Deadman, report: Callable[[bool], Any]) -> None:
        self._deadman, self._report = deadman, report
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="deadman", daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while not self._closing.is_set():
            held = self._deadman.is_held(_REPORT_S)
            try:
                self._report(held)
            except DeviceFault:  # the guard is blocked, and has sent a stop
                continue

    def close(self) -> None:
        """End the thread and close the switch. Closing twice is harmless."""
        if not self._closing.is_set():
            self._closing.set()
            self._thread.join()
            self._deadman.close()
