"""Printed and computed numbers of sections 6.2 to 6.4: size of the problem, Tables 6.2 and 6.3, plain value iteration.

The problem of section 6.4 is solved by plain value iteration, by the six settings of Table 6.2, and by sweeps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from needleplan.planning import PolicyTable, Stats, plan
from needleplan.reports.comparison import Agreement, Comparison, Evidence, measured, timed
from needleplan.scenario import Method, Priority, Scenario

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
    "Solves",
    "formula_states",
    "name_of",
    "problem",
    "processed_states",
    "solve_all",
    "solving_seconds",
    "tables",
]

STATES = 1_176_120
"""Number of states that section 6.4 prints."""

FORMULA_STATES = 1_152_000
"""Number of states by the formula of section 6.2. Table 6.3 has the same for (6, 4), with all partitions processed."""

OTHER_SCENE = "the thesis prints no coordinates of its obstacles; the scene is assumed"
OTHER_MACHINE = (
    "compiled code on a present machine, one thread; the thesis: MATLAB, Pentium IV, 2.4 GHz, 512 MB; assumed scene"
)


@dataclass(frozen=True)
class Row62:
    """A row of Table 6.2: seconds for solving partitions, for updating priorities, and in total."""

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
"""Table 6.2 as printed. The parts of (12, 8) add up to 1805.6 (H1) and 1364.5 (H2), not to the printed totals."""

TABLE_6_3 = {(6, 4): (24, 1_152_000), (12, 8): (91, 1_092_000), (24, 16): (332, 996_000)}
"""Table 6.3: processed partitions and processed states, by the number of partitions along x and y."""


@dataclass(frozen=True)
class PlainValueIteration:
    """Published results of plain value iteration in section 6.4."""

    sweeps: int
    updates: int
    seconds: float
    updates_per_second: float


# Sweeps, updates, time (s; 8 h 4 min), and updates per second.
VALUE_ITERATION = PlainValueIteration(196, 230_519_520, (8 * 60 + 4) * 60.0, 7928.5)


_SECTION = "ch6/problem"


def formula_states(scenario: Scenario) -> float:
    """Return n = 4 pi rho xmax ymax / (spacing^2 delta) of section 6.2, which omits the grid points of two edges."""
    dx, dy = scenario.grid.spacing_mm
    area = scenario.workspace.width_mm * scenario.workspace.height_mm
    return 4 * math.pi * scenario.needle.curvature_radius_mm * area / (dx * dy * scenario.step_mm)


def problem(thesis: Scenario) -> list[Comparison]:
    """Compare numbers of states and tip noise of `thesis`, a scenario with the workspace and grid of section 6.4."""
    noise = thesis.motion.tip_noise
    steps = range(1 - len(noise), len(noise))
    mean = sum(m * noise[abs(m)] for m in steps)
    deviation = math.sqrt(sum(m * m * noise[abs(m)] for m in steps) - mean**2)
    formula = round(formula_states(thesis))
    return [
        _exact(
            "n, all grid points",
            STATES,
            thesis.states,
            "states",
            "(120 + 1)(80 + 1) grid points, 60 headings, 2 bevels",
        ),
        _exact(
            "n by the formula of 6.2",
            FORMULA_STATES,
            formula,
            "states",
            "without the points of two edges, as Table 6.3",
        ),
        _exact(
            "updates of 196 sweeps",
            VALUE_ITERATION.updates,
            VALUE_ITERATION.sweeps * thesis.states,
            "backups",
            "so the sweeps of the thesis cover all grid points, whereas its Table 6.3 does not",
        ),
        _exact("mean of the noise", 0, round(mean, 9), "heading steps", ""),
        measured(
            f"{_SECTION}/deviation of the noise",
            0.85,
            round(deviation, 4),
            "heading steps",
            "the printed probabilities have sqrt(2 * 0.24 + 8 * 0.027) = 0.834; 0.85 is that of the Gaussian: "
            "its density at 0, 1, 2, scaled to sum to one, is 0.470, 0.235, 0.030",
            kind=Evidence.ARITHMETIC,
        ),
    ]


def _exact(what: str, published: float, computed: float, unit: str, reason: str) -> Comparison:
    verdict = Agreement.REPRODUCED if computed == published else Agreement.NOT_REPRODUCED
    return Comparison(f"{_SECTION}/{what}", published, computed, unit, verdict, reason, kind=Evidence.ARITHMETIC)


SolverCase = tuple[tuple[int, int], Priority]


@dataclass(frozen=True)
class Solves:
    """The policy tables of one scenario by plain value iteration, PPVI and directional sweeps.

    `partitioned` holds the tables of PPVI; its key is the number of partitions along x and y, and the priority.
    """

    plain: PolicyTable
    partitioned: dict[SolverCase, PolicyTable]
    sweep: PolicyTable


def solve_all(thesis: Scenario, note: Callable[[str], None]) -> Solves:
    """Solve `thesis` in eight ways: value iteration, sweeps, and PPVI with the six settings of Table 6.2.

    All use one thread, so that their times are comparable.
    """

    def solved(method: Method, partitions: tuple[int, int] = (1, 1), priority: Priority = Priority.H1) -> PolicyTable:
        note(f"Tables 6.2 and 6.3: {method}" + (f", {partitions}, {priority}" if method is Method.PPVI else ""))
        solver = replace(thesis.solver, method=method, partitions=partitions, priority=priority, threads=1)
        return plan(replace(thesis, solver=solver))

    return Solves(
        plain=solved(Method.VALUE_ITERATION),
        partitioned={
            (row.partitions, row.priority): solved(Method.PPVI, row.partitions, row.priority) for row in TABLE_6_2
        },
        sweep=solved(Method.SWEEP),
    )


def processed_states(table: PolicyTable) -> int:
    """Return the number of states in the processed partitions (Table 6.3)."""
    nx, ny, headings, bevels = table.scenario.shape
    columns, rows = table.scenario.partitions
    widths = np.bincount(np.arange(nx) * columns // nx, minlength=columns)
    heights = np.bincount(np.arange(ny) * rows // ny, minlength=rows)
    points = np.outer(widths, heights).ravel()
    return int(points[list(table.stats.order)].sum()) * headings * bevels


def tables(solves: Solves) -> list[Comparison]:
    """Return the comparisons of Tables 6.2 and 6.3, of plain value iteration and of directional sweeps."""
    return [*_table_6_2(solves), *_table_6_3(solves), *_plain(solves)]


def name_of(partitions: tuple[int, int], priority: str = "") -> str:
    """Return a name such as `(12, 8) H2`, as in the tables of the thesis."""
    return f"({partitions[0]}, {partitions[1]}) {priority}".strip()


def solving_seconds(stats: Stats) -> float:
    """Return the part of the time (s) that the thesis reports: solving and priorities, not geometry and evaluation."""
    return stats.seconds_solving + stats.seconds_priorities


def _table_6_2(solves: Solves) -> list[Comparison]:
    rows = []
    for row in TABLE_6_2:
        stats = solves.partitioned[row.partitions, row.priority].stats
        name = f"ch6/table 6.2/{name_of(row.partitions, row.priority)}"
        rows += [
            timed(f"{name}/ts, solving", row.solving_s, stats.seconds_solving, "s", OTHER_MACHINE),
            timed(f"{name}/tc, priorities", row.priorities_s, stats.seconds_priorities, "s", OTHER_MACHINE),
            timed(f"{name}/total", row.total_s, solving_seconds(stats), "s", OTHER_MACHINE),
            _computed(f"{name}/visits of partitions", stats.partitions_processed, "visits"),
            _computed(f"{name}/backups", stats.backups, "backups"),
        ]
    return rows


def _table_6_3(solves: Solves) -> list[Comparison]:
    rows = []
    for partitions, (processed, states) in TABLE_6_3.items():
        table = next(table for (each, _), table in solves.partitioned.items() if each == partitions)
        name = f"ch6/table 6.3/{name_of(partitions)}"
        edge = f"{OTHER_SCENE}; the computed number includes the grid points of all edges"
        rows += [
            measured(
                f"{name}/processed partitions",
                processed,
                len(table.stats.order),
                "partitions",
                OTHER_SCENE,
                kind=Evidence.COMPUTED,
            ),
            measured(
                f"{name}/processed states", states, processed_states(table), "states", edge, kind=Evidence.COMPUTED
            ),
        ]
    return rows


def _plain(solves: Solves) -> list[Comparison]:
    published, stats = VALUE_ITERATION, solves.plain.stats
    name = "ch6/section 6.4/value iteration"
    why = f"Jacobi sweeps from V = 0 to ||B|| < (1 - discount) lambda; {OTHER_SCENE}"
    rate = stats.backups / solving_seconds(stats)
    return [
        measured(f"{name}/sweeps", published.sweeps, stats.sweeps, "sweeps", why, kind=Evidence.COMPUTED),
        measured(f"{name}/updates", published.updates, stats.backups, "backups", why, kind=Evidence.COMPUTED),
        timed(f"{name}/time", published.seconds, solving_seconds(stats), "s", OTHER_MACHINE),
        timed(f"{name}/rate", published.updates_per_second, rate, "backups/s", OTHER_MACHINE),
        *_sweep(solves.sweep),
    ]


def _sweep(table: PolicyTable) -> list[Comparison]:
    name = "ch6/section 6.4/directional sweeps"
    return [
        _computed(f"{name}/sweeps", table.stats.sweeps, "sweeps"),
        _computed(f"{name}/updates", table.stats.backups, "backups"),
        _computed(f"{name}/time", solving_seconds(table.stats), "s"),
    ]


def _computed(identity: str, computed: float, unit: str) -> Comparison:
    return Comparison(identity, None, computed, unit, Agreement.OURS, "", kind=Evidence.COMPUTED)
