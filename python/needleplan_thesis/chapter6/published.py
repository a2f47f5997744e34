"""What chapter 6 of the thesis prints: numbers of sections 6.2 to 6.5, Tables 6.2 and 6.3."""

from __future__ import annotations

from dataclasses import dataclass

from needleplan.scenario import Priority

__all__ = [
    "FORMULA_STATES",
    "OTHER_MACHINE",
    "OTHER_SCENE",
    "STATES",
    "TABLE_6_2",
    "TABLE_6_3",
    "VALUE_ITERATION",
    "PlainValueIteration",
    "Row62",
]

STATES = 1_176_120
"""Section 6.4: number of states."""

FORMULA_STATES = 1_152_000
"""Table 6.3: all states at (6, 4), where every partition was processed; what the formula of section 6.2 gives."""

OTHER_SCENE = "the thesis prints no coordinates of its obstacles; the scene is ours"
OTHER_MACHINE = (
    "compiled code on today's machine, one thread; the thesis: MATLAB, Pentium IV, 2.4 GHz, 512 MB; scene ours"
)


@dataclass(frozen=True)
class Row62:
    """A row of Table 6.2: seconds for solving partitions, for updating priorities, and altogether."""

    partitions: tuple[int, int]
    priority: Priority
    solving_s: float
    priorities_s: float
    total_s: float


TABLE_6_2 = (
    Row62((6, 4), Priority.H1, 2443.2, 269.4, 2712.6),
    Row62((6, 4), Priority.H2, 2317.0, 259.9, 2576.9),
    Row62((12, 8), Priority.H1, 1115.1, 690.5, 1850.6),
    Row62((12, 8), Priority.H2, 812.2, 552.3, 1363.5),
    Row62((24, 16), Priority.H1, 700.8, 1612.1, 2312.9),
    Row62((24, 16), Priority.H2, 522.4, 1663.8, 2186.2),
)
"""As printed, although the parts of (12, 8) add up to 1805.6 (H1) and 1364.5 (H2)."""

TABLE_6_3 = {(6, 4): (24, 1_152_000), (12, 8): (91, 1_092_000), (24, 16): (332, 996_000)}
"""Table 6.3: partitions processed and processed states, by (nx, ny)."""


@dataclass(frozen=True)
class PlainValueIteration:
    """Section 6.4: the generic value iteration."""

    sweeps: int
    updates: int
    seconds: float
    updates_per_second: float


VALUE_ITERATION = PlainValueIteration(196, 230_519_520, (8 * 60 + 4) * 60.0, 7928.5)
