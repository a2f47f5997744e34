"""One round of a selection: what was screened, what was fitted, how each did elsewhere, and how the round ended."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from needleplan.diagnosis.refit import Joint
from needleplan.diagnosis.rivals import RivalScore
from needleplan.diagnosis.screen import Screened
from needleplan.diagnosis.verify import Verified

__all__ = ["Ranked", "Step", "Stop", "as_good"]


class Stop(StrEnum):
    """Why no further effect was taken."""

    ACCEPTED = "accepted"
    WEAK = "weak"
    """The best one does not reach the threshold, or its size may be zero."""

    CHANCE = "chance"
    """Simulated data without an effect reach as much too often."""

    TIE = "tie"
    """Another effect explains it as well."""

    NO_TRANSFER = "no_transfer"
    """It does not hold in another motion."""

    SMALL = "small"
    """It is a small part of what the first one brought."""

    NAMELESS = "nameless"
    """What has no name does better in its place, beside the others."""

    ENOUGH = "enough"
    """As many as are looked for were found."""


@dataclass(frozen=True)
class Ranked:
    """An effect, fitted together with the base and the effects before it."""

    name: str
    joint: Joint
    gain: float
    """Twice the log likelihood over those before it."""

    balance: float
    """Schwarz' balance of this effect over those before it."""

    verified: Verified | None = None
    """How it does in another motion, beside those before it; None where it was not asked, or there is none."""

    vetoed: bool = False
    """Whether it does not hold there."""

    @property
    def kept(self) -> float:
        """What it brings there over those before it: twice the log likelihood of data that it was not fitted to."""
        return self.verified.gain if self.verified else 0.0

    @property
    def support(self) -> float:
        """What all data say for it: the balance of the fitted ones, and the gain in those that were held out."""
        return self.balance + self.kept


@dataclass(frozen=True)
class Step:
    """One round: what was screened, what was fitted, and how it ended."""

    screened: tuple[Screened, ...]
    rivals: tuple[RivalScore, ...]
    ranked: tuple[Ranked, ...]
    p_value: float | None
    stop: Stop
    tied: tuple[str, ...] = ()
    """Effects of which one is to be chosen, the best among them: each is as good as the best, and adds little to it."""


def as_good(best: Ranked, other: Ranked, lead: float) -> bool:
    """Whether all data together do not tell two effects apart, or those that were fitted speak for the other one."""
    fits_better = not other.vetoed and other.balance > best.balance + lead
    return bool(other.support > best.support - lead or fits_better)
