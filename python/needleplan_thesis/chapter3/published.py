"""Published numbers of chapter 3: the parameters of Tables 3.1 to 3.4 and the errors of Tables 3.5 and 3.6.

A. Asadian, "Robot-Assisted Needle Insertion Using a Control Theoretic Approach", PhD thesis, The University of Western
Ontario, chapter 3.

The parameters are means and standard deviations over repetitions at four insertion points. Therefore the means are not
the best fit of any single record. The normal force is Fn = 1 N at 76 mm, the ramp w = 2.5 mm, and gamma = 1. The thesis
prints lambda = 5 for case 1 and no value for the other cases.

| label | specimen |
|---|---|
| needle A | cannula of an 18 GA needle, 44.058 g with its holder |
| needle B | 22 GA needle, 13.128 g with its holder |
| tissue A | gellan gum, 4 %, 0.11 MPa |
| tissue B | gellan gum, 6 %, 0.16 MPa |

The text extraction lost the order of the columns of Table 3.5. Two rules determine it. The errors of the low and the
high speed range combine to the total (`pooled_mn`), to 0.4 mN in all 16 triples; this tells which three columns are of
one case. The sentences of section 3.4.1 name cases (`statements` in `tables.py`); only one order of the four cases
agrees with all of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from needleplan.models import AveragedLuGre, LumpedLuGre, QuasiStatic
from needleplan.signals import Motion, sinusoid

__all__ = [
    "CASES",
    "MODEL_I",
    "MODEL_II",
    "MODEL_III_B",
    "NEEDLE_MASS_KG",
    "TABLE_3_5",
    "TABLE_3_6",
    "THICKNESS_MM",
    "Errors",
    "FrictionCase",
    "PrintedParameter",
    "model_i",
    "model_ii",
    "model_iii_b",
    "passing_through",
    "pooled_mn",
]

THICKNESS_MM = 76.0
"""Thickness of the phantoms (mm)."""

# Distance of the tip beyond the phantom in the middle of the stroke (mm).
_PROTRUSION_MM = 50.0

NEEDLE_MASS_KG = {"A": 0.044058, "B": 0.013128}
"""Mass of each needle with its holder (kg)."""


@dataclass(frozen=True)
class FrictionCase:
    """A column of Table 3.1. `amplitude_mm` is from zero to peak: case 4 reaches 14.1 mm/s (the text says above 10)."""

    number: int
    frequency_hz: float
    amplitude_mm: float
    needle: str
    tissue: str

    @property
    def top_speed_mm_s(self) -> float:
        """Largest speed of the motion (mm/s)."""
        return 2 * math.pi * self.frequency_hz * self.amplitude_mm


CASES = {
    1: FrictionCase(1, 0.05, 25.0, "A", "A"),
    2: FrictionCase(2, 0.08, 25.0, "B", "A"),
    3: FrictionCase(3, 0.02, 45.0, "A", "B"),
    4: FrictionCase(4, 0.05, 45.0, "B", "B"),
}
"""Table 3.1 by case number."""


@dataclass(frozen=True)
class PrintedParameter:
    """A printed parameter: mean and standard deviation."""

    mean: float
    sd: float


def _table(**rows: tuple[float, ...]) -> dict[int, dict[str, PrintedParameter]]:
    """Convert rows of mean, sd, mean, sd ... to parameters by case and name."""
    return {
        case: {name: PrintedParameter(*row[2 * column : 2 * column + 2]) for name, row in rows.items()}
        for column, case in enumerate(CASES)
    }


MODEL_I = _table(
    sigma0=(1.272, 0.338, 0.616, 0.098, 1.903, 0.125, 0.812, 0.044),
    sigma2=(0.017, 0.005, 0.015, 0.002, 0.011, 0.002, 0.030, 0.003),
    mu_c=(0.711, 0.116, 0.338, 0.148, 0.715, 0.090, 0.653, 0.055),
    mu_s=(0.044, 0.011, 0.024, 0.003, 0.055, 0.003, 0.058, 0.009),
    alpha=(0.081, 0.007, 0.077, 0.024, 0.121, 0.018, 0.073, 0.010),
)
"""Table 3.2 by case and parameter."""

MODEL_II = _table(
    sigma0=(1.344, 0.214, 0.592, 0.224, 1.877, 0.104, 0.813, 0.132),
    sigma1=(0.463, 0.013, 0.239, 0.055, 0.686, 0.045, 0.312, 0.037),
    sigma2=(0.016, 0.003, 0.012, 0.002, 0.011, 0.000, 0.031, 0.002),
    mu_c=(0.735, 0.087, 0.448, 0.082, 0.669, 0.073, 0.633, 0.029),
    mu_s=(0.034, 0.004, 0.017, 0.001, 0.046, 0.003, 0.050, 0.007),
    alpha=(0.092, 0.007, 0.076, 0.014, 0.113, 0.021, 0.074, 0.002),
)
"""Table 3.3."""

MODEL_III_B = _table(
    sigma0=(1.203, 0.157, 0.559, 0.266, 1.818, 0.143, 0.763, 0.092),
    sigma1=(0.374, 0.017, 0.255, 0.063, 0.581, 0.046, 0.287, 0.030),
    sigma2=(0.014, 0.004, 0.012, 0.001, 0.010, 0.002, 0.028, 0.001),
    mu_c=(0.788, 0.149, 0.450, 0.028, 0.667, 0.014, 0.744, 0.026),
    mu_s=(0.033, 0.003, 0.018, 0.008, 0.041, 0.002, 0.048, 0.006),
    alpha=(0.088, 0.010, 0.074, 0.006, 0.135, 0.006, 0.072, 0.005),
)
"""Table 3.4."""


def _means(table: dict[int, dict[str, PrintedParameter]], case: int) -> dict[str, Any]:
    return {name: printed.mean for name, printed in table[case].items()}


def model_i(case: int) -> QuasiStatic:
    """Return Model I with the means of Table 3.2."""
    return QuasiStatic(**_means(MODEL_I, case))


def model_ii(case: int) -> LumpedLuGre:
    """Return Model II with the means of Table 3.3."""
    return LumpedLuGre(**_means(MODEL_II, case))


def model_iii_b(case: int, exponent: float = 5.0) -> AveragedLuGre:
    """Return Model III-B with the means of Table 3.4."""
    return AveragedLuGre(**_means(MODEL_III_B, case), exponent=exponent)


def passing_through(case: int, cycles: float = 4.0, rate_hz: float = 200.0) -> Motion:
    """Return the periodic motion of a case. At the middle of the stroke, the tip is 50 mm beyond the phantom."""
    each = CASES[case]
    return sinusoid(
        offset_mm=THICKNESS_MM + _PROTRUSION_MM, amplitude_mm=each.amplitude_mm, frequency_hz=each.frequency_hz,
        cycles=cycles, rate_hz=rate_hz,
    )  # fmt: skip


@dataclass(frozen=True)
class Errors:
    """RMSE (mN) at all speeds (`total`), up to half of the top speed (`low`), and above it (`high`)."""

    total: float
    low: float
    high: float


def _row(total: tuple[float, ...], low: tuple[float, ...], high: tuple[float, ...]) -> dict[int, Errors]:
    return {case: Errors(*each) for case, each in enumerate(zip(total, low, high, strict=True), start=1)}


TABLE_3_5 = {
    "I": _row((29.7, 23.1, 27.0, 49.3), (37.7, 30.1, 33.0, 51.8), (25.1, 19.0, 23.5, 48.0)),
    "II": _row((19.6, 14.5, 19.2, 30.9), (15.9, 11.8, 18.5, 21.2), (21.1, 16.0, 20.0, 34.5)),
    "III-B": _row((17.9, 13.3, 15.8, 28.1), (18.1, 11.6, 17.6, 26.6), (17.8, 13.5, 14.3, 28.7)),
    "Karnopp": _row((28.2, 22.9, 21.8, 39.8), (38.9, 31.4, 29.4, 52.3), (21.2, 17.5, 17.0, 32.3)),
}
"""Table 3.5 by model and case."""

TABLE_3_6 = {
    "solid": {"I": (79.0, 68.9), "II": (73.1, 67.0), "III-A": (39.2, 31.5), "III-B": (41.9, 22.8)},
    "dashed": {"I": (74.7, 62.8), "II": (75.6, 68.7), "III-A": (55.3, 35.7), "III-B": (51.6, 29.0)},
}
"""Table 3.6 by profile of Fig. 3.4(b) and model: RMSE (mN) of cases 1 and 2 without major cutting."""


def pooled_mn(errors: Errors) -> float:
    """Return the total RMSE (mN) that follows from the RMSE of the low and of the high speed range.

    A sinusoidal motion is below half of its top speed (|cos| < 1/2) for a third of the time.
    """
    return math.sqrt(errors.low**2 / 3 + 2 * errors.high**2 / 3)
