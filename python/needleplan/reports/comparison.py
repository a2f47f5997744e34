"""Comparison of published results with computed ones."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Agreement", "Comparison", "measured"]

# Largest ratio of computed to published value (either way) that counts as the same order.
_SAME_ORDER = 3.0


class Agreement(StrEnum):
    """How well a computed result agrees with the published one."""

    REPRODUCED = "reproduced"
    """The computed number equals the published one, or the published statement holds."""

    SAME_ORDER = "same order"
    """The computed number is within a factor of three; used if machine or geometry differ from the published ones."""

    DIFFERS = "differs"
    """The computed number differs by more than a factor of three; the reason explains why."""

    NOT_REPRODUCED = "not reproduced"
    """The published statement does not hold for the computed result."""

    IMPOSSIBLE = "cannot be reproduced"
    """An input that the computation needs was not published; the reason names it."""

    OURS = "ours"
    """No published counterpart; listed as context for the other results."""

    MET = "met"
    """The result reaches a goal of this project."""

    MISSED = "missed"
    """The result misses a goal of this project."""


@dataclass(frozen=True)
class Comparison:
    """One published number or statement beside the computed one.

    `id` has the form chapter/section/quantity and is unique in a chapter. `unit` applies to both numbers. `reason`
    explains a difference: a sentence without a full stop, or empty.
    """

    id: str
    published: float | str | None
    ours: float | str | None
    unit: str
    verdict: Agreement
    reason: str = ""

    @property
    def ratio(self) -> float | None:
        """Computed over published value; None unless both are numbers and the published one is not zero."""
        if isinstance(self.published, str) or isinstance(self.ours, str) or not self.published or self.ours is None:
            return None
        return self.ours / self.published


def measured(identity: str, published: float, ours: float, unit: str, reason: str) -> Comparison:
    """Compare two numbers: reproduced if equal, same order within a factor of three, else different.

    `reason` explains the difference. It is dropped if the numbers are equal.
    """
    if ours == published:
        return Comparison(identity, published, ours, unit, Agreement.REPRODUCED)
    near = published > 0 and ours > 0 and max(ours / published, published / ours) <= _SAME_ORDER
    return Comparison(identity, published, ours, unit, Agreement.SAME_ORDER if near else Agreement.DIFFERS, reason)
