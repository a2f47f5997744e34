"""An Aurora on a virtual clock, with two coils that move slowly."""

from __future__ import annotations

import math

from needleplan.devices import VirtualClock
from needleplan.devices.ndi import AuroraDevice, NdiPoseLimits, NdiTracker, SimulatedTool
from tests.devices.ndi.aurora_link import AuroraLink

TIP, REFERENCE = "34801403", "34801404"


def needle(time_s: float) -> tuple[tuple[float, float, float, float], tuple[float, float, float]]:
    """A coil that moves at 2 mm/s and turns at 0.1 rad/s."""
    half_rad = 0.05 * time_s
    return (math.cos(half_rad), 0, math.sin(half_rad), 0), (10 + 2 * time_s, -20, -150)


def plate(_time_s: float) -> tuple[tuple[float, float, float, float], tuple[float, float, float]]:
    """A coil at rest."""
    return (1, 0, 0, 0), (100, 0, -200)


def aurora() -> AuroraDevice:
    return AuroraDevice([SimulatedTool(TIP, needle), SimulatedTool(REFERENCE, plate, handle=0x0B)])


class Bench:
    """Tracker, link and device, all in this process."""

    def __init__(self, text: bool = False, limits: NdiPoseLimits | None = None) -> None:
        self.clock = VirtualClock()
        self.device = aurora()
        self.device.clock = self.clock
        self.link = AuroraLink(self.device, self.clock)
        self.text, self.limits = text, limits

    @property
    def faults(self):  # type: ignore[no-untyped-def]
        return self.device.faults

    @property
    def tip(self) -> SimulatedTool:
        return self.device.tools[0]

    def tracker(self, tool: str = TIP) -> NdiTracker:
        return NdiTracker(self.link, tool=tool, text=self.text, limits=self.limits, clock=self.clock)
