"""Everything of chapter 6, in the order of the chapter."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from needleplan.reports.chapters import Effort
from needleplan.scenario import Scenario
from needleplan_thesis.chapter6.believability import believability
from needleplan_thesis.chapter6.claims import claims
from needleplan_thesis.chapter6.experiments import experiments
from needleplan_thesis.chapter6.orders import orders
from needleplan_thesis.chapter6.paths import paths
from needleplan_thesis.chapter6.phantom import phantom
from needleplan_thesis.chapter6.problem import problem
from needleplan_thesis.chapter6.prototype import prototype
from needleplan_thesis.chapter6.solves import solve_all
from needleplan_thesis.chapter6.tables import tables

if TYPE_CHECKING:
    from needleplan.reports.chapters import Request
    from needleplan.reports.comparison import Comparison

__all__ = ["files", "run"]

_SEEDS, _FEW = 100, 2


def files(request: Request) -> tuple[str, ...]:
    """Return the names of the files that `run` writes into its folder."""
    if request.experiments:
        return "fig_6_7_lab.png", "fig_6_8_lab.png", "fig_6_9_lab.png"
    figures = ("6_3", "6_4", "6_5", "6_5_literal", "6_6", "6_7", "6_8", "6_9")
    return "predicted_realised.csv", "predicted_realised.png", *(f"fig_{each}.png" for each in figures)


def run(request: Request) -> list[Comparison]:
    """Reproduce the chapter, or its experiments alone; figures and predicted_realised.csv where there is a folder."""
    if request.experiments:
        return experiments(request.folder, request.note, _FEW if request.effort is Effort.QUICK else _SEEDS)
    quick, full = request.effort is Effort.QUICK, request.effort is Effort.FULL
    thesis = Scenario.read("four_obstacles_thesis")
    comparisons = problem(thesis)
    if quick:
        thesis = replace(thesis, grid=replace(thesis.grid, spacing_mm=(2.0, 2.0)))
    solves = solve_all(thesis, request.note)
    if request.folder:
        orders(solves, request.folder)
    believed = believability(request)
    measured = [*tables(solves), *claims(solves), *believed]
    if quick:
        measured = [replace(each, reason=f"quick: coarse grids; {each.reason}".rstrip("; ")) for each in measured]
    return [
        *comparisons,
        *measured,
        *prototype(request.note, fine=full, runs=1000 if quick else 20_000),
        *paths(request.folder, request.note),
        *phantom(request.folder, request.note, fine=full),
    ]
