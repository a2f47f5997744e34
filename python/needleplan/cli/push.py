"""The push of the needle on a target, of `plan --push` and `insert --push`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from needleplan.cli.options import numbers
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.models.tissue import NeedlePush

__all__ = ["PUSH_FORM", "PUSH_HELP", "Push", "read_push"]

# Largest plausible shear modulus (N/mm^2) of soft tissue: 1 MPa, above that of cartilage. A larger one is in kPa.
_STIFFEST_N_MM2 = 1.0

PUSH_FORM = "F,G,A[,S,L]"
"""Form of the value of `--push`."""

PUSH_HELP = (
    "force of the tip in N, shear modulus of the tissue in N/mm^2, radius of the needle in mm; for the push of the "
    "shaft, too, its friction in N and the length of the path in mm"
)
"""Meaning of the numbers of `--push`."""


class Push(NamedTuple):
    """Tissue, force of the tip (N), friction of the shaft (N), and length of the path (mm), infinite if not given."""

    tissue: NeedlePush
    tip_n: float
    shaft_n: float
    length_mm: float

    @property
    def shift_mm(self) -> float:
        """Displacement (mm) of a target at the tip."""
        length = self.length_mm if math.isfinite(self.length_mm) else 0.0
        return self.tissue.shift_mm(self.tip_n, self.shaft_n, length, ahead_mm=0.0, aside_mm=0.0)

    @property
    def beyond_mm(self) -> float:
        """Length (mm) by which the tip must go on to reach the displaced target."""
        return self.tissue.beyond_mm(self.tip_n, self.shaft_n, self.length_mm)


def read_push(text: str) -> Push:
    """Return the push that the value of `--push` describes. Raises InputError or ModelError."""
    from needleplan.models.tissue import NeedlePush

    force_n, modulus, radius_mm, *shaft = numbers("--push", text, 3, 5, form="F,G,A or F,G,A,S,L")
    friction_n, length_mm = shaft or (0.0, math.inf)
    rules = (("F", force_n, "N, at least 0", force_n >= 0), ("S", friction_n, "N, at least 0", friction_n >= 0),
             ("L", length_mm, "mm above 0", length_mm > 0),
             ("G", modulus, "that of soft tissue: 1 kPa is 0.001 N/mm^2", modulus <= _STIFFEST_N_MM2))  # fmt: skip
    wrong = [Mistake(f"--push {name}", f"{value:g}", f"must be {rule}") for name, value, rule, ok in rules if not ok]
    if wrong:
        raise InputError(wrong)
    return Push(NeedlePush(modulus, radius_mm), force_n, friction_n, length_mm)
