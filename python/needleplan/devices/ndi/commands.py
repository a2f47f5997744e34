"""NDI combined API: encoding of commands, extraction of replies from a stream of bytes, and exchange with the device.

A command is the text `NAME:arguments`, the CRC of this text (four hexadecimal digits), and a carriage return. A command
with a space instead of the colon has no CRC. A text reply always ends with its CRC and a carriage return.
"""

from __future__ import annotations

from types import MappingProxyType

from needleplan.devices._clock import Clock, Deadline
from needleplan.devices._links import Link
from needleplan.devices.ndi.frames import HEADER_BYTES, START, body_length, crc16
from needleplan.errors import DeviceFault, ProtocolError

__all__ = [
    "BAUD_CODES",
    "ERRORS",
    "NdiConversation",
    "NdiRefused",
    "ReplyReader",
    "decode_command",
    "encode_command",
    "encode_text",
]

ERRORS = MappingProxyType({
    0x01: "invalid command", 0x02: "command too long", 0x03: "command too short", 0x04: "wrong CRC of the command",
    0x05: "timeout", 0x06: "communication parameters cannot be set", 0x07: "wrong number of parameters",
    0x08: "invalid handle", 0x0C: "not possible in this mode", 0x0D: "no tool in the port",
    0x0E: "tool not initialised", 0x0F: "tool not enabled", 0x10: "system not initialised",
    0x11: "tracking could not be stopped", 0x12: "tracking could not be started", 0x19: "no firmware version",
    0x23: "parameter out of range", 0x28: "too many tools", 0x2B: "handle not allocated", 0x2C: "port unoccupied",
    0x2D: "no handle left", 0x32: "invalid operation", 0x33: "not available", 0xF1: "too much infrared light",
    0xF4: "flash memory", 0xF5: "flash memory", 0xF6: "flash memory",
})  # fmt: skip
"""Meaning of the codes xx in `ERRORxx`."""

BAUD_CODES = MappingProxyType({
    9600: "0", 14_400: "1", 19_200: "2", 38_400: "3", 57_600: "4", 115_200: "5", 921_600: "6", 230_400: "A",
})  # fmt: skip
"""First character of the argument of `COMM` for each speed (baud)."""


class NdiRefused(DeviceFault):
    """The device answered a command with `ERRORxx`; `code` is xx."""

    command: str
    code: int

    def __init__(self, command: str, code: int) -> None:
        self.command, self.code = command, code
        super().__init__(f"tracker: {command} refused: error {code:02X}, {ERRORS.get(code, 'unknown')}")


def encode_command(name: str, arguments: str = "") -> bytes:
    """Return the bytes of a command, with CRC and carriage return."""
    return encode_text(f"{name}:{arguments}")


def encode_text(text: str) -> bytes:
    """Return the bytes of `text`, a command or reply, followed by its CRC and a carriage return."""
    data = text.encode("ascii")
    return data + b"%04X\r" % crc16(data)


def decode_command(line: bytes) -> tuple[str, str]:
    """Return name and arguments of a command; `line` has no carriage return. Raises ProtocolError."""
    try:
        text = line.decode("ascii")
    except UnicodeDecodeError as error:
        raise ProtocolError("a command must be ASCII text") from error
    colon, space = text.find(":"), text.find(" ")
    if space >= 0 and not 0 <= colon < space:
        return text[:space].upper(), text[space + 1 :]
    if colon < 0 or len(text) < colon + 5:
        raise ProtocolError("a command must have a colon and a CRC")
    body, crc = text[:-4], text[-4:]
    if crc.upper() != f"{crc16(body.encode()):04X}":
        raise ProtocolError(f"the CRC of {body} is not {crc}")
    return body[:colon].upper(), body[colon + 1 :]


_LONGEST_TEXT = 16_384  # characters without a carriage return after which they are discarded as damaged
_TEXT = frozenset(range(0x20, 0x7F)) | {0x0A}  # bytes that a text reply may contain


class ReplyReader:
    """Extracts replies from a stream of bytes: a text reply as `str` without CRC, a binary reply as complete `bytes`.

    Only replies with a correct CRC are returned; other bytes are discarded and counted in `damaged`. A correct reply
    that follows damaged bytes is found.
    """

    def __init__(self) -> None:
        self.damaged: int = 0

        self._buffer = bytearray()

    @property
    def pending(self) -> int:
        """Number of received bytes that are not yet extracted."""
        return len(self._buffer)

    def feed(self, data: bytes) -> None:
        """Append received bytes to the stream."""
        self._buffer += data

    def clear(self) -> None:
        """Discard the received bytes that are not yet extracted, and count them as damaged."""
        self._drop(len(self._buffer))

    def next(self) -> str | bytes | None:
        """Return the next complete reply, or None if more bytes must be received first."""
        reply: str | bytes | None
        while self._buffer:
            if self._buffer[0] == START[0]:
                reply, more = self._binary()
            else:
                reply, more = self._text()
            if reply is not None or more:
                return reply
        return None

    def _drop(self, count: int) -> None:
        self.damaged += count
        del self._buffer[:count]

    def _binary(self) -> tuple[bytes | None, bool]:
        """Return (reply, False); (None, True) if the reply is incomplete.

        If the bytes are not a valid reply, drop the first byte and return (None, False).
        """
        buffer = self._buffer
        if len(buffer) < HEADER_BYTES:
            if buffer[1:2] in (b"", START[1:]):
                return None, True
            self._drop(1)
            return None, False
        try:
            end = HEADER_BYTES + body_length(bytes(buffer[:HEADER_BYTES])) + 2
        except ProtocolError:
            self._drop(1)
            return None, False
        if len(buffer) < end:
            return None, True
        message = bytes(buffer[:end])
        if crc16(message[:-2]) != int.from_bytes(message[-2:], "little"):
            self._drop(1)
            return None, False
        del buffer[:end]
        return message, False

    def _text(self) -> tuple[str | None, bool]:
        line = bytes(self._buffer)
        length = len(line) - len(line.lstrip(bytes(_TEXT)))
        if length == len(line):
            if length > _LONGEST_TEXT:
                self._drop(length)
            return None, length <= _LONGEST_TEXT
        if line[length] != 0x0D:
            self._drop(max(length, 1))
            return None, False
        text, crc = line[: max(length - 4, 0)], line[max(length - 4, 0) : length]
        if not text or crc.upper() != b"%04X" % crc16(text):
            self._drop(length + 1)
            return None, False
        del self._buffer[: length + 1]
        return text.decode("ascii"), False


class NdiConversation:
    """Exchanges commands and replies with an NDI device; `reply_s` is the longest time (s) to wait for a reply."""

    link: Link
    clock: Clock
    reply_s: float

    def __init__(self, link: Link, clock: Clock, reply_s: float = 12.0) -> None:
        self.link, self.clock, self.reply_s = link, clock, reply_s
        self.reader: ReplyReader = ReplyReader()

    def send(self, name: str, arguments: str = "") -> None:
        """Send a command without waiting for its reply."""
        self.link.send(encode_command(name, arguments))

    def receive(self, timeout_s: float) -> str | bytes | None:
        """Return the next complete reply; None after `timeout_s`, or as soon as damaged bytes are discarded."""
        deadline = Deadline(self.clock, timeout_s)
        damaged = self.reader.damaged
        while True:
            reply = self.reader.next()
            if reply is not None or self.reader.damaged > damaged:
                return reply
            data = self.link.receive(deadline.left_s)
            self.reader.feed(data)
            if not data and deadline.passed:
                return None

    def ask(self, name: str, arguments: str = "", timeout_s: float | None = None) -> str:
        """Send a command and return the text of its reply.

        Replies that have already arrived belong to earlier commands and are discarded. Raises NdiRefused if the reply
        is `ERRORxx`, DeviceFault if no text reply arrives within `timeout_s` (None: `reply_s`).
        """
        self.discard()
        self.send(name, arguments)
        deadline = Deadline(self.clock, self.reply_s if timeout_s is None else timeout_s)
        while not deadline.passed:
            reply = self.receive(deadline.left_s)
            if isinstance(reply, str):
                self.refuse(f"{name}:{arguments}", reply)
                return reply
        waited_s = self.reply_s if timeout_s is None else timeout_s
        damage = f"; {self.reader.damaged} damaged bytes" if self.reader.damaged else ""
        raise DeviceFault(f"tracker: no answer to {name}:{arguments} within {waited_s:g} s{damage}")

    def discard(self) -> list[str | bytes]:
        """Discard all received bytes, and return the complete replies among them."""
        while data := self.link.receive(0):
            self.reader.feed(data)
        replies = []
        while (reply := self.reader.next()) is not None:
            replies.append(reply)
        self.reader.clear()
        return replies

    @staticmethod
    def refuse(command: str, reply: str) -> None:
        """Raise NdiRefused, with `command` in its message, if `reply` is `ERRORxx`; code 0 if xx is unreadable."""
        if reply.startswith("ERROR"):
            try:
                code = int(reply[5:7], 16)
            except ValueError:
                code = 0
            raise NdiRefused(command, code)
