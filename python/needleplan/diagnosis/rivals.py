"""Competitors without a name: smooth functions of time, depth, speed, force and rest that any effect must beat.

A named effect is believed only where it does better than they do, each charged for its degrees of freedom. Where one of
them wins, the gap is real and its axis is known, but not what it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from needleplan.diagnosis.calibrate import Case
from needleplan.diagnosis.channels import measurand_of
from needleplan.diagnosis.measurand import Axis, Basis
from needleplan.diagnosis.space import Space
from needleplan.diagnosis.verdict import Gates
from needleplan.signals import Array

__all__ = ["BEGIN_S", "RivalScore", "bases", "omnibus", "score_rivals", "winner"]


BEGIN_S = 0.5
_BEFORE = 0.05
"""Time (s), and part of a trial, before the first step in time: one at its begin is no step."""


@dataclass(frozen=True)
class RivalScore:
    """A competitor: what it gains (twice the log likelihood), for how many degrees of freedom, and Schwarz' balance."""

    name: str
    axis: Axis
    gain: float
    freedom: int
    balance: float
    time_s: float | None = None
    """When, where that was chosen: the same time in all trials."""

    elsewhere: float = 0.0
    """What it brings in another motion beyond the effect that leads (twice the log likelihood); 0 where not asked."""

    @property
    def support(self) -> float:
        """What all data say for it, as far as it is compared with the effect that leads."""
        return self.balance + self.elsewhere


def winner(
    rivals: Sequence[RivalScore], gates: Gates, *, gain: float, balance: float, freedom: int, lead: float,
    elsewhere: float = 0.0,
) -> RivalScore | None:  # fmt: skip
    """Return the competitor that wins over effects with so much gain, balance and freedom, if one does.

    What is as simple as they are is one more explanation, and they must lead over it by `lead`. What is more flexible
    fits a little of everything, and must lead itself, by what the effects miss too. `elsewhere` is what they bring in
    another motion, for those competitors that were asked there.
    """
    for rival in rivals:
        simple = rival.freedom <= freedom + 1
        if simple and rival.support > balance + (elsewhere if rival.elsewhere else 0.0) - lead:
            return rival
        if rival.balance > balance + gates.lead and gain < gates.share_of_rival * rival.gain:
            return rival
    return None


def omnibus(cases: Sequence[Case]) -> list[Array]:
    """Return all bases that compete beside effects too, side by side, whitened, (n, df) for each trial."""
    found = [basis for basis in bases(cases).values() if basis.beside_effects]
    raw = [np.column_stack(each) for each in zip(*(basis.columns for basis in found), strict=True)]
    return [case.whiten(each) for case, each in zip(cases, raw, strict=True)]


def bases(cases: Sequence[Case]) -> Mapping[str, Basis]:
    """Return the competitors that the channel has."""
    return measurand_of(cases[0].model.channel).bases(cases)


def score_rivals(space: Space, cases: Sequence[Case]) -> tuple[RivalScore, ...]:
    """Return what every competitor gains in a space, the best first."""
    price = float(np.log(space.samples))
    found = []
    with_effects = space.blocks[0].shared.shape[1] > 0
    for name, basis in bases(cases).items():
        if with_effects and not basis.beside_effects:
            continue
        gain = space.basis_gains([case.whiten(each) for case, each in zip(cases, basis.columns, strict=True)])
        df = basis.columns[0].shape[1]
        found.append(RivalScore(name, basis.axis, gain, df, gain - df * price))
    found += [_best_step(space, cases, price), _best_period(space, cases, price)]
    return tuple(sorted(found, key=lambda each: -each.balance))


def _best_step(space: Space, cases: Sequence[Case], price: float) -> RivalScore:
    """A step at one time of one trial: something slipped."""
    begins = [float(case.motion.time_s[0] + max(BEGIN_S, _BEFORE * np.ptp(case.motion.time_s))) for case in cases]
    grids = [np.arange(begin, case.motion.time_s[-1] - 0.4, 0.4) for begin, case in zip(begins, cases, strict=True)]
    total = sum(map(len, grids))
    columns, first = [], 0
    for case, grid in zip(cases, grids, strict=True):
        each = np.zeros((len(case.motion), total))
        each[:, first : first + len(grid)] = case.motion.time_s[:, None] >= grid
        first += len(grid)
        columns.append(case.whiten(case.spread(each)))
    gains, _ = space.scores(columns).gains()
    together = np.arange(max(begins), cases[0].motion.time_s[-1] - 0.4, 0.4)
    after = [np.asarray(case.motion.time_s[:, None] >= together, float) for case in cases]
    shared, _ = space.scores([case.whiten(case.spread(each)) for case, each in zip(cases, after, strict=True)]).gains()
    alone, all_ = float(gains.max()) - 3 * price, float(shared.max()) - 2 * price
    if all_ >= alone:
        time_s = float(together[shared.argmax() % len(together)])
        return RivalScore("step in time", Axis.TIME, float(shared.max()), 2, all_, time_s)
    return RivalScore("step in one trial", Axis.TIME, float(gains.max()), 3, alone)


def _best_period(space: Space, cases: Sequence[Case], price: float) -> RivalScore:
    """Something that repeats with the position: a screw, a gear."""
    lengths = np.geomspace(0.6, 25.0, 60)
    parts = []
    for case in cases:
        angle: Array = 2 * np.pi * case.motion.depth_mm[:, None] / np.asarray(lengths, float)
        parts.append((case.whiten(case.spread(np.sin(angle))), case.whiten(case.spread(np.cos(angle)))))
    single = np.maximum(space.scores([s for s, _ in parts]).gains()[0], space.scores([c for _, c in parts]).gains()[0])
    best = -np.inf
    for index in np.argsort(-single)[:4]:
        best = max(best, space.basis_gains([np.column_stack([s[:, index], c[:, index]]) for s, c in parts]))
    return RivalScore("wave of the position", Axis.PERIOD, best, 3, best - 3 * price)
