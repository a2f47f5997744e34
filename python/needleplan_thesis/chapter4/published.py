"""What chapter 4 of the thesis prints: section 4.3.2 and the captions of Figures 4.3 to 4.6.

The figures themselves are not in the text that is available, so that displacements and forces, which are only drawn,
have no published number here.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "AGAR",
    "AMPLITUDE_MM",
    "FAST",
    "FORCE_HZ",
    "FREQUENCY_HZ",
    "GELATIN",
    "SENSOR_LAG_DEG",
    "TRACKER_HZ",
    "Tuned",
]

FREQUENCY_HZ, AMPLITUDE_MM = 0.1, 40.0
FORCE_HZ, TRACKER_HZ = 200.0, 40.0

FAST = (40.0, 400.0)
"""pf of Figures 4.3 and 4.5: alpha1 (1/s), alpha2 (1/s^2)."""

SENSOR_LAG_DEG = 10.13
"""By how much the needle's velocity less that of sensor 3 lags the needle's, in gelatin."""


@dataclass(frozen=True)
class Tuned:
    """A slow observer that was tuned by hand, and H(z) at 0.1 Hz."""

    phantom: str
    alpha1: float
    alpha2: float
    attenuation_percent: float
    lag_deg: float


GELATIN = Tuned("gelatin", 9.0, 20.25, 1.67, 12.36)
AGAR = Tuned("agar", 22.0, 121.0, 0.19, 2.99)
