"""From what was selected to a verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis.measurand import Axis
from needleplan.diagnosis.refit import Joint
from needleplan.diagnosis.rivals import RivalScore, omnibus, winner
from needleplan.diagnosis.select import Selection
from needleplan.diagnosis.size import is_possible
from needleplan.diagnosis.step import Stop
from needleplan.diagnosis.verdict import Gates, Verdict
from needleplan.diagnosis.verify import Verified
from needleplan.models.effects import SIZE

__all__ = ["Decision", "decide"]

_STRONG = 3.0
"""Multiple of the threshold from which an effect that does not hold elsewhere still shows a gap."""

_FEW = 40.0
"""Gap from which on the share of it that is explained means something."""


_PART = 0.1
"""Of a gap in another motion that a name must close there at least, however well it keeps its word."""

_WORD = 0.3
"""Of what is promised that may be missing, or come on top, where nothing but the named effects speaks."""

_SURE = 5.0
"""Standard deviations from which on a gap in held-out trials is beyond doubt."""


@dataclass(frozen=True)
class Decision:
    """The verdict, and what speaks for it."""

    verdict: Verdict
    named: tuple[str, ...]
    tied: tuple[str, ...]
    """Where it is ambiguous, the effects between which it is."""

    axis: Axis | None
    """Along what the gap lies, where it has no name."""

    explained: float | None
    """Part of the gap that the named effects explain: of what they bring and smooth functions still see beside them."""

    because: str


def decide(selection: Selection, gates: Gates, *, seen: float) -> Decision:
    """Return the verdict. `seen` is the largest size, in noise RMS, that some effect could have unseen."""
    last, first = selection.steps[-1], selection.steps[0]
    rival = first.rivals[0]
    if selection.joint is None:
        if last.stop is Stop.TIE:
            if _winner(last.ranked[0].joint, last.ranked[0].balance, 0.0, first.rivals, gates):
                return _unknown(rival.axis, "a smooth function without a name explains more than any known effect")
            text = "these effects explain the gap alike: " + ", ".join(last.tied)
            return Decision(Verdict.AMBIGUOUS, (), last.tied, None, None, text)
        unsupported = last.stop is Stop.NO_TRANSFER and last.ranked[0].balance > _STRONG * gates.balance
        if rival.balance >= gates.needed(selection.base.level) or unsupported:
            if last.stop is Stop.NO_TRANSFER and last.ranked[0].balance > rival.balance:
                return _unknown(rival.axis, f"{last.ranked[0].name} fits best, but does not hold in another motion")
            return _unknown(rival.axis, "a smooth function without a name explains what no known effect does")
        if seen > gates.relevant:
            return Decision(Verdict.UNDERPOWERED, (), (), None, None, "no gap, but an effect that matters could hide")
        return Decision(Verdict.NONE, (), (), None, None, "no gap: what the model leaves is noise")
    joint = selection.joint
    # One effect may be at several places, and has one name.
    names = tuple(dict.fromkeys(each.effect.name for each in selection.sure))
    all_ = ", ".join(dict.fromkeys(each.effect.name for each in joint.added))
    better = _winner(joint, selection.balance, _more_elsewhere(selection), first.rivals, gates)
    if better:
        return _unknown(better.axis, f"{all_} fits, but so does what has no name: {better.name}")
    other = selection.verified
    if other and other.gap_sds > _SURE and other.shrink < gates.closed:
        text = f"{all_} fits, but closes {max(other.shrink, 0.0):.0%} of the gap in another motion only"
        if not names or other.shrink < _PART or not _keeps_its_word(other):
            return _unknown(rival.axis, text)
        return Decision(Verdict.INCOMPLETE, names, last.tied, last.rivals[0].axis, _explained(selection), text)
    share = _explained(selection)
    remaining = last.rivals[0]
    for index, each in enumerate(joint.added):
        if not is_possible(joint, index):
            what = each.effect.parameters[SIZE]
            text = f"{each.effect.name} would have to be as large as it can be, {each.values[SIZE]:.3g} {what.unit}"
            return Decision(Verdict.IMPLAUSIBLE, names, (), None, share, text)
    if share is not None and share < gates.explained and remaining.balance > gates.balance:
        return _unknown(remaining.axis, f"{all_} explains {share:.0%} of the gap only", share)
    left = remaining.balance > gates.balance and share is not None and share < gates.complete
    if not names:
        text = "more than one effect is missing, and others explain as much: " + ", ".join(last.tied)
        return Decision(Verdict.AMBIGUOUS, (), last.tied, None, share, text)
    if left or last.stop in (Stop.TIE, Stop.NAMELESS):
        return Decision(Verdict.INCOMPLETE, names, last.tied, remaining.axis, share, "something else is missing too")
    return Decision(Verdict.NAMED, names, (), None, share, "passes all gates")


def _keeps_its_word(seen: Verified) -> bool:
    """Whether effects bring in another motion what they promise there, neither less nor more."""
    return bool(abs(seen.kept - seen.promised) < max(_WORD * seen.promised, 4 * math.sqrt(seen.promised)))


def _unknown(axis: Axis, text: str, share: float | None = None) -> Decision:
    return Decision(Verdict.UNKNOWN, (), (), axis, share, text)


def _more_elsewhere(selection: Selection) -> float:
    """Return what all effects bring in another motion beyond the first one, with which competitors were compared."""
    best, whole = selection.steps[0].ranked[0].verified, selection.verified
    return whole.gain - best.gain if whole and best else 0.0


def _winner(
    joint: Joint, balance: float, elsewhere: float, rivals: Sequence[RivalScore], gates: Gates
) -> RivalScore | None:
    """Return the competitor without a name that wins over effects; a name must lead over it as over another effect."""
    return winner(
        rivals, gates, gain=joint.gain, balance=balance, freedom=len(joint.names), lead=gates.lead, elsewhere=elsewhere
    )


def _explained(selection: Selection) -> float | None:
    """Return what the effects bring over that and what smooth functions then still see.

    Both are of one likelihood, so the gap is their sum. What smooth functions see of the gap alone is not: a sharp
    effect, a puncture, is nearly nothing to them.
    """
    assert selection.joint is not None
    joint = selection.joint
    columns = omnibus(joint.cases)
    left = max(joint.space.basis_gains(columns) - columns[0].shape[1], 0.0)
    if joint.gain + left < _FEW:
        return None
    return float(np.clip(joint.gain / (joint.gain + left), 0.0, 1.0))
