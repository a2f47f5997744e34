"""Chapter 6 of the thesis: prioritized-partitioned value iteration, Tables 6.2 and 6.3 and the figures.

The thesis prints no coordinates of its obstacles, so that counts of partitions and states depend on ours; its times
are those of MATLAB on a Pentium IV.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from needleplan.planning import plan
from needleplan.scenario import Method, Priority, Scenario
from needleplan.workflow.comparison import Comparison, Verdict

__all__ = ["run"]

_OTHER_MACHINE = "compiled code on today's machine; the thesis: MATLAB, Pentium IV, 2.4 GHz"
_OTHER_SCENE = "the thesis prints no coordinates of its obstacles; these are ours"

_TABLE_6_2 = {
    ((6, 4), Priority.H1): (2443.2, 269.4),
    ((6, 4), Priority.H2): (2317.0, 259.9),
    ((12, 8), Priority.H1): (1115.1, 690.5),
    ((12, 8), Priority.H2): (812.2, 552.3),
    ((24, 16), Priority.H1): (700.8, 1612.1),
    ((24, 16), Priority.H2): (522.4, 1663.8),
}
_TABLE_6_3 = {(6, 4): 24, (12, 8): 91, (24, 16): 332}
_STATES = 1_176_120


def run(figures: Path | None, note: Callable[[str], None]) -> list[Comparison]:
    """Reproduce the chapter; see `needleplan.workflow.reproduce.Chapter`."""
    thesis = Scenario.read("four_obstacles_thesis")
    agree = Verdict.AGREES if thesis.states == _STATES else Verdict.MISSED
    comparisons = [Comparison("ch6/section 6.4/states", _STATES, thesis.states, "states", agree, "")]
    for (partitions, priority), (solving, priorities) in _TABLE_6_2.items():
        name = f"{partitions[0]}x{partitions[1]} {priority}"
        note(f"Table 6.2, {name}")
        solver = replace(thesis.solver, method=Method.PPVI, partitions=partitions, priority=priority)
        table = plan(replace(thesis, solver=solver))
        stats = table.stats
        comparisons += [
            Comparison(
                f"ch6/table 6.2/{name}/solving", solving, stats.seconds_solving, "s", Verdict.DIFFERS, _OTHER_MACHINE
            ),
            Comparison(
                f"ch6/table 6.2/{name}/priorities",
                priorities,
                stats.seconds_priorities,
                "s",
                Verdict.DIFFERS,
                _OTHER_MACHINE,
            ),
            Comparison(
                f"ch6/table 6.3/{name}/partitions processed",
                _TABLE_6_3[partitions],
                len(stats.order),
                "partitions",
                Verdict.DIFFERS,
                _OTHER_SCENE,
            ),
        ]
        if figures:
            from needleplan.workflow.figures import order_figure, save

            save(order_figure(table), figures / f"order_{partitions[0]}x{partitions[1]}_{priority}.png")
    return comparisons
