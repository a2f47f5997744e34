"""RDT (raw data transfer), the UDP protocol of the ATI Net F/T box: encoding, status word and sequence numbers.

Source: ATI 9620-05-NET FT, sections 9 and 17.1; ATI 9620-05-C Ethernet Axia. Numbers are big-endian. A request has 8
bytes: 0x1234, the command, the number of samples. A record has 36 bytes: the number of the record in the stream, the
number of the 7 kHz measurement in the box, the status word, and six counts. In buffered mode a datagram contains up to
40 records. The meaning of the status word depends on the product.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum, auto

from needleplan.artifacts import CallRepr
from needleplan.errors import ProtocolError

__all__ = [
    "MOST_RECORDS",
    "RDT_PORT",
    "RdtArrival",
    "RdtCommand",
    "RdtCounts",
    "RdtOrder",
    "RdtRecord",
    "RdtSeverity",
    "StreamWatch",
    "decode_records",
    "decode_request",
    "encode_records",
    "encode_request",
    "read_status",
]

RDT_PORT = 49_152
MOST_RECORDS = 40

_HEADER = 0x1234
_REQUEST = struct.Struct(">HHI")
_RECORD = struct.Struct(">3I6i")


class RdtCommand(IntEnum):
    """Commands to the box. The box does not acknowledge commands; after a start command it sends records."""

    STOP = 0x0000
    START = 0x0002
    """Start a stream with one record in each datagram, at the configured rate."""

    START_BUFFERED = 0x0003
    """Start a stream with several records in each datagram."""

    START_MULTI_UNIT = 0x0004
    RESET_LATCH = 0x0041
    """Clear the latched threshold condition."""

    BIAS = 0x0042
    """Define the present wrench as zero."""


@dataclass(frozen=True, slots=True)
class RdtRecord:
    """One record: sequence numbers, status word, and six counts."""

    rdt_sequence: int
    ft_sequence: int
    status: int
    counts: tuple[int, int, int, int, int, int]


def encode_request(command: RdtCommand, samples: int = 0) -> bytes:
    """Return the bytes of a request with `command`; a start command requests `samples` records, 0 means no limit."""
    return _REQUEST.pack(_HEADER, command, samples)


def decode_request(datagram: bytes) -> tuple[RdtCommand, int]:
    """Return command and number of samples of a request. Raises ProtocolError."""
    if len(datagram) != _REQUEST.size:
        raise ProtocolError(f"an RDT request must have {_REQUEST.size} bytes, not {len(datagram)}")
    header, command, samples = _REQUEST.unpack(datagram)
    if header != _HEADER:
        raise ProtocolError(f"an RDT request must begin with 0x1234, not 0x{header:04X}")
    try:
        return RdtCommand(command), samples
    except ValueError as error:
        raise ProtocolError(f"0x{command:04X} is not an RDT command") from error


def encode_records(records: Iterable[RdtRecord]) -> bytes:
    """Return the bytes of a datagram that contains `records`."""
    return b"".join(
        _RECORD.pack(record.rdt_sequence, record.ft_sequence, record.status, *record.counts) for record in records
    )  # fmt: skip


def decode_records(datagram: bytes) -> list[RdtRecord]:
    """Return the records of a datagram. Raises ProtocolError unless the length fits 1 to 40 records."""
    count, rest = divmod(len(datagram), _RECORD.size)
    if rest or not 0 < count <= MOST_RECORDS:
        raise ProtocolError(
            f"a datagram of {len(datagram)} bytes is not a sequence of RDT records of {_RECORD.size} bytes"
        )
    return [RdtRecord(rdt, ft, status, tuple(counts))
            for rdt, ft, status, *counts in _RECORD.iter_unpack(datagram)]  # fmt: skip


class RdtSeverity(IntEnum):
    """Consequence of a status word for its sample."""

    HEALTHY = 0
    SUSPECT = 1
    """The wrench must not be used for control; the sensor stays usable."""

    FAULT = 2
    """The sensor cannot be used."""


_SUMMARY = 31
_NET_FT = {
    31: "error", 30: "CPU or RAM", 29: "digital board", 28: "analog board", 27: "serial link to the transducer",
    26: "program memory", 25: "halted by its configuration", 24: "settings",
    23: "configuration and calibration disagree", 22: "network", 21: "CAN", 20: "RDT",
    19: "EtherNet/IP", 18: "DeviceNet", 17: "saturated",
    16: "a threshold was exceeded", 14: "watchdog", 13: "stack", 12: "EEPROM", 11: "flash", 10: "analog watchdog",
    9: "gage excitation high", 8: "gage excitation low", 7: "analog ground", 6: "supply high", 5: "supply low",
    4: "no data from the transducer", 3: "reference voltage", 2: "temperature", 1: "HTTP",
}  # fmt: skip
_NET_FT_SUSPECT = {16, 17}
_AXIA = {
    31: "error", 0: "temperature", 1: "supply voltage", 2: "broken gage", 3: "busy", 5: "hardware", 7: "calibration",
    27: "gage out of range",
}  # fmt: skip
_AXIA_SUSPECT = {3, 27}


def read_status(status: int, product: str) -> tuple[RdtSeverity, tuple[str, ...]]:
    """Return the severity of a status word and the names of its set bits; unknown bits are named by number.

    The error bit 31 is named only if no other bit is set. `product` is the product name in the configuration, because
    the bits have other meanings for the Ethernet Axia.
    """
    if not status:
        return RdtSeverity.HEALTHY, ()
    axia = "axia" in product.casefold()
    table, suspect = (_AXIA, _AXIA_SUSPECT) if axia else (_NET_FT, _NET_FT_SUSPECT)
    causes = [bit for bit in range(31) if status >> bit & 1]
    if not causes:
        causes = [_SUMMARY]
    notes = tuple(table.get(bit, f"status bit {bit}") for bit in causes)
    return RdtSeverity.SUSPECT if set(causes) <= suspect else RdtSeverity.FAULT, notes


_WRAP = 1 << 32
_MEASUREMENTS_PER_S = 7000
_DELAYED_S = 3.0  # delay (s) of a record that is not taken for a restart of the box
_REMEMBERED = 4096  # largest number of lost records that are remembered, to recognise them if they arrive late


class RdtOrder(Enum):
    """Position of a record relative to earlier records."""

    NEXT = auto()
    DUPLICATE = auto()
    AFRESH = auto()
    """First record of a new stream, which any client may have requested."""

    LATE = auto()
    """The record was counted as lost, and has arrived after later records."""

    IMPLAUSIBLE = auto()
    """The sequence numbers cannot follow those of the earlier records: the record belongs to another stream."""

    RESTARTED = auto()
    """The number of measurements has restarted: the box was switched off, and its bias is lost."""


@dataclass
class RdtCounts:
    """Numbers of received, lost, repeated, late, malformed and frozen records of a stream."""

    received: int = 0
    lost: int = 0
    duplicates: int = 0
    late: int = 0
    malformed: int = 0
    frozen: int = 0


@dataclass(frozen=True)
class RdtArrival:
    """Result of the validation of a record.

    `order` is the position of the record, `lost` the number of records lost before the record, and `frozen` the number
    of records in succession without a new measurement. `measured` is the number of the measurement in the box, which
    continues to rise when `ft_sequence` wraps.
    """

    order: RdtOrder
    lost: int = 0
    frozen: int = 0
    measured: int = 0


@dataclass
class StreamWatch(CallRepr):
    """Validates the two sequence numbers of the records of one stream; both wrap at 2^32.

    `rdt_sequence` counts the records since the start request, and shows whether records are lost, repeated or late.
    `ft_sequence` counts the 7 kHz measurements of the box, and shows whether the box measures or was restarted.
    """

    counts: RdtCounts = field(default_factory=RdtCounts)
    _last: RdtRecord | None = None
    _last_ns: int = 0
    _frozen: int = 0
    _measured: int = 0
    _missing: dict[int, None] = field(default_factory=dict)

    def see(self, record: RdtRecord, now_ns: int) -> RdtArrival:
        """Validate the next record, received at `now_ns`; update `counts`, and return the result."""
        last = self._last
        if last is None:
            return self._accept(record, now_ns, 0)
        # Largest plausible difference of the numbers: twice the measurements in the time since the last record, plus
        # some seconds for records that were delayed on the way, or while this process was suspended.
        most = 2 * _MEASUREMENTS_PER_S * (_DELAYED_S + max(now_ns - self._last_ns, 0) / 1e9)
        ahead = (record.rdt_sequence - last.rdt_sequence) % _WRAP
        measured = (record.ft_sequence - last.ft_sequence) % _WRAP
        follows, near = 0 < measured <= most, min(measured, _WRAP - measured) <= most
        if 0 < ahead <= most:
            if measured > most:
                return RdtArrival(RdtOrder.RESTARTED)
        elif follows and record.rdt_sequence <= most:
            # A lower number in the stream, but a later measurement: the stream was restarted, not the box.
            self._missing.clear()
            return replace(self._accept(record, now_ns, 0), order=RdtOrder.AFRESH)
        elif near and (ahead == 0 or ahead >= _WRAP - _REMEMBERED):
            return self._behind(record)
        elif not near and record.rdt_sequence <= most:
            return RdtArrival(RdtOrder.RESTARTED)
        else:
            self.counts.malformed += 1
            return RdtArrival(RdtOrder.IMPLAUSIBLE)
        self._frozen = 0 if measured else self._frozen + 1
        self.counts.frozen += not measured
        return self._accept(record, now_ns, ahead - 1)

    def _behind(self, record: RdtRecord) -> RdtArrival:
        if record.rdt_sequence in self._missing:
            del self._missing[record.rdt_sequence]
            self.counts.late += 1
            return RdtArrival(RdtOrder.LATE)
        self.counts.duplicates += 1
        return RdtArrival(RdtOrder.DUPLICATE)

    def _accept(self, record: RdtRecord, now_ns: int, lost: int) -> RdtArrival:
        for back in range(min(lost, _REMEMBERED), 0, -1):
            self._missing[(record.rdt_sequence - back) % _WRAP] = None
        while len(self._missing) > _REMEMBERED:
            del self._missing[next(iter(self._missing))]
        before = 0 if self._last is None else self._last.ft_sequence
        self._measured += (record.ft_sequence - before) % _WRAP
        self._last, self._last_ns = record, now_ns
        self.counts.received += 1
        self.counts.lost += lost
        return RdtArrival(RdtOrder.NEXT, lost, self._frozen, self._measured)
