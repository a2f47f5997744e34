"""A published result beside ours."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Comparison", "Verdict"]


class Verdict(StrEnum):
    """What a comparison says."""

    AGREES = "agrees"
    """Ours is the published number, or the published statement holds for ours."""

    DIFFERS = "differs"
    """Ours differs for a reason that is given: another machine, another geometry."""

    MISSED = "missed"
    """Ours should agree and does not."""


@dataclass(frozen=True)
class Comparison:
    """One published number or statement, ours, and why they differ where they do."""

    id: str
    published: float | str | None
    ours: float | str | None
    unit: str
    verdict: Verdict
    reason: str
