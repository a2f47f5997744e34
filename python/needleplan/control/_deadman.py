"""Deadman switches: the needle moves only while a person holds a key, a pedal, or a program that sends heartbeats."""

from __future__ import annotations

import math
import os
import select
import struct
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from needleplan.control._deadman_link import Deadman, UdpDeadman
from needleplan.devices import Address, Closing
from needleplan.devices.robot import read_key
from needleplan.errors import AddressError, DeviceFault, Mistake

__all__ = ["DeadmanThread", "KeyDeadman", "PedalDeadman", "open_deadman"]

# longest time (s) between two repetitions of a key
_REPEAT_S = 0.15
# time (s) between two reports to the guard
_REPORT_S = 0.02
# struct input_event of Linux on 64-bit machines: time (two numbers), type, code, value
_INPUT_EVENT = struct.Struct("qqHHi")
_KEY_EVENT, _RELEASED = 1, 0


class KeyDeadman(Deadman):
    """A key of the terminal on standard input. A terminal does not report releases, so the key must repeat.

    The switch counts as held from the first repetition, which a terminal sends about 0.5 s after the key, until 0.15 s
    after the last one. A tap does not hold it. Raises DeviceFault if standard input is no terminal.
    """

    def __init__(self, descriptor: int | None = None) -> None:
        import termios  # not on every system
        import tty

        self._input = sys.stdin.fileno() if descriptor is None else descriptor
        if not os.isatty(self._input):
            raise DeviceFault("deadman: standard input is not a terminal; a key cannot be held")
        self._before = termios.tcgetattr(self._input)
        self._pressed_s = self._until_s = -math.inf
        tty.setcbreak(self._input)

    def is_held(self, timeout_s: float) -> bool:
        """Wait at most `timeout_s` for a key, and return whether a person holds it."""
        if select.select([self._input], [], [], timeout_s)[0] and os.read(self._input, 1024):
            now_s = time.monotonic()
            if now_s - self._pressed_s <= _REPEAT_S:
                self._until_s = now_s + _REPEAT_S
            self._pressed_s = now_s
        return time.monotonic() < self._until_s

    def close(self) -> None:
        """Restore the settings of the terminal."""
        import termios

        termios.tcsetattr(self._input, termios.TCSADRAIN, self._before)


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
        `key`, `udp://host:port?key_file=path` or `evdev:///dev/input/event5`.
    option : str, default "--deadman"
        Command line option that gave the text, for messages.

    Returns
    -------
    Deadman

    Raises
    ------
    AddressError
        The text is something else, or the file holds no key.
    DeviceFault
        The switch cannot be used.
    """
    if text == "key":
        return KeyDeadman()
    if text.startswith("evdev:///"):
        return PedalDeadman(text.removeprefix("evdev://"))
    if text.startswith("udp://"):
        parsed = Address.parse(text)
        parsed.only(("key_file",))
        if parsed.port is not None and "key_file" in parsed.options:
            return UdpDeadman(parsed.host or "127.0.0.1", parsed.port, read_key(parsed.options["key_file"]))
    rule = "must be key, udp://HOST:PORT?key_file=FILE (an address of this machine), or evdev:///dev/input/eventN"
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
