"""The registration of `needleplan insert`: its verdict, and its error at the target beside the target's radius."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from needleplan.cli.answer import note
from needleplan.errors import InputError, Mistake

if TYPE_CHECKING:
    from needleplan.cli.insert_plan import InsertPlan
    from needleplan.estimation.registration import Registration

__all__ = ["read_judged"]

# Share of the target's radius above which the expected error at the target is remarked on.
_LARGE_SHARE = 0.5


def read_judged(file: str, plan: InsertPlan) -> Registration:
    """Return the registration of a file after comparing its expected error (TRE) with the radius of the target.

    Remarks name what a person accepted, an unknown TRE, and a TRE above half the radius. Raises DataError if the
    file cannot be read, or the registration has no verdict or was refused; InputError for a TRE above the radius.
    """
    from needleplan.estimation.registration import Registration, require_verdict

    found = Registration.read(file)
    verdict = require_verdict(found, file).verdict
    if verdict.accepted:
        note(f"warning: the registration was accepted: {verdict.accepted}")
        for reason in verdict.reasons:
            note(f"warning: against the registration: {reason}")
    error, radius = found.tre_mm(plan.target_in_registration_mm), plan.target_radius_mm
    if math.isnan(error):
        note("warning: the registration has no points, so its error at the target (TRE) is unknown")
    elif error > radius:
        rule = f"must be at most the radius of the target, {radius:.3g} mm: measure more points around the target"
        raise InputError(Mistake("expected error at the target (TRE)", f"{error:.3g} mm", rule), file)
    elif error > _LARGE_SHARE * radius:
        note(
            f"warning: the error at the target (TRE), {error:.3g} mm expected, exceeds half its radius, {radius:.3g} mm"
        )
    return found
