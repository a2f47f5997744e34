"""The status word of a record, which means different things in different products.

Sources: ATI 9620-05-NET FT, section 17.1; ATI 9620-05-C Ethernet Axia. The Axia sends the same record with another
table, so the product's own name decides which is used.
"""

from __future__ import annotations

from enum import IntEnum

__all__ = ["Severity", "read_status"]


class Severity(IntEnum):
    """What a status word means for the sample that it came with."""

    HEALTHY = 0
    SUSPECT = 1
    """The wrench is not to be used for control; the sensor itself goes on."""

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


def read_status(status: int, product: str) -> tuple[Severity, tuple[str, ...]]:
    """Return how bad a status word is, and what it says; bits that are in no table are named by number.

    `product` is `prodname` of the configuration.
    """
    if not status:
        return Severity.HEALTHY, ()
    axia = "axia" in product.casefold()
    table, suspect = (_AXIA, _AXIA_SUSPECT) if axia else (_NET_FT, _NET_FT_SUSPECT)
    causes = [bit for bit in range(31) if status >> bit & 1]
    if not causes:
        causes = [_SUMMARY]
    notes = tuple(table.get(bit, f"status bit {bit}") for bit in causes)
    return Severity.SUSPECT if set(causes) <= suspect else Severity.FAULT, notes
