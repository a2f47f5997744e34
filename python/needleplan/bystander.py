"""A stop of a robot by a bystander, who does not control it: the smallest client of the robot protocol.

`needleplan stop` must work on a machine that is busy with other programs, where each import costs time. So this module
imports nothing of needleplan but `stopping`, and of Python only what a datagram needs. docs/reference/robot-protocol.md
describes the bytes; `needleplan.devices.robot` implements all of the protocol.
"""

from __future__ import annotations

import socket
import struct
import time
import zlib

from needleplan.stopping import Rest, StopProcedure, limits_at_any_speed

TYPE_CHECKING = False  # `typing` takes longer to import than all of this module

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["WITHIN_S", "StopOutcome", "send_stop", "stop", "stop_datagram"]

WITHIN_S = 5.0
"""Longest time (s) until the needle rests, by default."""

# Time (s) after which the stop is sent again, until the needle rests
_AGAIN_S = 0.01

# Time (s) without a measured position after which the caller is told so: as long as a needle may take to come to rest
_SILENCE_S = 0.5

# The oldest supported version, which every robot understands and repeats in its answer and its statuses
_MAGIC, _VERSION, _STOP, _ANSWER, _ACCEPTED = b"NPLR", 2, 0x05, 0x81, 0
_HEAD = struct.Struct("<4sBBHIIQQII")
_COMMAND = struct.Struct("<QddI")
_RESULT = struct.Struct("<QBBH")
_CRC = struct.Struct("<I")
_COMMAND_SIZE = _HEAD.size + _COMMAND.size + _CRC.size
# Bytes of an answer without and with a tag; for each kind of status, its begin (depth, velocity, roll) and its bytes
_ANSWER_SIZES = (56, 72)
_STATUSES = {0x80: (struct.Struct("<ddd"), (88, 104)), 0x82: (struct.Struct("<fff"), (72, 88))}
_SIZES = frozenset({*_ANSWER_SIZES, 72, 88, 104})


class StopOutcome:
    """What became of a stop.

    - `result`: result code of the robot's answer, 0 if the robot has accepted the stop; None without an answer.
    - `took_s`: time from the first STOP to the measured rest, or to the end of the attempts.
    - `sent`: number of STOPs that were sent.
    - `obstacle`: why the last STOP could not be sent, or ""; "Connection refused" means that no program listens there.
    - `rest`: what the measured positions say; `moved_mm`: distance from the first to the last one.
    """

    result: int | None
    took_s: float
    sent: int
    obstacle: str
    rest: Rest
    moved_mm: float

    def __init__(
        self, result: int | None, took_s: float, sent: int, obstacle: str, rest: Rest = Rest.UNKNOWN,
        moved_mm: float = 0.0,
    ) -> None:  # fmt: skip
        self.result, self.took_s, self.sent, self.obstacle = result, took_s, sent, obstacle
        self.rest, self.moved_mm = rest, moved_mm

    @property
    def is_confirmed(self) -> bool:
        """Whether the needle was measured at rest after the robot had accepted the stop."""
        return self.result == _ACCEPTED and self.rest is Rest.RESTS

    def why_not(self, where: str) -> str:
        """Return one line that says why the stop at the address `where` is not confirmed."""
        if self.result not in (None, _ACCEPTED):
            return f"robot: the stop is refused (result {self.result}); use the emergency stop"
        if self.rest is Rest.MOVES or (self.rest is Rest.BRAKES and self.moved_mm):
            return f"the needle still moves: {self.moved_mm:.1f} mm in {self.took_s:.3g} s; use the emergency stop"
        if self.result == _ACCEPTED:
            return (
                f"robot: {where} reports no position, or too rarely; the needle may still move: use the emergency stop"
            )
        hint = f" ({self.obstacle})" if self.obstacle else ""
        return f"robot: {where} has not confirmed the stop within {self.took_s:.3g} s{hint}; use the emergency stop"


def stop_datagram(number: int, sent_ns: int) -> bytes:
    """Return a STOP without a session, which a robot executes for any sender and without a key.

    Parameters
    ----------
    number : int
        Number of the message.
    sent_ns : int
        Time of sending (ns).

    Returns
    -------
    bytes
    """
    head = _HEAD.pack(_MAGIC, _VERSION, _STOP, _COMMAND_SIZE, 0, number, sent_ns, 0, 0, number)
    begin = head + _COMMAND.pack(0, 0.0, 0.0, 0)
    return begin + _CRC.pack(zlib.crc32(begin))


def stop(
    host: str, port: int, within_s: float = WITHIN_S, on_alarm: Callable[[StopOutcome], object] | None = None
) -> StopOutcome:
    """Send STOP every 10 ms until the needle of a robot is at rest, or a time has passed.

    The first STOP is sent at once. A port that is closed, a network that is down and an answer that is lost do not end
    the attempts: the robot's program may start again. The positions that the robot sends to the sender of a STOP show
    whether the needle is at rest; the answer to a STOP does not.

    Parameters
    ----------
    host : str
        Name or address of the host of the robot.
    port : int
        UDP port.
    within_s : float, optional
        Longest time (s).
    on_alarm : callable, optional
        Called with the present outcome once if the needle still moves, and once if its positions are unknown.

    Returns
    -------
    StopOutcome

    Raises
    ------
    OSError
        The host is unknown.
    UnicodeError
        The name of the host is not valid.
    """
    name = host.encode("ascii" if host.isascii() else "idna")  # for a text, Python would import `idna` in any case
    family, kind, _, _, address = socket.getaddrinfo(name, port, type=socket.SOCK_DGRAM)[0]
    with socket.socket(family, kind) as link:
        attempt = _Attempt(link)
        end_ns = attempt.began_ns + round(within_s * 1e9)
        alarms = {Rest.MOVES, Rest.UNKNOWN}
        while True:
            now_ns = time.monotonic_ns()
            attempt.send(address, now_ns, min(now_ns + round(_AGAIN_S * 1e9), end_ns))
            outcome = attempt.outcome(time.monotonic_ns())
            if outcome.is_confirmed or outcome.result not in (None, _ACCEPTED) or time.monotonic_ns() >= end_ns:
                return outcome
            if outcome.rest in alarms:
                alarms.remove(outcome.rest)
                if on_alarm is not None:
                    on_alarm(outcome)


def send_stop(host: str, port: int) -> None:
    """Send one STOP to a robot, and wait for nothing.

    Parameters
    ----------
    host : str
        Name or address of the host of the robot.
    port : int
        UDP port.

    Raises
    ------
    OSError
        The host is unknown, or the network is down.
    UnicodeError
        The name of the host is not valid.
    """
    name = host.encode("ascii" if host.isascii() else "idna")
    family, kind, _, _, address = socket.getaddrinfo(name, port, type=socket.SOCK_DGRAM)[0]
    with socket.socket(family, kind) as link:
        link.sendto(stop_datagram(1, time.monotonic_ns()), address)


class _Attempt:
    """The STOPs that are sent by `link`, and what comes back."""

    def __init__(self, link: socket.socket) -> None:
        self._link, self._is_connected = link, False
        self.began_ns = time.monotonic_ns()
        self._procedure = StopProcedure(limits_at_any_speed(_SILENCE_S), self.began_ns / 1e9)
        self._sent, self._obstacle = 0, ""
        self._result: int | None = None

    def outcome(self, now_ns: int) -> StopOutcome:
        """Return the outcome at a time (ns)."""
        rest, took_s = self._procedure.rest(now_ns / 1e9), (now_ns - self.began_ns) / 1e9
        return StopOutcome(self._result, took_s, self._sent, self._obstacle, rest, self._procedure.moved_mm)

    def send(self, address: tuple[object, ...], now_ns: int, until_ns: int) -> None:
        """Send the next STOP, and take in what arrives until a time (ns)."""
        try:
            if not self._is_connected:
                # The operating system then drops datagrams of other senders, and reports a closed port.
                self._link.connect(address)
                self._is_connected = True
            self._link.send(stop_datagram(self._sent + 1, now_ns))
            self._sent, self._obstacle = self._sent + 1, ""
            self._listen(until_ns)
        except OSError as error:
            self._obstacle = error.strerror or str(error)
            time.sleep(_AGAIN_S)

    def _listen(self, until_ns: int) -> None:
        while True:
            # Reads at least once: on a busy machine the time may have passed while the answer waits in the socket.
            self._link.settimeout(max((until_ns - time.monotonic_ns()) / 1e9, 1e-4))
            try:
                self._take(self._link.recv(2048))
            except (TimeoutError, BlockingIOError):
                return
            if time.monotonic_ns() >= until_ns or self._result not in (None, _ACCEPTED):
                return

    def _take(self, datagram: bytes) -> None:
        """Take in an undamaged answer to, or a status after, one of the STOPs that were sent; drop all others."""
        size = len(datagram)
        if size not in _SIZES or zlib.crc32(datagram[:-4]) != _CRC.unpack(datagram[-4:])[0]:
            return
        magic, version, kind, stated, session, _, sent_ns, echo_ns, _, number = _HEAD.unpack_from(datagram)
        is_ours = session == 0 and echo_ns >= self.began_ns and 0 < number <= self._sent
        if not is_ours or (magic, version, stated) != (_MAGIC, _VERSION, size):
            return
        now_s = time.monotonic_ns() / 1e9
        measured, sizes = _STATUSES.get(kind, (None, ()))
        if measured is not None and size in sizes:
            depth_mm, velocity_mm_s, roll_rad = measured.unpack_from(datagram, _HEAD.size)
            self._procedure.see(now_s, depth_mm, velocity_mm_s, roll_rad, sent_ns / 1e9)
        elif kind == _ANSWER and size in _ANSWER_SIZES:
            _, asked, _, result = _RESULT.unpack_from(datagram, _HEAD.size)
            if asked == _STOP:
                self._result = int(result)
                if result == _ACCEPTED:
                    self._procedure.arrived(now_s)
