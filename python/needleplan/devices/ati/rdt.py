"""The bytes of RDT, the raw data transfer of the ATI Net F/T box over UDP.

Source: ATI 9620-05-NET FT, section 9. Everything is big-endian. A request has 8 bytes: 0x1234, the command, the number
of samples. A record has 36: the sequence number of the stream, that of the box's own 7 kHz measurement, the status word
and six counts. In buffered mode a datagram carries up to 40 records.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

from needleplan.errors import ProtocolError

__all__ = ["MOST_RECORDS", "RDT_PORT", "Command", "RdtRecord", "decode_records", "decode_request", "encode_records",
           "encode_request"]  # fmt: skip

RDT_PORT = 49_152
MOST_RECORDS = 40

_HEADER = 0x1234
_REQUEST = struct.Struct(">HHI")
_RECORD = struct.Struct(">3I6i")


class Command(IntEnum):
    """What the box is asked to do. Only the three that start a stream are answered, by records."""

    STOP = 0x0000
    START = 0x0002
    """One record in a datagram, at the rate of the configuration."""

    START_BUFFERED = 0x0003
    START_MULTI_UNIT = 0x0004
    RESET_LATCH = 0x0041
    """Forget the latched threshold condition."""

    BIAS = 0x0042
    """Take the present wrench as zero."""


@dataclass(frozen=True, slots=True)
class RdtRecord:
    """One record: counts, not yet forces."""

    rdt_sequence: int
    ft_sequence: int
    status: int
    counts: tuple[int, int, int, int, int, int]


def encode_request(command: Command, samples: int = 0) -> bytes:
    """Return a request; `samples` is how many records to send, 0 without end."""
    return _REQUEST.pack(_HEADER, command, samples)


def decode_request(datagram: bytes) -> tuple[Command, int]:
    """Return command and number of samples of a request. Raises ProtocolError."""
    if len(datagram) != _REQUEST.size:
        raise ProtocolError(f"an RDT request has {_REQUEST.size} bytes, this one {len(datagram)}")
    header, command, samples = _REQUEST.unpack(datagram)
    if header != _HEADER:
        raise ProtocolError(f"an RDT request begins with 0x1234, this one with 0x{header:04X}")
    try:
        return Command(command), samples
    except ValueError as error:
        raise ProtocolError(f"0x{command:04X} is not an RDT command") from error


def encode_records(records: Iterable[RdtRecord]) -> bytes:
    """Return the datagram that carries `records`."""
    return b"".join(
        _RECORD.pack(each.rdt_sequence, each.ft_sequence, each.status, *each.counts) for each in records
    )  # fmt: skip


def decode_records(datagram: bytes) -> list[RdtRecord]:
    """Return the records of a datagram, one to 40. Raises ProtocolError where its length is not that of records."""
    count, rest = divmod(len(datagram), _RECORD.size)
    if rest or not 0 < count <= MOST_RECORDS:
        raise ProtocolError(f"a datagram of {len(datagram)} bytes is not made of RDT records of {_RECORD.size}")
    return [RdtRecord(rdt, ft, status, tuple(counts))
            for rdt, ft, status, *counts in _RECORD.iter_unpack(datagram)]  # fmt: skip
