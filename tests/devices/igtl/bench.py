"""A PLUS server on a virtual clock, with two coils that move slowly."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from needleplan.devices import VirtualClock
from needleplan.devices.igtl import IgtlPoseLimits, IgtlTracker, PlusDevice, PlusFaults, PoseKind, TrackedTool
from tests.devices.igtl.plus_link import PlusLink

TIP, PLATE = "NeedleToTracker", "PlateToTracker"


def needle(time_s: float) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """A coil that moves at 2 mm/s and turns at 0.1 rad/s."""
    half_rad = 0.05 * time_s
    return (10 + 2 * time_s, -20.0, -150.0), (math.cos(half_rad), 0.0, math.sin(half_rad), 0.0)


def plate(_time_s: float) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """A coil at rest."""
    return (100.0, 0.0, -200.0), (1.0, 0.0, 0.0, 0.0)


def plus(kind: PoseKind = PoseKind.TRANSFORM, **options: Any) -> PlusDevice:
    return PlusDevice([TrackedTool(TIP, needle), TrackedTool(PLATE, plate)], kind, **options)


@dataclass
class Bench:
    """Tracker, link and server, all in this process."""

    kind: PoseKind = PoseKind.TRANSFORM
    limits: IgtlPoseLimits | None = None
    rate_hz: float = 40.0
    clock: VirtualClock = field(default_factory=VirtualClock)

    def __post_init__(self) -> None:
        self.device = plus(self.kind)
        self.link = PlusLink(self.device, self.clock)

    @property
    def faults(self) -> PlusFaults:
        return self.device.faults

    @property
    def tip(self) -> TrackedTool:
        return self.device.tools[0]

    def tracker(self, name: str = TIP, **options: Any) -> IgtlTracker:
        chosen = {"kind": self.kind, "rate_hz": self.rate_hz, **options}
        return IgtlTracker(self.link, name, limits=self.limits, clock=self.clock, **chosen)
