"""Entries of the object dictionary (CiA 301, CiA 402), controlword and statusword, and emergency messages."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum, IntEnum, IntFlag, StrEnum

__all__ = [
    "AbortOption",
    "Bit",
    "Cia402Entry",
    "Cia402State",
    "Control",
    "Emergency",
    "Service",
    "decode_emergency",
    "state_of",
]

_EMERGENCY = struct.Struct("<HB5s")


class Cia402Entry(Enum):
    """An entry of the object dictionary: index, subindex, and the `struct` format of its value."""

    ERROR_REGISTER = (0x1001, 0, "<B")
    CONSUMER_HEARTBEAT = (0x1016, 1, "<I")
    PRODUCER_HEARTBEAT = (0x1017, 0, "<H")
    RPDO1_COB = (0x1400, 1, "<I")
    RPDO1_TYPE = (0x1400, 2, "<B")
    RPDO1_COUNT = (0x1600, 0, "<B")
    RPDO1_FIRST = (0x1600, 1, "<I")
    TPDO1_COB = (0x1800, 1, "<I")
    TPDO1_TYPE = (0x1800, 2, "<B")
    TPDO1_COUNT = (0x1A00, 0, "<B")
    TPDO1_FIRST = (0x1A00, 1, "<I")
    TPDO1_SECOND = (0x1A00, 2, "<I")
    TPDO2_COB = (0x1801, 1, "<I")
    TPDO2_TYPE = (0x1801, 2, "<B")
    TPDO2_COUNT = (0x1A01, 0, "<B")
    TPDO2_FIRST = (0x1A01, 1, "<I")
    ABORT_CONNECTION = (0x6007, 0, "<h")
    ERROR_CODE = (0x603F, 0, "<H")
    CONTROLWORD = (0x6040, 0, "<H")
    STATUSWORD = (0x6041, 0, "<H")
    QUICK_STOP = (0x605A, 0, "<h")
    MODE = (0x6060, 0, "<b")
    MODE_SHOWN = (0x6061, 0, "<b")
    POSITION = (0x6064, 0, "<i")
    FOLLOWING_WINDOW = (0x6065, 0, "<I")
    VELOCITY = (0x606C, 0, "<i")
    TARGET_POSITION = (0x607A, 0, "<i")
    LEAST_POSITION = (0x607D, 1, "<i")
    MOST_POSITION = (0x607D, 2, "<i")
    FASTEST = (0x607F, 0, "<I")
    PROFILE_VELOCITY = (0x6081, 0, "<I")
    ACCELERATION = (0x6083, 0, "<I")
    DECELERATION = (0x6084, 0, "<I")
    QUICK_DECELERATION = (0x6085, 0, "<I")

    @property
    def index(self) -> int:
        """Index of the entry, such as 0x6041."""
        return self.value[0]

    @property
    def subindex(self) -> int:
        """Subindex of the entry."""
        return self.value[1]

    @property
    def packing(self) -> struct.Struct:
        """Encoding of the value as bytes."""
        return struct.Struct(self.value[2])

    @property
    def mapping(self) -> int:
        """The entry as encoded in a PDO mapping: index, subindex, and length in bits."""
        return self.index << 16 | self.subindex << 8 | 8 * self.packing.size

    def __str__(self) -> str:
        return f"0x{self.index:04X}:{self.subindex:02X} ({self.name.lower().replace('_', ' ')})"


class Control(IntEnum):
    """Commands: values of the controlword."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE = 0x0F
    NEW_TARGET_NOW = 0x3F
    """ENABLE, with a new target that replaces the present one at once."""

    RESET_FAULT = 0x80


class Bit(IntFlag):
    """Bits of the statusword in profile position mode, without the bits that encode the state."""

    TARGET_REACHED = 1 << 10
    LIMIT = 1 << 11
    ACKNOWLEDGED = 1 << 12
    FOLLOWING_ERROR = 1 << 13


class AbortOption(IntEnum):
    """Values of entry 0x6007: reaction of a drive if the heartbeat of its controller is missing."""

    NOTHING = 0
    FAULT = 1
    DISABLE_VOLTAGE = 2
    QUICK_STOP = 3


class Cia402State(StrEnum):
    """States of a drive, with their names in CiA 402."""

    NOT_READY = "NOT READY TO SWITCH ON"
    SWITCH_ON_DISABLED = "SWITCH ON DISABLED"
    READY = "READY TO SWITCH ON"
    SWITCHED_ON = "SWITCHED ON"
    ENABLED = "OPERATION ENABLED"
    QUICK_STOP = "QUICK STOP ACTIVE"
    FAULT_REACTION = "FAULT REACTION ACTIVE"
    FAULT = "FAULT"


_STATES = (
    (0x4F, 0x00, Cia402State.NOT_READY), (0x4F, 0x40, Cia402State.SWITCH_ON_DISABLED), (0x6F, 0x21, Cia402State.READY),
    (0x6F, 0x23, Cia402State.SWITCHED_ON), (0x6F, 0x27, Cia402State.ENABLED), (0x6F, 0x07, Cia402State.QUICK_STOP),
    (0x4F, 0x0F, Cia402State.FAULT_REACTION), (0x4F, 0x08, Cia402State.FAULT),
)  # fmt: skip


def state_of(statusword: int) -> Cia402State | None:
    """Return the state that a statusword encodes, or None if its bits are not a state of CiA 402."""
    return next((state for mask, bits, state in _STATES if statusword & mask == bits), None)


class Service(IntEnum):
    """Kind of a CAN frame; its identifier is this value plus the node number."""

    EMERGENCY = 0x080
    STATUS = 0x180
    VELOCITY = 0x280
    CONTROL = 0x200
    HEARTBEAT = 0x700


@dataclass(frozen=True)
class Emergency:
    """An emergency message of a drive; code 0 reports that earlier errors are gone."""

    code: int
    register: int
    detail: bytes

    def __str__(self) -> str:
        kind = next((name for first, name in _KINDS if self.code >> 12 == first), "unknown")
        return f"error 0x{self.code:04X} ({kind}), register 0x{self.register:02X}"


_KINDS = (
    (0x1, "generic"), (0x2, "current"), (0x3, "voltage"), (0x4, "temperature"), (0x5, "hardware"), (0x6, "software"),
    (0x7, "additional modules"), (0x8, "monitoring"), (0x9, "external"), (0xF, "manufacturer-specific"),
)  # fmt: skip


def decode_emergency(data: bytes) -> Emergency | None:
    """Return the emergency message in `data`, or None if `data` has a wrong length."""
    return Emergency(*_EMERGENCY.unpack(data)) if len(data) == _EMERGENCY.size else None
