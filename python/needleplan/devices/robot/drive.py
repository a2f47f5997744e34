"""The drives of a robot as its capture side sees them, and the watch that it keeps on them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from needleplan.devices.robot.messages import Fault

__all__ = ["Drive", "DriveLimits", "DriveState", "DriveWatch"]


@dataclass(frozen=True, slots=True)
class DriveState:
    """What encoders and drives say, and where the axes should be by now."""

    depth_mm: float
    velocity_mm_s: float
    roll_rad: float
    velocity_rad_s: float
    wanted_depth_mm: float
    wanted_roll_rad: float
    moving: bool
    faults: Fault = Fault(0)
    """What the drives report themselves: a fault, a limit switch, the emergency stop."""


class Drive(Protocol):
    """Two axes with their servo."""

    def advance(self, time_s: float) -> DriveState:
        """Go on to a time, and say where the axes are."""

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin to move to a depth. Raises DeviceFault for what cannot be."""

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin to turn to a roll. Raises DeviceFault for what cannot be."""

    def stop(self) -> None:
        """Stop both axes as fast as can be."""


@dataclass(frozen=True)
class DriveLimits:
    """What the capture side takes for a fault of an axis."""

    following_mm: float = 0.2
    following_rad: float = 0.05
    fastest_mm_s: float = 200.0
    fastest_rad_s: float = 50.0
    """An encoder that goes faster has jumped."""

    still: float = 0.1
    """An axis that has gone less than this share of its way does not move."""


class DriveWatch:
    """Compares where the axes are with where they should be, and with where they were."""

    def __init__(self, limits: DriveLimits | None = None) -> None:
        limits = DriveLimits() if limits is None else limits
        self._insertion = _AxisWatch(limits.following_mm, limits.fastest_mm_s, limits.still)
        self._roll = _AxisWatch(limits.following_rad, limits.fastest_rad_s, limits.still)

    def forget(self) -> None:
        """What comes next may be anywhere, as after a repair."""
        self._insertion.begin = self._insertion.last = self._roll.begin = self._roll.last = None

    def see(self, state: DriveState, time_s: float) -> Fault:
        """Return what is wrong."""
        return (
            state.faults
            | self._insertion.see(state.wanted_depth_mm, state.depth_mm, time_s)
            | self._roll.see(state.wanted_roll_rad, state.roll_rad, time_s)
        )


class _AxisWatch:
    def __init__(self, following: float, fastest: float, still: float) -> None:
        self._following, self._fastest, self._still = following, fastest, still
        self.last: tuple[float, float] | None = None
        self.begin: tuple[float, float] | None = None
        """Where the axis should be and was when it last followed well."""

    def see(self, wanted: float, measured: float, time_s: float) -> Fault:
        last, self.last = self.last, (measured, time_s)
        if last is not None and abs(measured - last[0]) > self._following + self._fastest * (time_s - last[1]):
            return Fault.ENCODER
        error = abs(wanted - measured)
        if self.begin is None or error < self._following / 4:
            self.begin = wanted, measured
        if error <= self._following:
            return Fault(0)
        asked, went = wanted - self.begin[0], measured - self.begin[1]
        if abs(went) < self._still * abs(asked):
            return Fault.NO_MOTION
        return Fault.ENCODER if asked * went < 0 else Fault.FOLLOWING
