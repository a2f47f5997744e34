"""What a diagnosis says, and from where on it says it. The numbers are those of the page on diagnosis in the docs."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Gates", "Verdict"]


class Verdict(StrEnum):
    """How a diagnosis ends."""

    NONE = "none"
    """No gap was seen, and one that matters would have been."""

    UNDERPOWERED = "underpowered"
    """No gap was seen, but one that matters could hide in these data."""

    NAMED = "named"
    """What is missing has a name, and closes the gap in another motion too."""

    INCOMPLETE = "incomplete"
    """Something has a name, and a part of the gap is left."""

    AMBIGUOUS = "ambiguous"
    """There is a gap, and several effects explain it alike."""

    UNKNOWN = "unknown"
    """There is a gap, and no known effect explains it."""

    IMPLAUSIBLE = "implausible"
    """The effect that fits best would have to be larger than it can be."""


@dataclass(frozen=True)
class Gates:
    """From where on an effect is named. Gains are twice log likelihoods, balances are Schwarz' with N samples."""

    balance: float = 10.0
    balance_varied: float = 20.0
    """Where the tissue varies by more than `varied`."""

    varied: float = 0.05
    p_value: float = 0.01
    lead: float = 10.0
    """Over every other effect, and the lead of a nameless competitor that ends a name."""

    share_of_rival: float = 0.93
    """Of the gain of a nameless competitor that leads: with more, the name stays."""

    explained: float = 0.5
    """Of the gap, at least, where smooth functions see something left."""

    complete: float = 0.7
    """With less of it, what was named is not all."""

    transfer: float = 0.4
    """Of the gain that it promises on held-out trials that an effect must bring there."""

    transfer_sds: float = 2.33
    """Standard deviations by which it may fall short of the promise anyway, as one true effect in a hundred does."""

    closed: float = 0.5
    """Of the gap in held-out trials that must go, where that gap is beyond doubt."""

    further: float = 0.03
    """Of the first gain that a second or third effect must bring."""

    further_elsewhere: float = 0.005
    """The same for one of another family, where another motion confirms it: what the first one's formula misses looks
    like effects of its own family."""

    most: int = 3
    """How many names are looked for."""

    relevant: float = 1.0
    """Size, in noise RMS, that matters: where less than that would have been seen, no gap means that there is none."""

    def needed(self, level: float) -> float:
        """Return the balance that is needed in tissue that varies by `level`."""
        return self.balance_varied if level > self.varied else self.balance
