"""CRC-64 of ECMA-182, as OpenIGTLink uses it: highest bit first, nothing before and nothing after."""

from __future__ import annotations

from functools import cache, reduce
from operator import xor

import numpy as np
import numpy.typing as npt

__all__ = ["crc64"]

_POLYNOMIAL = 0x42F0E1EBA9EA3693
_MASK = (1 << 64) - 1
_BLOCK = 256


def crc64(data: bytes) -> int:
    """Return the checksum of `data`."""
    if len(data) < _BLOCK:
        register = 0
        for byte in data:
            register = (register << 8) & _MASK ^ _TABLE[register >> 56 ^ byte]
        return register
    # The checksum is linear, so what each byte adds depends on its place alone. Zeros in front add nothing.
    places, heads = _places()
    blocks = np.frombuffer(bytes(-len(data) % _BLOCK) + data, dtype=np.uint8).reshape(-1, _BLOCK)
    register = 0
    for part in np.bitwise_xor.reduce(places[np.arange(_BLOCK), blocks], axis=1).tolist():
        register = reduce(xor, (head[byte] for head, byte in zip(heads, register.to_bytes(8), strict=True)), part)
    return register


def _of_byte(byte: int) -> int:
    register = byte << 56
    for _ in range(8):
        register = (register << 1) & _MASK ^ (_POLYNOMIAL if register >> 63 else 0)
    return register


_TABLE = [_of_byte(byte) for byte in range(256)]


@cache
def _places() -> tuple[npt.NDArray[np.uint64], list[list[int]]]:
    """Return what a byte adds at each place of a block, and the same of the first eight places as plain numbers."""
    rows = [_TABLE]
    while len(rows) < _BLOCK:
        rows.append([(each << 8) & _MASK ^ _TABLE[each >> 56] for each in rows[-1]])
    rows.reverse()
    return np.array(rows, dtype=np.uint64), rows[:8]
