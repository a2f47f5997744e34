"""Entry point of `needleplan reproduce ch6`; predicted costs of five entries compared with an independent prototype.

The prototype measured how rounding and interpolation change the expected cost. Its scene had four obstacles, a rotation
cost of 4, failure costs of 10,000 and 20,000, and no discount; the policy of the nearest state was executed 20,000
times per entry. Its notes do not say which failure has which cost. With 20,000 for a collision and 10,000 for an exit,
the computed values on the nearest-point grid equal those of the prototype to the last digit; with exchanged costs they
do not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from needleplan.planning import PolicyTable
from needleplan.reports.chapters import Effort
from needleplan.reports.comparison import Comparison, Evidence, measured
from needleplan.scenario import Scenario, Transition
from needleplan_thesis.chapter6.entries import ExecutionRule, execute, planned, predicted_and_realised, sampled
from needleplan_thesis.chapter6.partitions import draw_orders, statements
from needleplan_thesis.chapter6.paths import paths
from needleplan_thesis.chapter6.phantom import experiments, phantom
from needleplan_thesis.chapter6.tables import problem, solve_all, tables
from needleplan_thesis.citations import cited

if TYPE_CHECKING:
    from needleplan.reports.chapters import Request
    from needleplan.reports.comparison import Comparison

__all__ = ["COARSE", "ENTRIES", "FINE", "PrototypeResult", "files", "prototype", "run"]

# Insertions per experiment: default and full effort, and quick effort.
_SEEDS, _FEW = 100, 2


def files(request: Request) -> tuple[str, ...]:
    """Return the names of the files that `run` writes into the output folder."""
    if request.experiments:
        return "fig_6_7_lab.png", "fig_6_8_lab.png", "fig_6_9_lab.png"
    figures = ("6_3", "6_4", "6_5", "6_5_literal", "6_6", "6_7", "6_8", "6_9")
    return "predicted_realised.csv", "predicted_realised.png", *(f"fig_{figure}.png" for figure in figures)


def run(request: Request) -> list[Comparison]:
    """Return the comparisons of the chapter, or, if `request.experiments`, those of the experiments in the lab twin.

    Writes figures and a CSV file if the request names a folder.
    """
    if request.experiments:
        seeds = _FEW if request.effort is Effort.QUICK else _SEEDS
        return cited(experiments(request.folder, request.note, seeds))
    quick, full = request.effort is Effort.QUICK, request.effort is Effort.FULL
    thesis = Scenario.read("four_obstacles_thesis")
    comparisons = problem(thesis)
    if quick:
        thesis = replace(thesis, grid=replace(thesis.grid, spacing_mm=(2.0, 2.0)))
    solves = solve_all(thesis, request.note)
    if request.folder:
        draw_orders(solves, request.folder)
    predictions = predicted_and_realised(request)
    measured = [*tables(solves), *statements(solves), *predictions]
    if quick:
        measured = [replace(each, reason=f"quick: coarse grids; {each.reason}".rstrip("; ")) for each in measured]
    return cited([
        *comparisons,
        *measured,
        *prototype(request.note, fine=full, runs=1000 if quick else 20_000),
        *paths(request.folder, request.note),
        *phantom(request.folder, request.note, fine=full),
    ])  # fmt: skip


ENTRIES = ((0, 40, 0), (0, 60, -18), (0, 45, 18), (0, 35, -18), (0, 50, 0))
"""The five entries: x_mm, y_mm, heading_deg. The bevel of each is the one with the lower cost."""


@dataclass(frozen=True)
class PrototypeResult:
    """Results of the prototype on one grid: predicted and realised cost, and realised success, by entry."""

    transition: Transition
    spacing_mm: float
    predicted: tuple[int, ...]
    realised: tuple[int, ...]
    success: tuple[float, ...]


_NEAREST, _INTERPOLATED = Transition.NEAREST, Transition.INTERPOLATED
# Results of the prototype on grids that every effort computes (COARSE), and on grids of the full effort only (FINE).
COARSE = (
    PrototypeResult(_NEAREST, 1.0, (1113, 4217, 5550, 1635, 2639), (1221, 4818, 5992, 1376, 3233),
             (0.912, 0.678, 0.569, 0.909, 0.812)),
    PrototypeResult(_INTERPOLATED, 1.0, (1341, 5269, 6539, 1681, 3847), (963, 4552, 5763, 1268, 2979),
             (0.934, 0.685, 0.554, 0.920, 0.820)),
    PrototypeResult(_INTERPOLATED, 0.5, (955, 4201, 5711, 1274, 2866), (881, 4069, 5586, 1139, 2816),
             (0.942, 0.729, 0.601, 0.929, 0.834)),
)  # fmt: skip
FINE = (
    PrototypeResult(_NEAREST, 0.25, (818, 3819, 5412, 1098, 2571), (892, 4061, 5468, 1184, 3023),
             (0.941, 0.741, 0.581, 0.928, 0.827)),
    PrototypeResult(_INTERPOLATED, 0.25, (875, 3845, 5441, 1149, 2584), (843, 3999, 5534, 1143, 2777),
             (0.945, 0.742, 0.575, 0.930, 0.839)),
)  # fmt: skip

_OTHER_ARCS = "executions differ by chance and by the number of tested points per arc: 4 here"
_OTHER_CORNERS = "the prototype treats cells at obstacles and at the border as slightly more costly"


def prototype(note: Callable[[str], None], fine: bool, runs: int) -> list[Comparison]:
    """Compare predicted cost and realised success with the results of the prototype. `fine` adds grids of 0.25 mm."""
    four = sampled("four_obstacles")
    scenario = replace(four, objective=replace(four.objective, collision=20_000.0, exit=10_000.0))
    comparisons = []
    for published in COARSE + FINE if fine else COARSE:
        note(f"five entries: {published.transition}, {published.spacing_mm:g} mm")
        comparisons += _compared(published, planned(scenario, published.transition, published.spacing_mm), runs)
    return comparisons


def _compared(published: PrototypeResult, table: PolicyTable, runs: int) -> list[Comparison]:
    entries = np.array([table.start((x, y, math.radians(degrees))) for x, y, degrees in ENTRIES], dtype=np.float64)
    predicted = table.lookup_many(entries, nearest=True).value
    study = execute("four_obstacles", table, entries, ExecutionRule(), runs)
    comparisons = []
    for k, (x, y, degrees) in enumerate(ENTRIES):
        name = f"ch6/five entries/{published.transition} {published.spacing_mm:g} mm, ({x}, {y}) mm, {degrees} deg"
        comparisons += [
            measured(f"{name}/predicted cost", published.predicted[k], round(float(predicted[k])), "cost",
                     _OTHER_CORNERS, kind=Evidence.COMPUTED, earlier=True),
            measured(f"{name}/realised success", published.success[k], float(study.realised[k]), "1", _OTHER_ARCS,
                     kind=Evidence.COMPUTED, earlier=True),
        ]  # fmt: skip
    return comparisons
