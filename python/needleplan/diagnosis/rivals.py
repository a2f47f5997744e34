"""Competitors without a name: smooth functions of time, depth, speed, force and rest that any effect must beat.

A named effect is believed only where it does better than they do, each charged for its degrees of freedom. Where one of
them wins, the gap is real and its axis is known, but not what it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.interpolate import BSpline

from needleplan.diagnosis.calibrate import Case, turning
from needleplan.diagnosis.space import Space
from needleplan.models.effects import presliding_of
from needleplan.models.sliding import slid
from needleplan.signals import Array, Motion

__all__ = ["Axis", "RivalScore", "bases", "omnibus", "score_rivals"]

_AT_REST = 0.02
"""Share of the greatest speed below which the needle rests."""


class Axis(StrEnum):
    """Along what a gap lies."""

    TIME = "time"
    DEPTH = "depth"
    SPEED = "speed"
    FORCE = "force"
    HOLD = "hold"
    PERIOD = "position_periodic"


@dataclass(frozen=True)
class RivalScore:
    """A competitor: what it gains (twice the log likelihood), for how many degrees of freedom, and Schwarz' balance."""

    name: str
    axis: Axis
    gain: float
    freedom: int
    balance: float


def bases(cases: Sequence[Case]) -> dict[str, tuple[Axis, list[Array]]]:
    """Return smooth bases, raw (samples, df) for each trial, by name: one set of sizes for all trials."""
    motions = [case.motion for case in cases]
    deepest = max(float(each.depth_mm.max()) for each in motions)
    fastest = max(float(np.abs(each.velocity_mm_s).max()) for each in motions)
    longest = max(float(each.time_s[-1]) for each in motions)
    force = max(float(np.abs(case.output).max()) for case in cases) or 1.0
    found: dict[str, tuple[Axis, list[Array]]] = {}

    def add(name: str, axis: Axis, columns: list[Array]) -> None:
        used = np.vstack(columns)
        alive = np.abs(used).max(axis=0) > 1e-9
        if alive.any():
            found[name] = (axis, [each[:, alive] for each in columns])

    signs = [slid(case.motion, presliding_of(case.model)) for case in cases]
    depth = [_splines(np.clip(each.depth_mm, 0, None), 0.0, deepest, 9) for each in motions]
    inside = [np.clip(each.depth_mm, 0, None)[:, None] for each in motions]
    speed = [_splines(np.abs(each.velocity_mm_s), 0.0, fastest, 5) for each in motions]
    add("advance by depth", Axis.DEPTH, [b * ((1 + z) / 2)[:, None] for b, z in zip(depth, signs, strict=True)])
    add("retraction by depth", Axis.DEPTH, [b * ((1 - z) / 2)[:, None] for b, z in zip(depth, signs, strict=True)])
    add("depth, either way", Axis.DEPTH, depth)
    add("friction by speed", Axis.SPEED,
        [b * L * z[:, None] for b, L, z in zip(speed, inside, signs, strict=True)])  # fmt: skip
    add("force by speed", Axis.SPEED, [b * z[:, None] for b, z in zip(speed, signs, strict=True)])
    add("time", Axis.TIME, [_splines(each.time_s, 0.0, longest, 7) for each in motions])
    add("rest", Axis.HOLD, [_rests(case) for case in cases])
    add("force", Axis.FORCE, [_powers(case, force) for case in cases])
    return found


def omnibus(found: dict[str, tuple[Axis, list[Array]]]) -> list[Array]:
    """Return all bases side by side."""
    return [np.column_stack(each) for each in zip(*(columns for _, columns in found.values()), strict=True)]


def score_rivals(space: Space, cases: Sequence[Case]) -> tuple[RivalScore, ...]:
    """Return what every competitor gains in a space, the best first."""
    price = float(np.log(space.samples))
    found = []
    for name, (axis, columns) in bases(cases).items():
        gain = space.basis_gains([case.whiten(each) for case, each in zip(cases, columns, strict=True)])
        df = columns[0].shape[1]
        found.append(RivalScore(name, axis, gain, df, gain - df * price))
    found += [_best_step(space, cases, price), _best_period(space, cases, price)]
    return tuple(sorted(found, key=lambda each: -each.balance))


def _best_step(space: Space, cases: Sequence[Case], price: float) -> RivalScore:
    """A step at one time of one trial: something slipped."""
    grids = [np.arange(case.motion.time_s[0] + 0.5, case.motion.time_s[-1] - 0.4, 0.4) for case in cases]
    total = sum(map(len, grids))
    columns, first = [], 0
    for case, grid in zip(cases, grids, strict=True):
        each = np.zeros((len(case.motion), total))
        each[:, first : first + len(grid)] = case.motion.time_s[:, None] >= grid
        first += len(grid)
        columns.append(case.whiten(each))
    gains, _ = space.scores(columns).gains()
    together = np.arange(max(case.motion.time_s[0] for case in cases) + 0.5, cases[0].motion.time_s[-1] - 0.4, 0.4)
    after = [np.asarray(case.motion.time_s[:, None] >= together, float) for case in cases]
    shared, _ = space.scores([case.whiten(each) for case, each in zip(cases, after, strict=True)]).gains()
    alone, all_ = float(gains.max()) - 3 * price, float(shared.max()) - 2 * price
    if all_ >= alone:
        return RivalScore("step in time", Axis.TIME, float(shared.max()), 2, all_)
    return RivalScore("step in one trial", Axis.TIME, float(gains.max()), 3, alone)


def _best_period(space: Space, cases: Sequence[Case], price: float) -> RivalScore:
    """Something that repeats with the position: a screw, a gear."""
    lengths = np.geomspace(0.6, 25.0, 60)
    parts = []
    for case in cases:
        angle: Array = 2 * np.pi * case.motion.depth_mm[:, None] / np.asarray(lengths, float)
        parts.append((case.whiten(np.sin(angle)), case.whiten(np.cos(angle))))
    single = np.maximum(space.scores([s for s, _ in parts]).gains()[0], space.scores([c for _, c in parts]).gains()[0])
    best = -np.inf
    for index in np.argsort(-single)[:4]:
        best = max(best, space.basis_gains([np.column_stack([s[:, index], c[:, index]]) for s, c in parts]))
    return RivalScore("wave of the position", Axis.PERIOD, best, 3, best - 3 * price)


def _splines(values: Array, low: float, high: float, count: int) -> Array:
    """Return cubic B-splines on equal intervals, shape (samples, count)."""
    inner = np.linspace(low, high, count - 2)
    knots = np.concatenate([[low] * 3, inner, [high] * 3])
    return np.asarray(BSpline.design_matrix(np.clip(values, low, high * (1 - 1e-12)), knots, 3).toarray())


def _powers(case: Case, scale: float) -> Array:
    """Return powers of the force, away from where it turns round: there they would mend the moment of turning."""
    force = np.where(turning(case.motion), 0.0, case.output / scale)
    push, pull = np.maximum(force, 0), np.maximum(-force, 0)
    return np.column_stack([push, push**2, push**3, pull**2])


def _rests(case: Case) -> Array:
    """Return how the force of a rest changes since it began, for four time constants; zero in movement."""
    motion: Motion = case.motion
    fastest = float(np.abs(motion.velocity_mm_s).max())
    still = np.abs(motion.velocity_mm_s) < _AT_REST * fastest
    since = np.zeros(len(motion))
    for index in range(1, len(motion)):
        since[index] = since[index - 1] + motion.time_s[index] - motion.time_s[index - 1] if still[index] else 0.0
    scale = np.where(still, case.output, 0.0)
    return np.column_stack([scale * -np.expm1(-since / tau) for tau in (0.15, 0.6, 2.5, 10.0)])
