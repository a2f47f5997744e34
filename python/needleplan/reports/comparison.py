"""A published result beside ours."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Comparison", "Verdict", "measured"]

_SAME_ORDER = 3.0


class Verdict(StrEnum):
    """What a comparison says."""

    REPRODUCED = "reproduced"
    """Ours is the published number, or the published statement holds for ours."""

    SAME_ORDER = "same order"
    """Ours is within a factor of three: all that can be asked where machine or geometry are not the published ones."""

    DIFFERS = "differs"
    """Ours is further off; the reason says why."""

    NOT_REPRODUCED = "not reproduced"
    """The published statement does not hold for ours."""

    IMPOSSIBLE = "cannot be reproduced"
    """What it takes was not published; the reason says what."""

    OURS = "ours"
    """Nothing was published; shown because it belongs beside the others."""

    MET = "met"
    """A goal of our own is reached."""

    MISSED = "missed"
    """A goal of our own is not reached."""


@dataclass(frozen=True)
class Comparison:
    """One published number or statement, ours, and why they differ where they do.

    `id` is chapter/section/what, unique in a chapter; `unit` belongs to both numbers; `reason` is a sentence without a
    full stop, empty where nothing needs a reason.
    """

    id: str
    published: float | str | None
    ours: float | str | None
    unit: str
    verdict: Verdict
    reason: str = ""

    @property
    def ratio(self) -> float | None:
        """Ours over the published number, where both are numbers and the published one is not zero."""
        if isinstance(self.published, str) or isinstance(self.ours, str) or not self.published or self.ours is None:
            return None
        return self.ours / self.published


def measured(identity: str, published: float, ours: float, unit: str, reason: str) -> Comparison:
    """Compare two numbers that need not be equal: equal, of the same order, or different; `reason` says why."""
    if ours == published:
        return Comparison(identity, published, ours, unit, Verdict.REPRODUCED)
    near = published > 0 and ours > 0 and max(ours / published, published / ours) <= _SAME_ORDER
    return Comparison(identity, published, ours, unit, Verdict.SAME_ORDER if near else Verdict.DIFFERS, reason)
