"""Comparison of published results with computed results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum

__all__ = ["Agreement", "Comparison", "Evidence", "by_evidence", "measured"]

# Largest ratio of computed to published value, or its inverse, that counts as the same order of magnitude.
_SAME_ORDER = 3.0


class Agreement(StrEnum):
    """How well a computed result agrees with the published one."""

    REPRODUCED = "reproduced"
    """The computed number equals the published number within its accuracy, or the published statement holds."""

    SAME_ORDER = "same order"
    """The numbers agree within a factor of three; used if computer or geometry differ from the published ones."""

    DIFFERS = "differs"
    """The numbers differ by more than a factor of three, or have no ratio; `Comparison.reason` explains why."""

    NOT_REPRODUCED = "not reproduced"
    """The published statement does not hold for the computed result, or numbers differ that should be equal."""

    IMPOSSIBLE = "cannot be reproduced"
    """The computation needs an input that was not published; `Comparison.reason` names it."""

    OURS = "ours"
    """The result was not published; the computed result is listed as context for other results."""

    MET = "met"
    """The result reaches a goal of this project."""

    MISSED = "missed"
    """The result misses a goal of this project."""


class Evidence(StrEnum):
    """What a verdict is based on. "Reproduced" is strong evidence for a computation, and none for a round trip."""

    COMPUTED = "computed"
    """The equations were solved with published inputs, or with a scene that the reason names."""

    ROUND_TRIP = "round trip"
    """The computation recovers a value that was put into it: a check of the program, not of the thesis."""

    ARITHMETIC = "arithmetic"
    """The result follows from printed numbers by elementary arithmetic, so it checks that the print is consistent."""

    QUALITATIVE = "qualitative"
    """The sign, order or shape of an effect agrees; amounts were not compared."""

    OWN_DATA = "fit of own data"
    """The result depends on records that this project simulated with assumed disturbances."""

    IMPOSSIBLE = "cannot be reproduced"
    """The computation needs an input that was not published, or the printed numbers contradict each other."""


@dataclass(frozen=True)
class Comparison:
    """A published number or statement (`published`) beside the computed number or statement (`ours`).

    Either is None if it does not exist. `id` has the form chapter/section/quantity and is unique in a chapter. `unit`
    applies to both numbers. `kind` states what the verdict is based on. `reason` explains a difference in a sentence
    without a full stop; it may be empty.

    Raises ValueError if only one of verdict and kind is "cannot be reproduced".
    """

    id: str
    published: float | str | None
    ours: float | str | None
    unit: str
    verdict: Agreement
    reason: str = ""
    _: KW_ONLY
    kind: Evidence

    def __post_init__(self) -> None:
        """Reject a comparison whose verdict and kind contradict each other."""
        if (self.verdict is Agreement.IMPOSSIBLE) is not (self.kind is Evidence.IMPOSSIBLE):
            raise ValueError(f"{self.id}: verdict {self.verdict} and kind {self.kind} contradict each other")

    @property
    def ratio(self) -> float | None:
        """Ratio of computed to published number; None if one is missing or a text, or the published number is zero."""
        if isinstance(self.published, str) or isinstance(self.ours, str) or not self.published or self.ours is None:
            return None
        return self.ours / self.published


def measured(identity: str, published: float, ours: float, unit: str, reason: str, *, kind: Evidence) -> Comparison:
    """Return the comparison of two numbers.

    The verdict is `REPRODUCED` if the numbers are equal, `SAME_ORDER` if both are positive and differ by at most a
    factor of three, else `DIFFERS`. `reason` explains the difference; it is ignored if the numbers are equal.
    """
    if ours == published:
        return Comparison(identity, published, ours, unit, Agreement.REPRODUCED, kind=kind)
    near = published > 0 and ours > 0 and max(ours / published, published / ours) <= _SAME_ORDER
    verdict = Agreement.SAME_ORDER if near else Agreement.DIFFERS
    return Comparison(identity, published, ours, unit, verdict, reason, kind=kind)


def by_evidence(comparisons: Iterable[Comparison]) -> dict[Agreement, dict[Evidence, int]]:
    """Count the comparisons by verdict and kind, both in the order of their definition; empty counts are left out."""
    counted = Counter((each.verdict, each.kind) for each in comparisons)
    return {
        verdict: {kind: counted[verdict, kind] for kind in Evidence if counted[verdict, kind]}
        for verdict in Agreement
        if any(counted[verdict, kind] for kind in Evidence)
    }
