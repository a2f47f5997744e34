"""Hidden effects that the library is about to get."""
# ruff: noqa: ARG001

import numpy as np
from second_generator_effects import breath, draw_breath
from second_generator_hidden import Numbers, uniform
from second_generator_kinds import kind
from second_generator_law import Insertion

Array = np.ndarray


def backlash(t: Insertion, d: Array, s: float, at: Numbers, n: int) -> Array:
    """Play operator: the needle moves only once the drive has crossed the gap `s`."""
    out, state = np.empty(len(d)), d[0]
    turns = t.turns.tolist()
    for first, last in zip(turns[:-1], [*turns[1:-1], len(d)], strict=True):
        piece = d[first:last]
        state_path = np.maximum(state, piece - s / 2) if piece[-1] >= piece[0] else np.minimum(state, piece + s / 2)
        out[first:last], state = state_path, state_path[-1]
    return out


def drive_stick(t: Insertion, d: Array, s: float, at: Numbers, n: int) -> Array:
    """The stage winds up by at most `s` and slips forward in teeth while it is slow."""
    slow = np.exp(-((np.abs(t.stage[1]) / at["speed_mm_s"]) ** 4))
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(t.stage[0])))])
    return d - s * slow * ((travel / (2 * s)) % 1.0) * np.sign(t.stage[1])


def guide(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return s * np.tanh(t.stage[1] / 0.15)


def two_way(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return -s * t.hold_force * np.minimum(t.grip, 0.0)


def free_breath(t: Insertion, d: Array, s: float, at: Numbers, n: int) -> Array:
    phase = np.random.default_rng([int(1e6 * at["phase_rad"]), n]).uniform(0, 2 * np.pi)
    return d - s * breath(t.time, at["frequency_hz"], phase, at["rest"])


def entry_spring(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return s * at["depth_mm"] * np.tanh(t.length / at["depth_mm"])


def ageing(t: Insertion, f: Array, s: float, at: Numbers, n: int) -> Array:
    return -s * n * t.shaft


PLANNED = (
    kind(
        "drive_backlash",
        "motion",
        "direction",
        "the needle follows by a play of width size",
        backlash,
        0.2,
        0.01,
        2,
        "mm",
        also=("phase",),
        library="planned",
    ),
    kind(
        "drive_stick",
        "motion",
        "speed",
        "the needle lags by teeth of height size below a speed",
        drive_stick,
        0.1,
        0.01,
        1,
        "mm",
        uniform(speed_mm_s=(3, 6)),
        ("position wave",),
        "planned",
    ),
    kind(
        "guide_friction",
        "law",
        "direction",
        "size tanh(v/0.15), in air too",
        guide,
        0.03,
        5e-4,
        1,
        "N",
        library="planned",
    ),
    kind(
        "direction_dependent_friction",
        "law",
        "direction",
        "C(L) (1 - size) on retraction",
        two_way,
        0.1,
        2e-3,
        0.9,
        "1",
        library="planned",
    ),
    kind(
        "breath_of_its_own_phase",
        "motion",
        "time",
        "respiration, another phase in each trial",
        free_breath,
        1,
        0.05,
        12,
        "mm",
        draw_breath,
        library="planned",
    ),
    kind(
        "entry_spring",
        "law",
        "depth",
        "size d0 tanh(L/d0), in both directions",
        entry_spring,
        0.01,
        1e-4,
        0.3,
        "N/mm",
        uniform(depth_mm=(5, 15)),
        library="planned",
    ),
    kind("ageing", "law", "trial", "C(L) (1 - size trial)", ageing, 0.1, 5e-3, 0.3, "1", library="planned"),
)
