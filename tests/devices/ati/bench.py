"""A box on a virtual clock, and what it is made to measure."""

from __future__ import annotations

import random

from needleplan.devices import VirtualClock
from needleplan.devices.ati import ForceLimits, NetFt, NetFtBox, parse_configuration
from tests.devices.ati.box_link import BoxLink


class Wrench:
    """A wrench of 1 N and -2 N and 30 N mm with a little seeded noise; `extra_n` is added to the force along x."""

    def __init__(self, noise_n: float = 0.002) -> None:
        self.extra_n = 0.0
        self.noise_n = noise_n
        self._random = random.Random(1)

    def __call__(self, _time_s: float) -> tuple[float, float, float, float, float, float]:
        noise = [self.noise_n * self._random.gauss(0, 1) for _ in range(6)]
        return (1 + self.extra_n + noise[0], -2 + noise[1], noise[2], 30 + noise[3], noise[4], noise[5])


class Bench:
    """Sensor, link, box and wrench, all in this process."""

    def __init__(self, limits: ForceLimits | None = None) -> None:
        self.clock = VirtualClock()
        self.wrench = Wrench()
        self.box = NetFtBox(self.wrench)
        self.link = BoxLink(self.box, self.clock)
        self.limits = limits

    def sensor(self) -> NetFt:
        configure = lambda: parse_configuration(self.box.page())  # noqa: E731
        return NetFt(self.link, configure, limits=self.limits, clock=self.clock)
