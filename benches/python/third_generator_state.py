"""One insertion of the third generator with its hidden effects, computed in stages.

drive -> tissue -> contact -> force -> whole -> sensor: effects of the stage `drive` change the position of the
needle, `tissue` that of the tissue, `contact` the bristles, `force` adds forces, `whole` changes their sum, and
`sensor` what is shown.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from third_generator_law import BaseLaw, Trial, pieces
from third_generator_motion import FINE_HZ, Array

STAGES = ("drive", "tissue", "contact", "force", "whole", "sensor")
COARSE = 20  # fine steps in a step of what is integrated over places along the shaft
PLACE_MM = 0.5  # distance of these places


class Insertion:
    """Quantities of one insertion on the fine grid; effects change them in their stage.

    `depth` is that of the tip in the tissue (mm), `slide` the travel that bends the bristles (mm), `velocity`
    its rate (mm/s), `z` the bristle, `pushed` the share of the tip force, `shaft` and `tip` the forces at full
    friction and cutting (N).
    """

    def __init__(self, trial: Trial, law: BaseLaw) -> None:
        self.trial, self.law = trial, law
        self.time, self.acceleration = trial.path.time_s, trial.path.acceleration_mm_s2
        self.depth = self.slide = trial.path.depth_mm
        self.velocity = trial.path.velocity_mm_s
        self.widths: tuple[tuple[float, float], ...] = ()
        self.z = self.pushed = self.shaft = self.tip = self.force = np.zeros(0)

    def move(self, depth: Array) -> None:
        """Let tip and shaft be elsewhere in the tissue than the stage says."""
        self.slide = self.slide + depth - self.depth
        self.depth = depth
        self.velocity = np.gradient(self.slide, 1 / FINE_HZ)

    def touch(self) -> None:
        """Bend the bristles, and compute the force of shaft and tip."""
        base = self.trial.base
        self.z = self.law.bristle(self.slide, base["presliding_mm"], self.widths)
        self.pushed = self.law.pushed(self.z)
        self.z = self.law.damped(self.z)
        self.shaft = base["friction"] * self.law.rim(self.trial.shaft_mm(self.depth))
        self.tip = self.law.tip(self.depth, base["cutting"], base["onset_mm"]) * self.trial.tip_factor(self.depth)
        self.force = self.shaft * self.z + self.tip * self.pushed

    @property
    def inside(self) -> Array:
        """Inserted length (mm)."""
        return np.maximum(self.depth, 0.0)

    @property
    def deepest(self) -> Array:
        """Largest depth so far (mm)."""
        return np.asarray(np.maximum.accumulate(self.depth))

    @property
    def rests(self) -> Array:
        """1 where the stage rests, else 0."""
        return (np.abs(self.trial.path.velocity_mm_s) < 1e-3).astype(float)

    def since_rest_began(self) -> Array:
        """Give the time since the present rest of the stage began (s); 0 while it moves."""
        index = np.arange(self.time.size)
        moving = np.maximum.accumulate(np.where(self.rests > 0, 0, index))
        return (index - moving) / FINE_HZ

    def since_turn(self) -> tuple[Array, Array]:
        """Give time (s) and travel (mm) of the stage since its last reversal."""
        depth, time = self.trial.path.depth_mm, self.time
        late, far = np.empty_like(depth), np.empty_like(depth)
        for first, last, _ in pieces(depth):
            late[first : last + 1] = time[first : last + 1] - time[first]
            far[first : last + 1] = np.abs(depth[first : last + 1] - depth[first])
        return late, far

    def along_shaft(self, history: Callable[[Array, Array], Array]) -> Array:
        """Integrate over the places that the tip has passed (mm): `history(tip in or beyond a place, travel)` by place.

        `history` takes a matrix [times, places], true where the shaft is at the place, and the travel in each
        step (mm).
        """
        depth = self.depth[::COARSE]
        places = np.arange(PLACE_MM / 2, max(float(depth.max()), 1.0), PLACE_MM)
        there = depth[:, None] > places
        travel = np.abs(np.diff(self.slide[::COARSE], prepend=self.slide[0]))
        total = (history(there, travel) * there).sum(axis=1) * PLACE_MM
        return np.interp(self.time, self.time[::COARSE], total)


def affine_scan(keep: Array, add: Array, start: float = 0.0) -> Array:
    """Give y with y[k] = keep[k] y[k-1] + add[k], in blocks of 64 steps side by side."""
    blocks = -(-keep.size // 64)
    kept, added = np.ones(blocks * 64), np.zeros(blocks * 64)
    kept[: keep.size], added[: keep.size] = keep, add
    kept, added = kept.reshape(blocks, 64).T.copy(), added.reshape(blocks, 64).T.copy()
    for row in range(1, 64):
        added[row] += kept[row] * added[row - 1]
        kept[row] *= kept[row - 1]
    befores = np.empty(blocks)
    for block, (factor, offset) in enumerate(zip(kept[-1].tolist(), added[-1].tolist(), strict=True)):
        befores[block] = start
        start = factor * start + offset
    return np.asarray((kept * befores + added).T.reshape(-1)[: keep.size])


@dataclass(frozen=True)
class Effect:
    """An effect that can be hidden.

    `draw(random, deepest depth)` gives the numbers beside the size; `low` and `high` bound the magnitude of the size;
    `signs` are the signs that occur; `limit(numbers, base)` may bound a negative size further.
    """

    name: str
    stage: str
    unit: str
    low: float
    high: float
    act: Callable[[Insertion, float, dict[str, Any]], None]
    axis: str
    also: tuple[str, ...] = ()
    draw: Callable[[np.random.Generator, float], dict[str, Any]] = lambda _rng, _deep: {}
    signs: tuple[float, ...] = (1.0,)
    limit: Callable[[dict[str, Any], dict[str, float], float], float] = lambda _numbers, _base, _deep: np.inf
    tier: str = "default"
    weight: float = 1.0


@dataclass(frozen=True)
class HiddenEffect:
    """An effect with its size and its other numbers."""

    effect: Effect
    size: float
    numbers: dict[str, Any]


def simulate(trial: Trial, law: BaseLaw, hidden: Sequence[HiddenEffect]) -> Array:
    """Give the samples of the force of a trial, without noise."""
    state = Insertion(trial, law)
    for stage in STAGES:
        if stage == "force":
            state.touch()
        for each in hidden:
            if each.effect.stage == stage:
                each.effect.act(state, each.size, each.numbers)
    return trial.sampled(state.force)
