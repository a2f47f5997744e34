"""A stop of a robot by a bystander, who does not control it: the smallest client of the robot protocol.

`needleplan stop` must work on a machine that is busy with other programs, where each import costs time. So this module
imports nothing of needleplan, and of Python only what a datagram needs. docs/reference/robot-protocol.md describes the
bytes; `needleplan.devices.robot` implements all of the protocol.
"""

from __future__ import annotations

import socket
import struct
import time
import zlib

TYPE_CHECKING = False  # `typing` takes longer to import than all of this module

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["AGAIN_S", "WITHIN_S", "StopOutcome", "stop", "stop_datagram"]

WITHIN_S = 5.0
"""Longest time (s) until the answer to a stop, by default."""

AGAIN_S = 0.01
"""Time (s) without an answer after which the stop is sent again."""

_SILENCE_S = 1.0  # time (s) without an answer after which the caller is told so

_MAGIC, _VERSION, _STOP, _ANSWER, _ACCEPTED = b"NPLR", 2, 0x05, 0x81, 0
_HEAD = struct.Struct("<4sBBHIIQQII")
_COMMAND = struct.Struct("<QddI")
_RESULT = struct.Struct("<QBBH")
_CRC = struct.Struct("<I")
_COMMAND_SIZE = _HEAD.size + _COMMAND.size + _CRC.size
_ANSWER_SIZES = (56, 72)  # bytes of an answer without and with a tag


class StopOutcome:
    """What became of a stop.

    - `result`: result code of the robot's answer, 0 if the robot has stopped; None without an answer.
    - `took_s`: time from the first STOP to the answer, or to the end of the attempts.
    - `sent`: number of STOPs that were sent.
    - `obstacle`: why the last STOP could not be sent, or ""; "Connection refused" means that no program listens there.
    """

    def __init__(self, result: int | None, took_s: float, sent: int, obstacle: str) -> None:
        self.result, self.took_s, self.sent, self.obstacle = result, took_s, sent, obstacle

    @property
    def is_confirmed(self) -> bool:
        """Whether the robot has confirmed the stop."""
        return self.result == _ACCEPTED

    def why_not(self, where: str) -> str:
        """Return one line that says why the stop at the address `where` is not confirmed."""
        if self.result is not None:
            return f"robot: the stop is refused (result {self.result}); use the emergency stop"
        hint = f" ({self.obstacle})" if self.obstacle else ""
        return f"robot: {where} has not confirmed the stop within {self.took_s:.3g} s{hint}; use the emergency stop"


def stop_datagram(number: int, sent_ns: int) -> bytes:
    """Return a STOP without a session, which a robot executes for any sender and without a key."""
    head = _HEAD.pack(_MAGIC, _VERSION, _STOP, _COMMAND_SIZE, 0, number, sent_ns, 0, 0, number)
    begin = head + _COMMAND.pack(0, 0.0, 0.0, 0)
    return begin + _CRC.pack(zlib.crc32(begin))


def stop(
    host: str, port: int, within_s: float = WITHIN_S, on_silence: Callable[[], object] | None = None
) -> StopOutcome:
    """Send STOP every 10 ms until the robot at `host` and `port` answers, or until `within_s` has passed.

    The first STOP is sent at once. A port that is closed, a network that is down and an answer that is lost do not end
    the attempts: the robot's program may start again. `on_silence`, a function without arguments, is called once after
    1 s without an answer. Raises OSError or UnicodeError if the host is unknown.
    """
    name = host.encode("ascii" if host.isascii() else "idna")  # for a text, Python would import `idna` in any case
    family, kind, _, _, address = socket.getaddrinfo(name, port, type=socket.SOCK_DGRAM)[0]
    with socket.socket(family, kind) as link:
        began_ns = time.monotonic_ns()
        end_ns = began_ns + round(within_s * 1e9)
        sent, obstacle, is_connected = 0, "", False
        while True:
            now_ns = time.monotonic_ns()
            try:
                if not is_connected:
                    # The operating system then drops datagrams of other senders, and reports a closed port.
                    link.connect(address)
                    is_connected = True
                link.send(stop_datagram(sent + 1, now_ns))
                sent, obstacle = sent + 1, ""
                result = _answer(link, began_ns, sent, min(now_ns + round(AGAIN_S * 1e9), end_ns))
            except OSError as error:
                result, obstacle = None, error.strerror or str(error)
                time.sleep(AGAIN_S)
            now_ns = time.monotonic_ns()
            if result is not None or now_ns >= end_ns:
                return StopOutcome(result, (now_ns - began_ns) / 1e9, sent, obstacle)
            if on_silence is not None and now_ns - began_ns > _SILENCE_S * 1e9:
                on_silence()
                on_silence = None


def _answer(link: socket.socket, began_ns: int, sent: int, until_ns: int) -> int | None:
    """Return the result of the first answer to one of the `sent` STOPs; None after `until_ns`. Raises OSError."""
    while True:
        # Reads at least once: on a busy machine the time may have passed while the answer waits in the socket.
        link.settimeout(max((until_ns - time.monotonic_ns()) / 1e9, 1e-4))
        try:
            result = _result(link.recv(2048), began_ns, sent)
        except (TimeoutError, BlockingIOError):
            return None
        if result is not None:
            return result


def _result(datagram: bytes, began_ns: int, sent: int) -> int | None:
    """Return the result in an undamaged answer to one of the STOPs 1 to `sent`; None for any other datagram."""
    if len(datagram) not in _ANSWER_SIZES or zlib.crc32(datagram[:-4]) != _CRC.unpack(datagram[-4:])[0]:
        return None
    magic, version, kind, size, session, _, _, echo_ns, _, number = _HEAD.unpack_from(datagram)
    _, asked, _, result = _RESULT.unpack_from(datagram, _HEAD.size)
    is_ours = session == 0 and echo_ns >= began_ns and 0 < number <= sent
    expected = (_MAGIC, _VERSION, _ANSWER, len(datagram), _STOP)
    return int(result) if is_ours and (magic, version, kind, size, asked) == expected else None
