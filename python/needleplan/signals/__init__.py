"""Signals: motions, records and filters; nothing here knows a needle or a tissue."""

from needleplan.signals.array import Array
from needleplan.signals.motion import Motion
from needleplan.signals.profiles import insertion_cycles, lspb
from needleplan.signals.record import Record, Role

__all__ = ["Array", "Motion", "Record", "Role", "insertion_cycles", "lspb"]
