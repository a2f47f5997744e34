"""Where a frame of the tracker is in the frame of the plan: x along the insertion, y to the left, z out of it."""

from __future__ import annotations

from typing import Protocol

from needleplan.devices import PoseSample

__all__ = ["LabFrame", "PlanFrame"]

_Vector = tuple[float, float, float]


class PlanFrame(Protocol):
    """Takes a sample of the tracker to the frame of the plan."""

    @property
    def digest(self) -> str:
        """SHA-256 of the registration, empty where there is none."""

    def coil(self, sample: PoseSample) -> tuple[_Vector, _Vector]:
        """Return where the coil is (mm) and the direction of the needle there."""


class LabFrame:
    """The simulated lab, whose frame is that of the plan; the z axis of the coil is along the needle."""

    digest = ""

    def coil(self, sample: PoseSample) -> tuple[_Vector, _Vector]:
        """Return where the coil is (mm) and the direction of the needle there."""
        w, x, y, z = sample.quaternion
        return sample.position_mm, (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
