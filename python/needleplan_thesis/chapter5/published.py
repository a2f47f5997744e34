"""What chapter 5 of the thesis prints."""

from __future__ import annotations

import math
from dataclasses import dataclass

from needleplan.models import NeedleShaft
from needleplan.models.deflection import ElasticTissue

__all__ = [
    "AREA_M2",
    "CASES",
    "CHANGES",
    "COIL_MM",
    "END_MM",
    "NEEDLE",
    "NO_FORCE",
    "SECOND_MOMENT_M4",
    "SENSITIVITY",
    "Case",
    "Change",
]

NEEDLE = NeedleShaft(0.718, 0.413, 203.0, math.radians(24.8))
SECOND_MOMENT_M4, AREA_M2 = 1.162e-14, 2.709e-7
COIL_MM = 9.3
END_MM = 80.0

NO_FORCE = "the cutting force over depth, which drives the model, was not published"


@dataclass(frozen=True)
class Case:
    """A column of Table 5.2: tissue and velocity, errors and radii; `greatest_n` is known at 15 mm/s only."""

    name: str
    tissue: ElasticTissue
    velocity_mm_s: float
    mean_error_mm: float
    max_error_mm: float
    measured_mm: float
    estimated_mm: float
    greatest_n: float | None

    @property
    def error_percent(self) -> float:
        """|estimated - measured|/measured of the radii, in percent."""
        return 100 * abs(self.estimated_mm - self.measured_mm) / self.measured_mm


_A, _B = ElasticTissue(3.87e-3, 123.9e-6), ElasticTissue(7.65e-3, 166.7e-6)

CASES = (
    Case("A, 10 mm/s", _A, 10.0, 0.108, 0.374, 1357.6, 1165.5, None),
    Case("B, 10 mm/s", _B, 10.0, 0.091, 0.201, 1495.9, 1292.7, None),
    Case("A, 15 mm/s", _A, 15.0, 0.121, 0.351, 1247.8, 1139.2, 0.232),
    Case("B, 15 mm/s", _B, 15.0, 0.094, 0.236, 1441.5, 1171.7, 0.276),
)


@dataclass(frozen=True)
class Change:
    """A row of Table 5.3: kf and vf are multiplied by these."""

    name: str
    stiffness: float
    friction: float

    def of(self, tissue: ElasticTissue) -> ElasticTissue:
        """Return the changed tissue."""
        return ElasticTissue(self.stiffness * tissue.stiffness_n_mm2, self.friction * tissue.friction_n_s_mm2)


CHANGES = (
    Change("kf +20 %", 1.2, 1.0),
    Change("kf -20 %", 0.8, 1.0),
    Change("vf +20 %", 1.0, 1.2),
    Change("vf -20 %", 1.0, 0.8),
)

SENSITIVITY = (
    (12.29, 8.60, 9.01, 11.58),
    (24.61, 19.22, 12.75, 27.84),
    (15.07, 14.39, 12.51, 21.76),
    (13.80, 8.85, 8.97, 16.53),
)
"""Table 5.3, percent: a row for every one of CHANGES, a column for every one of CASES."""
