"""What chapter 3 prints besides parameters: Tables 3.5 and 3.6. The parameters are with the models.

The columns of Table 3.5 lost their order on the way into text; they are put back so that low and high range pool to the
total (`pooled_mn`), which all 16 do to 0.4 mN.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["TABLE_3_5", "TABLE_3_6", "Errors", "pooled_mn"]


@dataclass(frozen=True)
class Errors:
    """RMSE in mN: over all speeds, up to half of the top speed, and above."""

    total: float
    low: float
    high: float


def _row(total: tuple[float, ...], low: tuple[float, ...], high: tuple[float, ...]) -> dict[int, Errors]:
    return {case: Errors(*each) for case, each in enumerate(zip(total, low, high, strict=True), start=1)}


TABLE_3_5 = {
    "I": _row((29.7, 23.1, 49.3, 27.0), (37.7, 30.1, 51.8, 33.0), (25.1, 19.0, 48.0, 23.5)),
    "II": _row((19.6, 14.5, 30.9, 19.2), (15.9, 11.8, 21.2, 18.5), (21.1, 16.0, 34.5, 20.0)),
    "III-B": _row((17.9, 13.3, 28.1, 15.8), (18.1, 11.6, 26.6, 17.6), (17.8, 13.5, 28.7, 14.3)),
    "Karnopp": _row((28.2, 22.9, 39.8, 21.8), (38.9, 31.4, 52.3, 29.4), (21.2, 17.5, 32.3, 17.0)),
}
"""By model and case."""

TABLE_3_6 = {
    "solid": {"I": (79.0, 68.9), "II": (73.1, 67.0), "III-A": (39.2, 31.5), "III-B": (41.9, 22.8)},
    "dashed": {"I": (74.7, 62.8), "II": (75.6, 68.7), "III-A": (55.3, 35.7), "III-B": (51.6, 29.0)},
}
"""By profile of Fig. 3.4(b) and model: RMSE (mN) of cases 1 and 2, major cutting excluded."""


def pooled_mn(errors: Errors) -> float:
    """Return the total RMSE that low and high range make: a sine is slow (|cos| < 1/2) for a third of the time."""
    return math.sqrt(errors.low**2 / 3 + 2 * errors.high**2 / 3)
