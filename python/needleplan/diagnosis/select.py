"""Which effects are missing: one after the other, each against all others and against competitors without a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy import stats

from needleplan.diagnosis.calibrate import Calibration, Case
from needleplan.diagnosis.library import Candidates, Library
from needleplan.diagnosis.minimal import Smallest, smallest_seen
from needleplan.diagnosis.refit import Added, Joint, refit
from needleplan.diagnosis.rivals import RivalScore, score_rivals
from needleplan.diagnosis.screen import Screened, screen
from needleplan.diagnosis.space import Space
from needleplan.diagnosis.verdict import Gates
from needleplan.diagnosis.verify import Verified, verify
from needleplan.signals import Array

__all__ = ["Ranked", "Selection", "Step", "Stop", "select", "whitened_columns"]

_REFITTED = 4
_NEAR = 40.0
_NULLS = 200


class Stop(StrEnum):
    """Why no further effect was taken."""

    ACCEPTED = "accepted"
    WEAK = "weak"
    """The best one does not reach the threshold."""

    CHANCE = "chance"
    """Simulated data without an effect reach as much too often."""

    TIE = "tie"
    """Another effect explains it as well."""

    NO_TRANSFER = "no_transfer"
    """It does not hold in another motion."""

    SMALL = "small"
    """It is a small part of what the first one brought."""

    ENOUGH = "enough"
    """As many as are looked for were found."""


@dataclass(frozen=True)
class Ranked:
    """An effect, fitted together with the base and the effects before it."""

    name: str
    joint: Joint
    balance: float
    """Schwarz' balance of this effect over those before it."""


@dataclass(frozen=True)
class Step:
    """One round: what was screened, what was fitted, and how it ended."""

    screened: tuple[Screened, ...]
    rivals: tuple[RivalScore, ...]
    ranked: tuple[Ranked, ...]
    p_value: float | None
    lead: float
    verified: Verified | None
    stop: Stop

    @property
    def tied(self) -> tuple[str, ...]:
        """Effects that are as good as the best, itself among them."""
        return tuple(each.name for each in self.ranked if each.balance > self.ranked[0].balance - self.lead)


@dataclass(frozen=True)
class Selection:
    """All rounds; `joint` holds what was accepted, None where nothing was."""

    base: Space
    steps: tuple[Step, ...]
    joint: Joint | None
    verified: Verified | None
    smallest: tuple[Smallest, ...]


def select(calibration: Calibration, library: Library, gates: Gates, *, seed: int = 0) -> Selection:
    """Take effects as long as one passes all gates."""
    base = Space([case.block for case in calibration.training])
    candidates = library.candidates([case.motion for case in calibration.training])
    first = whitened_columns(calibration, library, calibration.training, candidates)
    raw = [library.columns(calibration.model, case.motion, candidates) for case in calibration.training]
    smallest = smallest_seen(base, raw, first, candidates, calibration.noise.rms)
    cases, space = calibration.training, base
    joint: Joint | None = None
    verified: Verified | None = None
    steps: list[Step] = []
    while True:
        taken = joint.added if joint else ()
        before = joint.gain if joint else 0.0
        columns = first if joint is None else whitened_columns(calibration, library, cases, candidates)
        step = _round(calibration, gates, base, space, cases, columns, candidates, taken, before, steps, seed)
        steps.append(step)
        if step.stop is not Stop.ACCEPTED:
            break
        joint, verified = step.ranked[0].joint, step.verified
        cases, space = joint.cases, joint.space
    return Selection(base, tuple(steps), joint, verified, smallest)


def _round(
    calibration: Calibration, gates: Gates, base: Space, space: Space, cases: Sequence[Case],
    columns: Sequence[Array], candidates: Sequence[Candidates], taken: tuple[Added, ...], before: float, steps: Sequence[Step], seed: int,
) -> Step:  # fmt: skip
    names = {each.effect.name for each in taken if not each.effect.repeats}
    left = [each for each in candidates if each.effect.name not in names]
    screened = tuple(each for each in screen(space, columns, candidates) if each.effect.name not in names)
    rivals = score_rivals(space, cases)
    needed = gates.balance_varied if space.level > gates.varied else gates.balance
    none = Step(screened, rivals, (), None, gates.lead, None, Stop.WEAK)
    if len(taken) >= gates.most:
        return Step(screened, rivals, (), None, gates.lead, None, Stop.ENOUGH)
    hopeful = [each for each in screened if each.balance > screened[0].balance - _NEAR][:_REFITTED]
    if screened[0].balance < needed - 5:
        return none
    price = float(np.log(space.samples))
    ranked = []
    for each in hopeful:
        joint = refit([*taken, Added(each.effect, each.values)], calibration, base)
        gain = max(joint.gain - before, 0.0)
        ranked.append(Ranked(each.effect.name, joint, gain - len(each.effect.parameters) * price))
    ranked.sort(key=lambda each: -each.balance)
    best = ranked[0]
    p_value = _chance(space, columns, left, best.balance, seed + len(taken))
    others = [each.balance for each in ranked[1:]] + [each.balance for each in screened if each not in hopeful]
    verified = verify(best.joint, calibration)

    def ended(stop: Stop) -> Step:
        return Step(screened, rivals, tuple(ranked), p_value, gates.lead, verified, stop)

    if best.balance < needed:
        return ended(Stop.WEAK)
    if p_value > gates.p_value:
        return ended(Stop.CHANCE)
    if taken and best.joint.gain - before < gates.further * steps[0].ranked[0].joint.gain:
        return ended(Stop.SMALL)
    if others and best.balance - max(others) < gates.lead:
        return ended(Stop.TIE)
    if verified is not None and not _transfers(verified, gates, steps[-1].verified if taken else None):
        return ended(Stop.NO_TRANSFER)
    return ended(Stop.ACCEPTED)


def _transfers(verified: Verified, gates: Gates, before: Verified | None) -> bool:
    kept = verified.kept - (before.kept if before else 0.0)
    if verified.promised < gates.transfer_from or before:
        return kept > 0
    return verified.transfer >= gates.transfer


def whitened_columns(
    calibration: Calibration, library: Library, cases: Sequence[Case], candidates: Sequence[Candidates]
) -> list[Array]:
    """Return every candidate along every trial, whitened."""
    columns = [case.whiten(library.columns(calibration.model, case.motion, candidates)) for case in cases]
    for each in candidates:
        if each.effect.is_lag:  # the lag that was calibrated and one more are not the same as one that is longer
            for case, whitened in zip(cases, columns, strict=True):
                whitened[:, each.first] = case.lag_column
    return columns


def _chance(
    space: Space, columns: Sequence[Array], candidates: Sequence[Candidates], balance: float, seed: int
) -> float:
    """Return how often data without an effect reach such a balance: Gumbel's law, fitted to simulated data."""
    price = float(np.log(space.samples))
    keep = np.concatenate([np.arange(each.first, each.last) for each in candidates])
    penalty = np.concatenate([np.full(len(each.grid), each.count * price) for each in candidates])
    signs = np.concatenate([np.full(len(each.grid), each.sign) for each in candidates])
    maxima = space.null_maxima([each[:, keep] for each in columns], penalty, signs, _NULLS, seed)
    scale = float(maxima.std(ddof=1)) * np.sqrt(6) / np.pi
    place = float(maxima.mean()) - np.euler_gamma * scale
    return float(stats.gumbel_r.sf(balance, place, scale))
