"""Axial force of an insertion without a hidden effect: the second generator's own law.

The shaft is held by elasto-plastic elements (Iwan's model): element k sticks, stretches over its yield displacement
q_k and then slides, so

    z = sum_k w_k z_k,    dz_k = dx / q_k while |z_k| < 1,    z_k = clip(z_k, -1, 1),

with yield displacements of a Gamma law of shape 2 and mean `presliding`. Unlike a Dahl bristle, the law closes its
minor loops (Masing) and has a finite presliding range. It is rate independent, hence exact in each monotone piece of
the motion and needs no step size.

The friction per length f(depth) and the force of the tip T(depth) are functions of the depth with a heterogeneity of
each trial:

    F = z C(L) + g T(d),    C(L) = int_0^L f,    T = cutting (1 - (1 + d / (n onset))^-n) (1 + field),

where L is the embedded length, n = 60, and g = (1 + z) / 2 releases the tip after a reversal. cutting / onset
is the stiffness of the tissue under the tip. All functions are evaluated at 5 kHz and averaged over the sampling
interval.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.special import gammaincinv
from second_generator_motion import FINE_HZ, Motion

ELEMENTS = 48  # elasto-plastic elements of the shaft
TIP_POWER = 60  # exponent of the force-displacement law of the tip
SHAPE = 2.0  # of the Gamma law of the yield displacements: a whole reversal is then that of a Dahl bristle
TABLE_MM = 0.1  # spacing of the table of the friction's integral over depth
DEEP_MM = 90.0  # end of that table


@dataclass(frozen=True)
class Tissue:
    """Parameters of one trial and its heterogeneity by depth.

    Attributes
    ----------
    friction, cutting, onset_mm, presliding_mm : float
        N/mm, N, mm, mm.
    shaft_field, tip_field : arrays over `depths()`
        Relative deviation of the friction per length and of the force of the tip.
    """

    friction: float
    cutting: float
    onset_mm: float
    presliding_mm: float
    shaft_field: np.ndarray = field(default_factory=lambda: np.zeros(len(depths())))
    tip_field: np.ndarray = field(default_factory=lambda: np.zeros(len(depths())))


def depths() -> np.ndarray:
    """Depths of the tables, mm."""
    return np.arange(0.0, DEEP_MM, TABLE_MM)


def turning_points(depth: np.ndarray) -> np.ndarray:
    """Indices at which the monotone pieces begin and end; rests belong to the piece before them."""
    change = np.diff(depth)
    moves = np.flatnonzero(change)
    inwards = change[moves] > 0
    turns = moves[1:][inwards[1:] != inwards[:-1]]
    return np.concatenate([[0], turns, [len(depth) - 1]])


def shares(presliding_mm: float) -> np.ndarray:
    """Yield displacements of equally strong elements, mm: quantiles of the Gamma law, mean `presliding_mm`."""
    yields = gammaincinv(SHAPE, (np.arange(ELEMENTS) + 0.5) / ELEMENTS)
    return presliding_mm * yields / yields.mean()


def elasto_plastic(depth: np.ndarray, yields: np.ndarray, turns: np.ndarray | None = None) -> np.ndarray:
    """Mean state of elements that stretch by 1 over their yield displacement and slide at -1 and 1; 0 at first."""
    state = np.zeros(len(yields))
    mean = np.zeros(len(depth))
    turns = turning_points(depth) if turns is None else turns
    for first, last in pairwise(turns):
        moved = depth[first + 1 : last + 1] - depth[first]
        # beyond the largest range every element slides: only the beginning of the piece needs all elements
        short = int(np.searchsorted(np.abs(moved), 2 * yields.max()))
        each = np.clip(state[:, None] + moved[None, : short + 1] / yields[:, None], -1.0, 1.0)
        mean[first + 1 : first + 1 + each.shape[1]] = each.mean(axis=0)
        state = each[:, -1] if each.shape[1] else state
        mean[first + 1 + each.shape[1] : last + 1] = state.mean()
    return mean


@dataclass(frozen=True)
class Insertion:
    """One trial at 5 kHz: the motion of the stage, the motion in the tissue, and the force of the law above.

    `stage` is depth, speed and acceleration of the drive. `depth` is measured in the tissue; it differs from that of
    the drive if an effect moves the tissue or the drive. `turns` are the turning points of `depth`.
    """

    motion: Motion
    tissue: Tissue
    rate_hz: int
    samples: int
    stage: tuple[np.ndarray, np.ndarray, np.ndarray]
    depth: np.ndarray
    turns: np.ndarray

    @classmethod
    def of(cls, motion: Motion, tissue: Tissue, rate_hz: int) -> "Insertion":
        """The insertion of a motion into a tissue."""
        samples = int(motion.duration_s * rate_hz) + 1
        stage = motion.at(_fine_times(samples, rate_hz))
        return cls(motion, tissue, rate_hz, samples, stage, stage[0], turning_points(stage[0]))

    def moved(self, depth: np.ndarray) -> "Insertion":
        """The same trial with another depth in the tissue."""
        return replace(self, depth=depth, turns=turning_points(depth))

    @cached_property
    def time(self) -> np.ndarray:
        """Times of the integration, s; each sampling interval is centred at its sample."""
        return _fine_times(self.samples, self.rate_hz)

    @cached_property
    def speed(self) -> np.ndarray:
        """Speed in the tissue, mm/s."""
        return np.gradient(self.depth) * FINE_HZ

    @cached_property
    def length(self) -> np.ndarray:
        """Embedded length, mm."""
        return np.maximum(self.depth, 0.0)

    @cached_property
    def deepest(self) -> np.ndarray:
        """Largest depth so far, mm."""
        return np.maximum.accumulate(self.length)

    @cached_property
    def slid(self) -> np.ndarray:
        """Path in the tissue so far, mm."""
        return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(self.depth)) * (self.depth[1:] > 0))])

    @cached_property
    def held(self) -> np.ndarray:
        """Seconds since the needle stopped; 0 while it moves."""
        still = np.abs(self.stage[1]) < 1e-9
        last = np.maximum.accumulate(np.where(still, -1, np.arange(len(still))))
        return np.where(still, (np.arange(len(still)) - last) / FINE_HZ, 0.0)

    @cached_property
    def since_hold(self) -> tuple[np.ndarray, np.ndarray]:
        """Path since the last hold in tissue (mm; large before the first), and how long that hold took (s)."""
        ends = np.flatnonzero((self.held[:-1] > 0) & (self.held[1:] == 0) & (self.depth[1:] > 0)) + 1
        path, lasted = np.full(len(self.depth), 1e6), np.zeros(len(self.depth))
        for end, following in zip(ends, np.append(ends, len(self.depth))[1:], strict=True):
            path[end:following] = self.slid[end:following] - self.slid[end]
            lasted[end:following] = self.held[end - 1]
        return path, lasted

    @cached_property
    def grip(self) -> np.ndarray:
        """State z of the shaft, -1..1."""
        return elasto_plastic(self.depth, shares(self.tissue.presliding_mm), turns=self.turns)

    @cached_property
    def push(self) -> np.ndarray:
        """State g of the tip, 0..1."""
        return (1 + self.grip) / 2

    @cached_property
    def hold_force(self) -> np.ndarray:
        """C(L), N."""
        table = depths()
        density = self.tissue.friction * (1 + self.tissue.shaft_field)
        integral = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2 * TABLE_MM)])
        return np.interp(self.length, table, integral)

    @cached_property
    def cut_force(self) -> np.ndarray:
        """T(d), N."""
        tissue = self.tissue
        shape = 1 - (1 + depths() / (TIP_POWER * tissue.onset_mm)) ** -TIP_POWER
        return tissue.cutting * np.interp(self.length, depths(), shape * (1 + tissue.tip_field))

    @cached_property
    def shaft(self) -> np.ndarray:
        """Force of the shaft, N."""
        return self.hold_force * self.grip

    @cached_property
    def tip(self) -> np.ndarray:
        """Force of the tip, N."""
        return self.cut_force * self.push

    @cached_property
    def force(self) -> np.ndarray:
        """Force without hidden effects, N."""
        return self.shaft + self.tip

    def sampled(self, fine: np.ndarray) -> np.ndarray:
        """Mean over each sampling interval."""
        return fine.reshape(self.samples, -1).mean(axis=1)

    def base_sensitivities(self) -> np.ndarray:
        """Change of the sampled force with friction, cutting, onset and presliding, (samples, 4)."""
        tissue = self.tissue
        onset = replace(self, tissue=replace(tissue, onset_mm=1.02 * tissue.onset_mm))
        sliding = replace(self, tissue=replace(tissue, presliding_mm=1.1 * tissue.presliding_mm))
        columns = (self.shaft, self.tip, onset.cut_force * self.push - self.tip, sliding.force - self.force)
        return np.column_stack([self.sampled(each) for each in columns])


def _fine_times(samples: int, rate_hz: int) -> np.ndarray:
    """Times at 5 kHz such that each sampling interval, centred at its sample, holds a whole number of them."""
    per_sample = FINE_HZ // rate_hz
    return (np.arange(samples * per_sample) + 0.5) / FINE_HZ - 0.5 / rate_hz
