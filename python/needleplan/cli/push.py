"""The push of the needle on a target, of `plan --push` and `insert --push`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from needleplan.cli.options import numbers
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.models.tissue import TargetPush

__all__ = ["PUSH_FORM", "PUSH_HELP", "read_push"]

# Largest plausible shear modulus (N/mm^2) of soft tissue: 1 MPa, above that of cartilage. A larger one is in kPa.
_STIFFEST_N_MM2 = 1.0

PUSH_FORM = "F,G,A[,S,L]"
"""Form of the value of `--push`."""

PUSH_HELP = (
    "force of the tip in N, shear modulus of the tissue in N/mm^2, radius of the needle in mm; for the push of the "
    "shaft, too, its friction in N and the length of the path in mm"
)
"""Meaning of the numbers of `--push`."""


def read_push(text: str) -> TargetPush:
    """Return the push that the value of `--push` describes. Raises InputError or ModelError."""
    from needleplan.models.tissue import NeedlePush, TargetPush

    force_n, modulus, radius_mm, *shaft = numbers("--push", text, 3, 5, form="F,G,A or F,G,A,S,L")
    friction_n, length_mm = shaft or (0.0, math.inf)
    rules = (("F", force_n, "N, at least 0", force_n >= 0), ("S", friction_n, "N, at least 0", friction_n >= 0),
             ("L", length_mm, "mm above 0", length_mm > 0),
             ("G", modulus, "that of soft tissue: 1 kPa is 0.001 N/mm^2", modulus <= _STIFFEST_N_MM2))  # fmt: skip
    wrong = [Mistake(f"--push {name}", f"{value:g}", f"must be {rule}") for name, value, rule, ok in rules if not ok]
    if wrong:
        raise InputError(wrong)
    return TargetPush(NeedlePush(modulus, radius_mm), force_n, friction_n, length_mm)
