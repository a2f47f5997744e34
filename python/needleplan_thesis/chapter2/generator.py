"""Records for chapter 2: what a robot with a force sensor would have seen.

Force = Model II with the published parameters, along the LSPB profile (80 mm, blends of 0.5 s, 200 Hz)
      + bumps where air bubbles are (section 2.5.2): at fixed depths about 4 mm apart, the same on both ways, with the
        sign of the motion, Gaussian in depth with a width of 1.5 mm and normal heights,
      + white noise of 4.2 mN, then the sensor's moving average of five samples, which leaves 1.9 mN of it.

The bumps are not in any model that is fitted. Their size is ours: 10 mN for needle A and 8 mN for B, more beside its
smaller forces, as the text calls it more susceptible. It decides the errors in the open loop, so these say nothing
about the thesis' data.
"""

from __future__ import annotations

import numpy as np

from needleplan.models import simulate
from needleplan.signals import MovingAverage, Record, insertion_cycles
from needleplan_thesis.chapter2.forces import PublishedForce

__all__ = ["BUBBLES_N", "SENSOR", "insertion_record"]

SENSOR = MovingAverage(5)
BUBBLES_N = {"A": 10e-3, "B": 8e-3}
_NOISE_N = 1.9e-3 * 5**0.5
_SPACING_MM, _WIDTH_MM = 4.0, 1.5


def insertion_record(chosen: PublishedForce, seed: int, *, bubbles: bool = True) -> Record:
    """Return one insertion and retraction; see the module."""
    random = np.random.default_rng([seed, round(10 * chosen.velocity_mm_s)])
    motion = insertion_cycles(chosen.depth_mm, chosen.velocity_mm_s)
    force = simulate(chosen.model, motion).output
    places = random.uniform(0, chosen.depth_mm, round(chosen.depth_mm / _SPACING_MM))
    heights = BUBBLES_N[chosen.needle] * random.standard_normal(places.size)
    if bubbles:
        bumps = np.exp(-(((motion.depth_mm[:, None] - places) / _WIDTH_MM) ** 2)) @ heights
        force = force + motion.direction * bumps
    measured = SENSOR.apply(force + _NOISE_N * random.standard_normal(force.size))
    return Record(
        {
            "time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s,
            "force_n": measured,
        },
        trial=f"{chosen.title}, seed {seed}",
    )  # fmt: skip
