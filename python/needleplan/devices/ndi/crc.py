"""CRC-16/ARC, with which NDI devices end commands and replies.

Polynomial x^16 + x^15 + x^2 + 1, reflected (0xA001), begins at 0, nothing is inverted.
"""

from __future__ import annotations

__all__ = ["crc16"]


def _entry(value: int) -> int:
    for _ in range(8):
        value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value


_TABLE = tuple(map(_entry, range(256)))


def crc16(data: bytes) -> int:
    """Return the CRC of `data`."""
    crc = 0
    for byte in data:
        crc = crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc
