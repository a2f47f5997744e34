"""Parameters that the thesis identified: section 2.5.2 (needle A) and Table 2.3 (needle B), all of Model II.

The shipped atlas `published` holds them. Here they carry the letters of the thesis: needle A is 18 GA, B is 22 GA;
tissue A is 4.5 % gellan gum, B is 6 %.

What chapter 2 of the thesis prints beside the parameters, which are in `needleplan.models.force`.

Records for chapter 2: what a robot with a force sensor would have seen.

Force = Model II with the published parameters, along the LSPB profile (80 mm, blends of 0.5 s, 200 Hz)
      + bumps where air bubbles are (section 2.5.2): at fixed depths about 4 mm apart, the same on both ways, with the
        sign of the motion, Gaussian in depth with a width of 1.5 mm and normal heights,
      + white noise of 4.2 mN, then the sensor's moving average of five samples, which leaves 1.9 mN of it.

The bumps are not in any model that is fitted. Their size is ours: 10 mN for needle A and 8 mN for B, more beside its
smaller forces, as the text calls it more susceptible. It decides the errors in the open loop, so these say nothing
about the thesis' data.

Starts that are wrong by factors: phi(0) within +-500 % of the estimate, as section 2.5.2 has it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from needleplan.estimation import JointForce
from needleplan.identification.atlas import Atlas
from needleplan.models import simulate
from needleplan.models.force import DepthForce, ForceModel2
from needleplan.signals import MovingAverage, Record, insertion_cycles

__all__ = [
    "BUBBLES_N",
    "NO_DATA",
    "PUBLISHED_FORCES",
    "SENSOR",
    "TABLE_2_2",
    "PublishedForce",
    "Row22",
    "corners",
    "insertion_record",
]


@dataclass(frozen=True)
class PublishedForce:
    """One column of Table 2.3, or one of the two sets of the text, with its mean absolute error on their data."""

    needle: str
    tissue: str
    velocity_mm_s: float
    depth_mm: float
    model: ForceModel2
    mae_n: float
    """Mean absolute error of the open-loop simulation against the measured force of Figs. 2.7 and 2.9 (N)."""

    source: str

    @property
    def title(self) -> str:
        """Short name, such as `A/A 10 mm/s`."""
        return f"{self.needle}/{self.tissue} {self.velocity_mm_s:g} mm/s"


def _published() -> tuple[PublishedForce, ...]:
    found = []
    for each in Atlas.read("published").combinations:
        assert isinstance(each.model, ForceModel2)
        assert each.mae_n is not None
        needle, tissue = "A" if each.needle.startswith("18 GA") else "B", "A" if "4.5 %" in each.tissue else "B"
        place = each.source.split("; ")[-1]
        found.append(PublishedForce(needle, tissue, each.velocity_mm_s, each.depth_mm, each.model, each.mae_n, place))
    return tuple(found)


PUBLISHED_FORCES = _published()
"""As printed. The positive f2 of B/B at 6 mm/s (g falls with depth) is legal. Order: text, then Table 2.3."""


NO_DATA = "the measurements of the thesis are not published; ours are made with its parameters and disturbances of ours"


@dataclass(frozen=True)
class Row22:
    """A row of Table 2.2: root mean squared errors of the estimator (N)."""

    model: str
    transition: bool
    """Whether the first five samples of each phase count."""

    insertion_n: float
    retraction_n: float
    entire_n: float


TABLE_2_2 = (
    Row22("I", True, 1.68e-1, 3.25e-2, 1.21e-1),
    Row22("II", True, 6.63e-2, 2.09e-2, 2e-2),
    Row22("I", False, 1.81e-2, 1.71e-2, 2.03e-2),
    Row22("II", False, 3.44e-3, 2.83e-3, 3.9e-3),
)
"""As printed; that the columns do not agree with each other is one of the comparisons."""


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


def corners(model: DepthForce, factor: float, count: int, seed: int = 0) -> Iterator[DepthForce]:
    """Return `count` models whose free parameters are each wrong by `factor` or its inverse, f2 excepted.

    f1 is wrong in its distance from the bound that keeps g positive.
    """
    joint = JointForce(model)
    x = joint.initial(model, insertion_cycles(1.0, 1.0))
    random = np.random.default_rng(seed)
    may = np.array([0.0, *(0.0 if name == "f2" else 1.0 for name in joint.free)])
    for _ in range(count):
        signs = random.choice([-1.0, 1.0], x.size)
        made = joint.model(x + math.log(factor) * signs * may)
        assert isinstance(made, DepthForce)
        yield made
