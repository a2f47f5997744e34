"""Parameters that the thesis identified: section 2.5.2 (needle A) and Table 2.3 (needle B), all of Model II.

A. Asadian, M. R. Kermani, R. V. Patel, "A Novel Force Modeling Scheme for Needle Insertion using Multiple Kalman
Filters", IEEE Transactions on Instrumentation and Measurement 61(2), 2012, 429-438; chapter 2 of A. Asadian's thesis.
Needle A: 18 GA, 1.270 / 0.838 mm; B: 22 GA, 0.718 / 0.413 mm. Tissue A: 4.5 % gellan gum, B: 6 %. Depth 80 mm.
"""

from __future__ import annotations

from dataclasses import dataclass

from needleplan.models.force._depth_force import ForceModel2

__all__ = ["PUBLISHED_FORCES", "PublishedForce"]


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


def _set(needle: str, tissue: str, velocity_mm_s: float, mae_n: float, source: str, **values: float) -> PublishedForce:
    return PublishedForce(needle, tissue, velocity_mm_s, 80.0, ForceModel2(**values), mae_n, source)


PUBLISHED_FORCES = (
    _set(
        "A", "A", 10.0, 9.87e-3, "section 2.5.2, Fig. 2.7a",
        sigma0=7.9e-3, sigma1=2.46, sigma2=4.14e-3, f1=5.59e-2, beta=2.55e-2, f2=-2.11e-2, alpha=5.25e-2,
    ),
    _set(
        "A", "A", 6.0, 7.52e-3, "section 2.5.2, Fig. 2.7b",
        sigma0=3.91e-3, sigma1=2.25, sigma2=3.55e-3, f1=3.25e-2, beta=2.43e-2, f2=-1.17e-2, alpha=3.63e-2,
    ),
    _set(
        "B", "B", 10.0, 9.27e-3, "Table 2.3, Fig. 2.9a",
        sigma0=9.2e-4, sigma1=4.48e-1, sigma2=1.63e-3, f1=2.7e-2, beta=1.53e-2, f2=-9.96e-3, alpha=1.11e-2,
    ),
    _set(
        "B", "B", 6.0, 9.41e-3, "Table 2.3, Fig. 2.9b",
        sigma0=8.37e-4, sigma1=9.27e-1, sigma2=1.79e-3, f1=9.21e-3, beta=1.36e-2, f2=2.49e-1, alpha=5.84e-2,
    ),
    _set(
        "B", "A", 10.0, 11.02e-3, "Table 2.3, Fig. 2.9c",
        sigma0=7.96e-4, sigma1=5.35e-1, sigma2=7.63e-4, f1=2.15e-2, beta=1.58e-2, f2=-1.19e-2, alpha=1.08e-2,
    ),
)  # fmt: skip
"""As printed; that f2 of B/B at 6 mm/s is positive (g falls with depth) is legal. Order: text, then Table 2.3."""
