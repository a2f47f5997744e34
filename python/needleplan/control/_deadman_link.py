"""A deadman switch over UDP: heartbeats with session, sequence and a tag, so that nobody else lets the needle move.

A datagram has 40 bytes, little-endian: `NPLD`, u8 version 1, u8 held (0 or 1), u16 0, u64 session, u32 sequence, u32 0,
and the first 16 bytes of HMAC-SHA256(key, nonce as 8 bytes little-endian, the 24 bytes before). The receiver draws the
nonce at random when it opens, and sends it, after `NPLD`, u8 version 1 and 3 bytes 0, to the sender of every datagram
whose tag is wrong. So a recorded heartbeat is worth nothing to another run; within a run, the sequence numbers of each
session increase.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
import select
import socket
import struct
import time
from abc import abstractmethod
from itertools import count

from needleplan.devices import Address, Closing
from needleplan.devices.robot import read_key
from needleplan.errors import AddressError, DeviceFault, Mistake

__all__ = ["Deadman", "DeadmanSender", "UdpDeadman"]

# longest time (s) between two heartbeats
_HEARTBEAT_S = 0.2
_MAGIC, _VERSION = b"NPLD", 1
_BEGIN = struct.Struct("<4sBBHQII")  # magic, version, held, 0, session, sequence, 0
_NONCE = struct.Struct("<4sB3xQ")  # magic, version, nonce
_TAG = 16  # bytes of the tag
# largest number of datagrams that are read at once, so that a flood cannot keep a release from being reported
_MOST = 2000
# number of datagrams that wait at once above which newer ones may be lost: a receive buffer of Linux holds about 250
_FULL = 200


class Deadman(Closing):
    """Abstract deadman switch."""

    @abstractmethod
    def is_held(self, timeout_s: float) -> bool:
        """Wait at most `timeout_s` for a signal, and return whether a person holds the switch now."""


def _tagged(begin: bytes, key: bytes, nonce: int) -> bytes:
    tag = hmac.digest(key, nonce.to_bytes(8, "little") + begin, hashlib.sha256)[:_TAG]
    return begin + tag


class UdpDeadman(Deadman):
    """Heartbeats in UDP datagrams with the shared `key`; `DeadmanSender` sends them.

    The switch is armed by a heartbeat that says released. A heartbeat that says held then holds it, until one of the
    same session says released, or none has arrived for 0.2 s; after such a silence the switch must be armed again.
    While the switch is held, other sessions do not count. Of the datagrams that wait, the newest decides; so many that
    the newest may be lost count as silence. Raises DeviceFault if the port cannot be used.
    """

    def __init__(self, host: str, port: int, key: bytes) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._key, self._nonce = key, secrets.randbits(64)
        self._session: int | None = None
        self._sequences: dict[int, int] = {}
        """The highest sequence number of each session so far."""

        self._is_armed = False
        self._until_s: float | None = None
        """Time (s) until which the switch is held; None if it is released."""

        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise DeviceFault(f"deadman: UDP port {port} of {host} cannot be used: {error.strerror}") from error
        self._socket.setblocking(False)

    @property
    def port(self) -> int:
        """The port at which heartbeats are received."""
        return int(self._socket.getsockname()[1])

    def is_held(self, timeout_s: float) -> bool:
        """Wait at most `timeout_s` for heartbeats, read all that wait, and return whether a person holds the switch."""
        select.select([self._socket], [], [], max(timeout_s, 0.0))
        taken = 0
        for _ in range(_MOST):
            try:
                data, sender = self._socket.recvfrom(64)
            except BlockingIOError:
                break
            except OSError:  # a port to which a nonce was sent is closed
                continue
            self._take(data, sender)
            taken += 1
        if taken >= _FULL:  # the newest may say that the switch is released, and be lost
            self._is_armed, self._until_s = False, None
        self._note_silence(time.monotonic())
        return self._until_s is not None

    def _take(self, data: bytes, sender: tuple[str, int]) -> None:
        begin = data[: _BEGIN.size]
        if len(data) != _BEGIN.size + _TAG or not data.startswith(_MAGIC):
            return
        if not hmac.compare_digest(_tagged(begin, self._key, self._nonce), data):
            try:
                self._socket.sendto(_NONCE.pack(_MAGIC, _VERSION, self._nonce), sender)
            except OSError:  # the sender asks again
                return
            return
        _, version, held, _, session, sequence, _ = _BEGIN.unpack(begin)
        now_s = time.monotonic()
        self._note_silence(now_s)
        if version != _VERSION or held not in (0, 1):
            return
        if session != self._session:
            if self._until_s is not None:
                return
            self._session, self._is_armed = session, False
        if sequence <= self._sequences.get(session, -1):
            return
        self._sequences[session] = sequence
        if not held:
            self._is_armed, self._until_s = True, None
        elif self._is_armed:
            self._until_s = now_s + _HEARTBEAT_S

    def _note_silence(self, now_s: float) -> None:
        if self._until_s is not None and now_s >= self._until_s:
            self._is_armed, self._until_s = False, None

    def close(self) -> None:
        """Close the port."""
        self._socket.close()


class DeadmanSender(Closing):
    """The other end of `UdpDeadman`: sends heartbeats of a switch to a run of needleplan.

    Call `send` at least every 0.1 s, also while the switch is released: a released switch arms the run, and only then
    does a held one let the needle move.

    Parameters
    ----------
    address : str
        `udp://host:port?key_file=path`, as in the option `--deadman` of the run.

    Raises
    ------
    AddressError
        The address is something else, or the file holds no key.

    Examples
    --------
    >>> import os, secrets, tempfile
    >>> from needleplan.control import DeadmanSender
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with open(os.path.join(folder, "deadman.key"), "w") as file:
    ...         _ = file.write(secrets.token_hex(32))
    ...     with DeadmanSender(f"udp://127.0.0.1:5010?key_file={file.name}") as switch:
    ...         switch.send(held=False)
    """

    def __init__(self, address: str) -> None:
        parsed = Address.parse(address)
        parsed.only(("key_file",))
        if parsed.scheme != "udp" or parsed.port is None or "key_file" not in parsed.options:
            raise AddressError(Mistake("address", address, "must be udp://HOST:PORT?key_file=FILE"))
        self._key = read_key(parsed.options["key_file"])
        self._peer = (parsed.host or "127.0.0.1", parsed.port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._nonce, self._session, self._sequences = 0, secrets.randbits(64), count()

    def send(self, *, held: bool) -> None:
        """Send one heartbeat; a run that is not there, or not yet, is no error.

        Parameters
        ----------
        held : bool
            Whether a person holds the switch now.
        """
        try:
            while data := self._socket.recv(64):
                if len(data) == _NONCE.size and data.startswith(_MAGIC):
                    self._nonce = _NONCE.unpack(data)[2]
        except OSError:  # nothing waits, or the port of the run was closed
            pass
        begin = _BEGIN.pack(_MAGIC, _VERSION, held, 0, self._session, next(self._sequences), 0)
        try:
            self._socket.sendto(_tagged(begin, self._key, self._nonce), self._peer)
        except OSError:  # a heartbeat that is not sent counts as silence
            return

    def close(self) -> None:
        """Close the socket; the run takes the silence for a release."""
        self._socket.close()
