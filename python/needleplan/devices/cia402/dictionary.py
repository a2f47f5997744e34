"""The object dictionary of a simulated drive."""

from __future__ import annotations

from typing import Any

from needleplan.devices.cia402.bus import library
from needleplan.devices.cia402.objects import Entry

__all__ = ["object_dictionary"]

_TYPES = {"<B": 0x05, "<H": 0x06, "<I": 0x07, "<b": 0x02, "<h": 0x03, "<i": 0x04}


def object_dictionary() -> Any:
    """Return one of `canopen` with every entry, all readable and writable."""
    parts = library("canopen.objectdictionary")
    dictionary = library().ObjectDictionary()
    records: dict[int, Any] = {}
    for entry in Entry:
        variable = parts.ODVariable(entry.name, entry.index, entry.subindex)
        variable.data_type, variable.access_type, variable.default = _TYPES[entry.value[2]], "rw", 0
        if entry.subindex == 0 and not any(other.index == entry.index and other.subindex for other in Entry):
            dictionary.add_object(variable)
            continue
        if entry.index not in records:
            records[entry.index] = parts.ODRecord(f"record {entry.index:04X}", entry.index)
            dictionary.add_object(records[entry.index])
        records[entry.index].add_member(variable)
    return dictionary
