"""Statements of section 6.4 about prioritized-partitioned value iteration, and Figs. 6.3 and 6.6.

The figures show the order in which the partitions are processed. Fig. 6.3 also shows the grid points whose states
depend on a sample partition.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from needleplan.planning import PolicyTable
from needleplan.plotting import caption, save, sheet
from needleplan.plotting.canvas import title
from needleplan.reports.comparison import Agreement, Comparison, Evidence, timed
from needleplan.scenario import Priority
from needleplan_thesis.chapter6.tables import (
    OTHER_SCENE,
    TABLE_6_2,
    VALUE_ITERATION,
    Solves,
    name_of,
    processed_states,
    solving_seconds,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray


__all__ = ["dependent_points", "draw_dependents", "draw_orders", "in_obstacles", "statements"]

_H1, _H2 = Priority.H1, Priority.H2
_ONE_SCENE = "one assumed scene; another scene may give another result"
_ONE_RUN = "a time of one run on this machine, which depends on its load"


def statements(solves: Solves) -> list[Comparison]:
    """Compare every statement of section 6.4 with the solves of this run."""
    return [
        *_beats_plain(solves),
        *_h2_beats_h1(solves),
        *_best_partitions(solves),
        _fewer_states(solves),
        _obstacles_stay_unprocessed(solves),
        _same_policy(solves),
    ]


def in_obstacles(table: PolicyTable) -> set[int]:
    """Return the indices of the partitions that contain only obstacle points."""
    nx, ny, *_ = table.scenario.shape
    columns, rows = table.scenario.partitions
    labels = np.add.outer(np.arange(nx) * columns // nx * rows, np.arange(ny) * rows // ny)
    obstacle_point = 4
    free = table.lattice.outcomes()[:, :, 0, 0] != obstacle_point
    return set(range(columns * rows)) - set(np.unique(labels[free]).tolist())


def _statement(
    what: str, published: str, computed: str, holds: bool, reason: str = _ONE_SCENE,
    kind: Evidence = Evidence.QUALITATIVE,
) -> Comparison:  # fmt: skip
    verdict = Agreement.REPRODUCED if holds else Agreement.NOT_REPRODUCED
    return Comparison(f"ch6/statement/{what}", published, computed, "", verdict, reason, kind=kind)


def _timed(what: str, published: str, here: str) -> Comparison:
    return timed(f"ch6/statement/{what}", published, f"measured here: {here}", "", _ONE_RUN)


def _beats_plain(solves: Solves) -> list[Comparison]:
    plain = solves.plain.stats
    times = {case: solving_seconds(table.stats) for case, table in solves.partitioned.items()}
    work = {case: table.stats.sweeps for case, table in solves.partitioned.items()}
    fast = [case for case in times if times[case] < solving_seconds(plain)]
    thrifty = [case for case in work if work[case] < plain.sweeps]
    best_time, best_work = min(times, key=lambda case: times[case]), min(work, key=lambda case: work[case])
    published = min(row.total_s for row in TABLE_6_2)
    why = (
        "backups do not depend on the machine; the computed number counts evaluations for priorities too, and plain "
        f"value iteration needs {plain.sweeps:.0f} sweeps instead of {VALUE_ITERATION.sweeps}; {_ONE_SCENE}"
    )
    return [
        _timed(
            "PPVI beats plain value iteration, time",
            f"6 of 6 cases, best {published:g} s against {VALUE_ITERATION.seconds:g} s",
            f"{len(fast)} of 6 cases, best {name_of(*best_time)}: {times[best_time]:.1f} s against "
            f"{solving_seconds(plain):.1f} s",
        ),
        _statement(
            "PPVI beats plain value iteration, backups",
            "yes",
            f"{len(thrifty)} of 6 cases, best {name_of(*best_work)}: {work[best_work]:.1f} sweeps against "
            f"{plain.sweeps:.1f}; worst {max(work.values()):.0f}",
            len(thrifty) == len(work),
            why,
        ),
    ]


def _h2_beats_h1(solves: Solves) -> list[Comparison]:
    stats = {case: table.stats for case, table in solves.partitioned.items()}
    sizes = list(dict.fromkeys(partitions for partitions, _ in stats))
    published = {(row.partitions, row.priority): row.total_s for row in TABLE_6_2}
    times = {p: solving_seconds(stats[p, _H2]) / solving_seconds(stats[p, _H1]) for p in sizes}
    work = {p: stats[p, _H2].backups / stats[p, _H1].backups for p in sizes}
    name = "H2 slightly outperforms H1, H2 over H1"
    return [
        _timed(f"{name}, time", _listed({p: published[p, _H2] / published[p, _H1] for p in sizes}), _listed(times)),
        _statement(
            f"{name}, backups",
            "below 1",
            _listed(work),
            all(ratio < 1 for ratio in work.values()),
            "H2 ranks by the value, which does not decay to zero, so it revisits partitions of high cost first; even "
            f"with the priority levels of this solver that costs backups; {_ONE_SCENE}",
        ),
    ]


def _best_partitions(solves: Solves) -> list[Comparison]:
    stats = {case: table.stats for case, table in solves.partitioned.items()}
    fast = min(stats, key=lambda case: solving_seconds(stats[case]))
    thrifty = min(stats, key=lambda case: stats[case].backups)
    name = "the best total time is that of (12, 8) with H2"
    return [
        _timed(f"{name}, time", "(12, 8) H2, 1363.5 s", f"{name_of(*fast)}, {solving_seconds(stats[fast]):.1f} s"),
        _statement(
            f"{name}, backups",
            "(12, 8) H2",
            f"fewest: {name_of(*thrifty)}, {stats[thrifty].sweeps:.1f} sweeps",
            thrifty == ((12, 8), _H2),
            "a backup and a priority update take about the same time in compiled code; MATLAB adds an overhead per "
            f"partition and per step; {_ONE_SCENE}",
        ),
    ]


def _fewer_states(solves: Solves) -> Comparison:
    states = {p: processed_states(table) for (p, _), table in solves.partitioned.items()}
    counts = list(states.values())
    falling = all(finer < coarser for coarser, finer in pairwise(counts))
    return _statement(
        "fewer states are processed with more partitions",
        "1,152,000 > 1,092,000 > 996,000",
        " > ".join(f"{count:,}" for count in counts) if falling else ", ".join(f"{count:,}" for count in counts),
        falling,
    )


# Unprocessed partitions of 96 (text beside Fig. 6.3, and Table 6.3).
_UNPROCESSED = 5


def _obstacles_stay_unprocessed(solves: Solves) -> Comparison:
    table = solves.partitioned[(12, 8), Priority.H1]
    left_out = set(range(table.stats.partitions)) - set(table.stats.order)
    inside = in_obstacles(table)
    return _statement(
        "partitions within obstacles, and no others, remain unprocessed, (12, 8) H1",
        "5 of 96 unprocessed",
        f"{len(left_out)} of {table.stats.partitions} unprocessed, {len(inside)} lie within an obstacle",
        left_out == inside and len(left_out) == _UNPROCESSED,
        f"the unprocessed partitions are {'' if left_out == inside else 'not '}those within obstacles; their number "
        f"depends on the obstacles; {OTHER_SCENE}",
        Evidence.COMPUTED,
    )


def _same_policy(solves: Solves) -> Comparison:
    policies = [solves.plain.policy, solves.sweep.policy, *(each.policy for each in solves.partitioned.values())]
    differing = max(int(np.count_nonzero(policy != policies[0])) for policy in policies)
    return _statement(
        "the policy does not depend on metric or partitions",
        "no discernible effect",
        f"{differing} of {policies[0].size:,} states differ at most, among 8 solves",
        differing <= policies[0].size * 1e-4,
        "",
        Evidence.COMPUTED,
    )


def _listed(ratios: dict[tuple[int, int], float]) -> str:
    return ", ".join(f"{name_of(partitions)}: {ratio:.2f}" for partitions, ratio in ratios.items())


_CYAN, _RED = "#00bcd4", "#d00000"


def dependent_points(table: PolicyTable, partition: int) -> NDArray[np.bool_]:
    """Return a mask, shape (nx, ny), of the grid points with a state from which a step can lead into `partition`.

    These are the positions of SDP(p), the state dependents of a partition (Table 6.1 of the thesis), computed from the
    transition probabilities.
    """
    nx, ny, headings, bevels = table.scenario.shape
    columns, rows = table.scenario.partitions
    labels = np.add.outer(np.arange(nx) * columns // nx * rows, np.arange(ny) * rows // ny).ravel()
    sparse = table.lattice.tabular()
    member = np.append(np.repeat(labels == partition, headings * bevels), False)
    hits = member[sparse["successors"]] & (sparse["probabilities"] > 0)
    # Cumulative counts at row and state boundaries; their differences are the counts per state.
    entries = np.concatenate([[0], np.cumsum(hits)])[sparse["row_offsets"]][sparse["action_offsets"]]
    steps_in = np.diff(entries)[: nx * ny * headings * bevels] > 0
    reaching: NDArray[np.bool_] = np.logical_or.reduce(steps_in.reshape(nx, ny, headings * bevels), axis=2)
    return reaching


def draw_dependents(axes: Axes, table: PolicyTable, partition: int) -> None:
    """Outline `partition` in red, and colour the points that `dependent_points` returns in cyan."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Rectangle

    scenario = table.scenario
    dx, dy = scenario.grid.spacing_mm
    points = dependent_points(table, partition)
    axes.imshow(
        np.ma.masked_equal(points.T, False),
        origin="lower",
        extent=(-dx / 2, scenario.x_mm[-1] + dx / 2, -dy / 2, scenario.y_mm[-1] + dy / 2),
        aspect=axes.get_aspect(),
        cmap=ListedColormap([_CYAN]),
        alpha=0.55,
        interpolation="nearest",
        zorder=2,
    )
    columns, rows = scenario.partitions
    column, row = divmod(partition, rows)
    width, height = scenario.workspace.width_mm / columns, scenario.workspace.height_mm / rows
    corner = (column * width, row * height)
    axes.add_patch(Rectangle(corner, width, height, facecolor="none", edgecolor=_RED, linewidth=2.0, zorder=5))
    axes.set_xlim(0, scenario.workspace.width_mm)
    axes.set_ylim(0, scenario.workspace.height_mm)


_SAMPLE = (8, 4)
"""Column and row (from 0) of the sample partition among (12, 8). No obstacle near it hides dependent states."""


def draw_orders(solves: Solves, folder: Path) -> None:
    """Draw Figs. 6.3 and 6.6: the order of processing with the priority H1, the default of the thesis."""
    _order(solves.partitioned[(12, 8), Priority.H1], folder / "fig_6_3.png", sample=_SAMPLE)
    _order(solves.partitioned[(24, 16), Priority.H1], folder / "fig_6_6.png", sample=None)


def _order(table: PolicyTable, file: Path, sample: tuple[int, int] | None) -> None:
    scenario = table.scenario
    columns, rows = scenario.partitions
    figure, (axes,) = sheet(scenario.workspace, 1)
    table.plot_order(axes)
    left_out = columns * rows - len(table.stats.order)
    text = (
        f"Large: rank in the order of first processing. Grey: never processed ({left_out} of {columns * rows}). "
        f"({columns}, {rows}) partitions, H1, costs of the thesis; assumed obstacles, the thesis prints none."
    )
    if sample:
        partition = sample[0] * rows + sample[1]
        draw_dependents(axes, table, partition)
        text = (
            f"Small: number of the partition. Red: partition {partition + 1}; cyan: positions of its state dependents "
            f"SDP, one step around it (the thesis shows partition 26). {text}"
        )
    title(
        axes, f"Fig. {file.stem.removeprefix('fig_').replace('_', '.')}: order of processing, ({columns}, {rows}), H1"
    )
    caption(figure, text)
    save(figure, file)
