"""Comparison of published results with computed results."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum

from needleplan.artifacts import CallRepr

__all__ = ["SAME_ORDER_FACTOR", "Agreement", "Comparison", "Evidence", "Origin", "by_evidence", "measured", "timed"]

SAME_ORDER_FACTOR = 3.0
"""Largest factor between computed and published number that counts as the same order of magnitude."""


class Agreement(StrEnum):
    """How well a computed result agrees with the published one."""

    REPRODUCED = "reproduced"
    """The computed number equals the published number within its accuracy, or the published statement holds."""

    SAME_ORDER = "same order"
    """The numbers agree within `SAME_ORDER_FACTOR`. The verdict is printed with its factor, `Comparison.factor`."""

    DIFFERS = "differs"
    """The numbers differ by more than a factor of three, or have no ratio; `Comparison.reason` explains why."""

    NOT_REPRODUCED = "not reproduced"
    """The published statement does not hold for the computed result, or numbers differ that should be equal."""

    IMPOSSIBLE = "cannot be reproduced"
    """The computation needs an input that was not published; `Comparison.reason` names it."""

    UNJUDGED = "no verdict"
    """The result is a duration: it depends on the machine and its load, so it is measured and not judged."""

    OURS = "ours"
    """The result was not published; the computed result is listed as context for other results."""

    MET = "met"
    """The result reaches a goal of this project."""

    MISSED = "missed"
    """The result misses a goal of this project."""


class Origin(StrEnum):
    """Where the number or statement comes from that a computed result is compared with."""

    THESIS = "thesis"
    """The thesis prints it; `Comparison.source` names line, table, row and column."""

    EARLIER = "earlier computation"
    """An earlier program of this project computed it. Agreement is no evidence about the thesis."""

    GOAL = "own goal"
    """This project set it as a goal. Meeting it is no evidence about the thesis."""

    NONE = "none"
    """There is none; the computed result is context for other results."""


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
class Comparison(CallRepr):
    """A number or statement (`published`) beside the computed number or statement (`ours`).

    Either is None if it does not exist. `origin` says where `published` comes from: the thesis, or, if `earlier`, an
    earlier computation of this project. A goal of this project stands in `reason`, never in `published`.

    `id` has the form chapter/section/quantity and is unique in a chapter. `unit` applies to both numbers. `kind`
    states what the verdict is based on. `reason` explains a difference in a sentence without a full stop; it may be
    empty. `source` cites the thesis: place, line of its text, row and column.

    Raises ValueError if only one of verdict and kind is "cannot be reproduced", or a goal has a published number.
    """

    id: str
    published: float | str | None
    ours: float | str | None
    unit: str
    verdict: Agreement
    reason: str = ""
    _: KW_ONLY
    kind: Evidence
    source: str = ""
    earlier: bool = False

    def __post_init__(self) -> None:
        """Reject a comparison whose fields contradict each other."""
        if (self.verdict is Agreement.IMPOSSIBLE) is not (self.kind is Evidence.IMPOSSIBLE):
            raise ValueError(f"{self.id}: verdict {self.verdict} and kind {self.kind} contradict each other")
        if self.origin is Origin.GOAL and self.published is not None:
            raise ValueError(f"{self.id}: the verdict {self.verdict} is about a goal, but a published number is given")

    @property
    def origin(self) -> Origin:
        """Where the published number or statement comes from."""
        if self.verdict in (Agreement.MET, Agreement.MISSED):
            return Origin.GOAL
        if self.earlier:
            return Origin.EARLIER
        if self.verdict is Agreement.OURS and self.published is None:
            return Origin.NONE
        return Origin.THESIS

    @property
    def ratio(self) -> float | None:
        """Ratio of computed to published number; None if one is missing or a text, or the published number is zero."""
        if isinstance(self.published, str) or isinstance(self.ours, str) or not self.published or self.ours is None:
            return None
        return self.ours / self.published

    @property
    def factor(self) -> float | None:
        """Factor, at least 1, between computed and published number; None without a positive ratio."""
        ratio = self.ratio
        return max(ratio, 1 / ratio) if ratio and ratio > 0 else None


def measured(
    identity: str,
    published: float,
    ours: float,
    unit: str,
    reason: str,
    *,
    kind: Evidence,
    earlier: bool = False,
) -> Comparison:
    """Return the comparison of two numbers.

    The verdict is `REPRODUCED` if the numbers are equal, `SAME_ORDER` if both are positive and differ by at most
    `SAME_ORDER_FACTOR`, else `DIFFERS`. `reason` explains the difference; it is ignored if the numbers are equal.
    """
    if ours == published:
        return Comparison(identity, published, ours, unit, Agreement.REPRODUCED, kind=kind, earlier=earlier)
    near = published > 0 and ours > 0 and max(ours / published, published / ours) <= SAME_ORDER_FACTOR
    verdict = Agreement.SAME_ORDER if near else Agreement.DIFFERS
    return Comparison(identity, published, ours, unit, verdict, reason, kind=kind, earlier=earlier)


def timed(identity: str, published: float | str, ours: float | str, unit: str, reason: str) -> Comparison:
    """Return a published duration (or rate) beside the one of this run, without a verdict."""
    return Comparison(identity, published, ours, unit, Agreement.UNJUDGED, reason, kind=Evidence.COMPUTED)


def by_evidence(comparisons: Iterable[Comparison]) -> dict[Agreement, dict[Evidence, int]]:
    """Count the comparisons by verdict and kind, both in the order of their definition; empty counts are left out."""
    counted = Counter((comparison.verdict, comparison.kind) for comparison in comparisons)
    return {
        verdict: {kind: counted[verdict, kind] for kind in Evidence if counted[verdict, kind]}
        for verdict in Agreement
        if any(counted[verdict, kind] for kind in Evidence)
    }
