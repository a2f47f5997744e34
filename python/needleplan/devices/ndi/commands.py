"""Commands of the NDI combined API, and what its errors mean.

A command is `NAME:arguments`, four hexadecimal digits of CRC over all of that, and a carriage return. `NAME arguments`
with a space in place of the colon has no CRC. A text reply always ends with its CRC and a carriage return.
"""

from __future__ import annotations

from types import MappingProxyType

from needleplan.devices.ndi.crc import crc16
from needleplan.errors import DeviceFault, ProtocolError

__all__ = ["BAUD_CODES", "ERRORS", "Refused", "decode_command", "encode_command", "encode_text"]

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
"""What an `ERRORxx` says, where it is known here."""

BAUD_CODES = MappingProxyType({
    9600: "0", 14_400: "1", 19_200: "2", 38_400: "3", 57_600: "4", 115_200: "5", 921_600: "6", 230_400: "A",
})  # fmt: skip
"""First letter of the argument of `COMM`."""


class Refused(DeviceFault):
    """The device answered a command with `ERRORxx`; `code` is xx."""

    def __init__(self, command: str, code: int) -> None:
        self.command, self.code = command, code
        super().__init__(f"tracker: {command} refused: error {code:02X}, {ERRORS.get(code, 'not known here')}")


def encode_command(name: str, arguments: str = "") -> bytes:
    """Return a command with its CRC."""
    return encode_text(f"{name}:{arguments}")


def encode_text(text: str) -> bytes:
    """Return text with its CRC and carriage return: a command, or a reply."""
    data = text.encode("ascii")
    return data + b"%04X\r" % crc16(data)


def decode_command(line: bytes) -> tuple[str, str]:
    """Return name and arguments of a command without its carriage return. Raises ProtocolError where it is none."""
    try:
        text = line.decode("ascii")
    except UnicodeDecodeError as error:
        raise ProtocolError("a command is ASCII") from error
    colon, space = text.find(":"), text.find(" ")
    if space >= 0 and not 0 <= colon < space:
        return text[:space].upper(), text[space + 1 :]
    if colon < 0 or len(text) < colon + 5:
        raise ProtocolError("a command has a colon and a CRC")
    body, crc = text[:-4], text[-4:]
    if crc.upper() != f"{crc16(body.encode()):04X}":
        raise ProtocolError(f"the CRC of {body} is not {crc}")
    return body[:colon].upper(), body[colon + 1 :]
