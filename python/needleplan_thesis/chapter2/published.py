"""What chapter 2 of the thesis prints beside the parameters, which are in `needleplan.models.force`."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["NO_DATA", "TABLE_2_2", "Row22"]

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
