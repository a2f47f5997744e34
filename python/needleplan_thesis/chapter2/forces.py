"""Published parameters of chapter 2, and the records that are simulated with them.

Section 2.5.2 (needle A) and Table 2.3 (needle B) give parameters of Model II; the shipped library `published` contains
them. The letters are those of the thesis: needle A is 18 GA, needle B is 22 GA; tissue A is 4.5 % gellan gum, tissue B
is 6 %.

The force of a simulated record is the sum of

- Model II with the published parameters, along the LSPB profile (80 mm, blends of 0.5 s, 200 Hz);
- bumps due to air bubbles (section 2.5.2) at fixed depths, about one per 4 mm: Gaussian in depth with a width of 1.5
  mm, normally distributed heights, the same in insertion and retraction, with the sign of the velocity;
- white noise of 4.2 mN, which the moving average of the sensor over five samples reduces to 1.9 mN.

No fitted model contains the bumps. Their standard deviation is an assumption: 10 mN for needle A and 8 mN for needle B.
Relative to the smaller forces of needle B, 8 mN is more, because the text calls needle B more susceptible. The bumps
dominate the open-loop errors, so these errors are no evidence about the data of the thesis.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from needleplan.estimation import JointForce
from needleplan.identification.force_library import ForceLibrary
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
    """A published parameter set (a column of Table 2.3, or one of two in section 2.5.2) and its published error."""

    needle: str
    tissue: str
    velocity_mm_s: float
    depth_mm: float
    model: ForceModel2
    mae_n: float
    """Published mean absolute error of the open-loop simulation (N), Figs. 2.7 and 2.9."""

    source: str

    @property
    def title(self) -> str:
        """Short name, such as `A/A 10 mm/s`."""
        return f"{self.needle}/{self.tissue} {self.velocity_mm_s:g} mm/s"


def _published() -> tuple[PublishedForce, ...]:
    found = []
    for combination in ForceLibrary.read("published").combinations:
        assert isinstance(combination.model, ForceModel2)
        assert combination.mae_n is not None
        needle, tissue = (
            "A" if combination.needle.startswith("18 GA") else "B",
            "A" if "4.5 %" in combination.tissue else "B",
        )
        place = combination.source.split("; ")[-1]
        found.append(
            PublishedForce(
                needle,
                tissue,
                combination.velocity_mm_s,
                combination.depth_mm,
                combination.model,
                combination.mae_n,
                place,
            )
        )
    return tuple(found)


PUBLISHED_FORCES = _published()
"""Printed parameter sets: first those of the text, then Table 2.3.

The positive f2 of B/B at 6 mm/s is admissible, because its g falls with depth.
"""


NO_DATA = "the measurements of the thesis are not published; computed from simulated records with assumed disturbances"


@dataclass(frozen=True)
class Row22:
    """A row of Table 2.2: RMS innovations of the estimator (N)."""

    model: str
    transition: bool
    """Whether the first five samples of each phase are included."""

    insertion_n: float
    retraction_n: float
    entire_n: float


TABLE_2_2 = (
    Row22("I", True, 1.68e-1, 3.25e-2, 1.21e-1),
    Row22("II", True, 6.63e-2, 2.09e-2, 2e-2),
    Row22("I", False, 1.81e-2, 1.71e-2, 2.03e-2),
    Row22("II", False, 3.44e-3, 2.83e-3, 3.9e-3),
)
"""Table 2.2 as printed. Its columns contradict each other, which a comparison shows."""


# Moving average of the force sensor, over five samples.
SENSOR = MovingAverage(5)

# Standard deviation of the bump heights by needle (N).
BUBBLES_N = {"A": 10e-3, "B": 8e-3}

# Standard deviation of the white noise (N): the average over five samples leaves 1.9 mN.
_NOISE_N = 1.9e-3 * 5**0.5
# Mean distance and width of the bumps (mm).
_SPACING_MM, _WIDTH_MM = 4.0, 1.5


def insertion_record(published: PublishedForce, seed: int, *, bubbles: bool = True) -> Record:
    """Simulate an insertion and a retraction as the module docstring describes, and return the record.

    Without `bubbles`, the force has no bumps.
    """
    random = np.random.default_rng([seed, round(10 * published.velocity_mm_s)])
    motion = insertion_cycles(published.depth_mm, published.velocity_mm_s)
    force = simulate(published.model, motion).output
    places = random.uniform(0, published.depth_mm, round(published.depth_mm / _SPACING_MM))
    heights = BUBBLES_N[published.needle] * random.standard_normal(places.size)
    if bubbles:
        bumps = np.exp(-(((motion.depth_mm[:, None] - places) / _WIDTH_MM) ** 2)) @ heights
        force = force + motion.direction * bumps
    measured = SENSOR.apply(force + _NOISE_N * random.standard_normal(force.size))
    return Record(
        {
            "time_s": motion.time_s, "depth_mm": motion.depth_mm, "velocity_mm_s": motion.velocity_mm_s,
            "force_n": measured,
        },
        trial=f"{published.title}, seed {seed}",
    )  # fmt: skip


def corners(model: DepthForce, factor: float, count: int, seed: int = 0) -> Iterator[DepthForce]:
    """Yield `count` starting models, whose free parameters are `factor` times too large or too small, at random.

    f2 is not changed. Of f1, only the distance from its lower bound (g > 0) is multiplied. Values are clipped to the
    ranges of the parameters. The starting values of section 2.5.2 are wrong by up to +-500 %.
    """
    joint = JointForce(model)
    x = joint.initial(model, insertion_cycles(1.0, 1.0))
    random = np.random.default_rng(seed)
    changed = np.array([0.0, *(0.0 if name == "f2" else 1.0 for name in joint.free)])
    for _ in range(count):
        signs = random.choice([-1.0, 1.0], x.size)
        start = joint.model(x + math.log(factor) * signs * changed)
        assert isinstance(start, DepthForce)
        yield start
