"""What the sequence numbers of a stream of records tell, without any input or output.

`rdt_sequence` counts the records since the start request: it shows what was lost, came twice or came late.
`ft_sequence` counts the measurements in the box, at 7 kHz: it shows whether the box still measures, and whether it was
restarted in between, which costs it its bias. Both wrap at 2^32.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto

from needleplan.devices.ati.rdt import RdtRecord

__all__ = ["Arrival", "Counts", "Order", "StreamWatch"]

_WRAP = 1 << 32
_MEASUREMENTS_PER_S = 7000
_REMEMBERED = 4096


class Order(Enum):
    """Where a record stands among those before it."""

    NEXT = auto()
    DUPLICATE = auto()
    AFRESH = auto()
    """The first of a new stream: somebody sent a start request."""

    LATE = auto()
    """Counted as lost before; it came after all, too late to be used."""

    IMPLAUSIBLE = auto()
    """Its numbers cannot follow: not a record of this stream."""

    RESTARTED = auto()
    """The box counts its measurements anew: it was switched off, and its bias is lost."""


@dataclass
class Counts:
    """What came over the link since the start, and what did not."""

    received: int = 0
    lost: int = 0
    duplicates: int = 0
    late: int = 0
    malformed: int = 0
    frozen: int = 0


@dataclass(frozen=True)
class Arrival:
    """The verdict on one record: its place, how many are missing before it, and for how many the box stood still."""

    order: Order
    lost: int = 0
    frozen: int = 0


@dataclass
class StreamWatch:
    """Follows the two sequence numbers of one stream."""

    counts: Counts = field(default_factory=Counts)
    _last: RdtRecord | None = None
    _last_ns: int = 0
    _frozen: int = 0
    _missing: dict[int, None] = field(default_factory=dict)

    def see(self, record: RdtRecord, now_ns: int) -> Arrival:
        """Judge the next record, which arrived at `now_ns`."""
        last = self._last
        if last is None:
            return self._accept(record, now_ns, 0)
        # Twice what the box measures in that time, and a second for what waited on the way.
        most = 2 * _MEASUREMENTS_PER_S * (1.0 + max(now_ns - self._last_ns, 0) / 1e9)
        ahead = (record.rdt_sequence - last.rdt_sequence) % _WRAP
        measured = (record.ft_sequence - last.ft_sequence) % _WRAP
        follows, near = 0 < measured <= most, min(measured, _WRAP - measured) <= most
        if 0 < ahead <= most:
            if measured > most:
                return Arrival(Order.RESTARTED)
        elif follows and record.rdt_sequence <= most:
            # Behind in the stream, but measured after the last one: the stream has begun anew, the box has not.
            self._missing.clear()
            return Arrival(Order.AFRESH, self._accept(record, now_ns, 0).lost)
        elif near and (ahead == 0 or ahead >= _WRAP - _REMEMBERED):
            return self._behind(record)
        elif not near and record.rdt_sequence <= most:
            return Arrival(Order.RESTARTED)
        else:
            self.counts.malformed += 1
            return Arrival(Order.IMPLAUSIBLE)
        self._frozen = 0 if measured else self._frozen + 1
        self.counts.frozen += not measured
        return self._accept(record, now_ns, ahead - 1)

    def _behind(self, record: RdtRecord) -> Arrival:
        if record.rdt_sequence in self._missing:
            del self._missing[record.rdt_sequence]
            self.counts.late += 1
            return Arrival(Order.LATE)
        self.counts.duplicates += 1
        return Arrival(Order.DUPLICATE)

    def _accept(self, record: RdtRecord, now_ns: int, lost: int) -> Arrival:
        for back in range(min(lost, _REMEMBERED), 0, -1):
            self._missing[(record.rdt_sequence - back) % _WRAP] = None
        while len(self._missing) > _REMEMBERED:
            del self._missing[next(iter(self._missing))]
        self._last, self._last_ns = record, now_ns
        self.counts.received += 1
        self.counts.lost += lost
        return Arrival(Order.NEXT, lost, self._frozen)
