"""The interfaces of stage, force sensor and tracker, and their samples.

A device is opened by its address (`udp://192.168.1.10:5005`), used as a context manager, and read with a deadline. Each
sample has a time and a sequence number, and is returned once. A problem that the device reports lowers the health of
the sample. A device that cannot be used any more raises DeviceFault with the cause.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from enum import StrEnum
from types import TracebackType
from typing import Self

__all__ = [
    "Closing",
    "Device",
    "ForceSample",
    "ForceSensor",
    "Health",
    "PoseSample",
    "Stage",
    "StageSample",
    "Stamp",
    "Tracker",
]


class Closing(ABC):
    """Anything that is given up by leaving its `with` block; abstract."""

    @abstractmethod
    def close(self) -> None:
        """Give it up; closing twice is harmless."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Health(StrEnum):
    """Whether a sample may be used."""

    GOOD = "good"
    SUSPECT = "suspect"
    """The device says so itself: saturated, partly out of its volume, a bad fit. Not for control."""

    MISSING = "missing"
    """The device answered, but has nothing to say: the coil is not seen."""


@dataclass(frozen=True)
class Stamp:
    """When a sample arrived, which it is, and what is missing before it.

    `received_ns` is on the monotonic clock of this machine, `sequence` the device's own number, `lost` how many were
    lost just before it.
    """

    received_ns: int
    sequence: int
    lost: int = 0
    device_time_s: float | None = None
    """Time on the device's own clock, where it has one."""


@dataclass(frozen=True)
class ForceSample:
    """A wrench at the base of the needle: N and N mm, in the frame of the sensor."""

    stamp: Stamp
    force_n: tuple[float, float, float]
    torque_n_mm: tuple[float, float, float]
    health: Health = Health.GOOD
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class PoseSample:
    """A pose of a tracked coil: position in mm, and a unit quaternion (w, x, y, z).

    A coil with five degrees of freedom does not know its roll. Position and quaternion are NaN where it is MISSING.
    """

    stamp: Stamp
    position_mm: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    error_mm: float
    health: Health = Health.GOOD
    notes: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class StageSample:
    """Where the stage is: insertion depth (mm, positive into the tissue), velocity, roll of the needle's base."""

    stamp: Stamp
    depth_mm: float
    velocity_mm_s: float
    roll_rad: float
    moving: bool
    health: Health = Health.GOOD
    notes: tuple[str, ...] = field(default=())


class Device(Closing):
    """Anything that is opened, used and closed; abstract."""

    @abstractmethod
    def close(self) -> None:
        """Give the device up; a stage stops first. Closing twice is harmless."""


class Stage(Device):
    """Moves the needle along its axis and about it; abstract. One controller at a time."""

    @abstractmethod
    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin to move to a depth at a speed (positive, mm/s), in or out. Raises DeviceFault."""

    @abstractmethod
    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin to turn the base of the needle to a roll angle. Raises DeviceFault."""

    @abstractmethod
    def stop(self) -> None:
        """Stop both axes now; always allowed, also in a fault."""

    def heartbeat(self) -> None:
        """Tell the stage that its commander is running; a stage with a watchdog stops if this is not called in time.

        Only the guard of an insertion calls it (`control.safety.GuardedStage.tick`); a program without a guard calls
        it in the loop that decides. A stage without a watchdog does nothing. Raises DeviceFault.
        """

    @abstractmethod
    def read(self, timeout_s: float) -> StageSample | None:
        """Return the next sample, or None after `timeout_s`. Raises DeviceFault."""


class ForceSensor(Device):
    """Measures the wrench at the base of the needle; abstract."""

    @abstractmethod
    def bias(self) -> None:
        """Take the present wrench as zero. Raises DeviceFault."""

    @abstractmethod
    def read(self, timeout_s: float) -> ForceSample | None:
        """Return the next sample, or None after `timeout_s`. Raises DeviceFault."""


class Tracker(Device):
    """Tells the pose of a coil in the tip of the needle; abstract."""

    @abstractmethod
    def read(self, timeout_s: float) -> PoseSample | None:
        """Return the next frame, or None after `timeout_s`. Raises DeviceFault."""
