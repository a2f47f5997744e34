"""Everything of chapter 6, in the order of the chapter."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from needleplan.scenario import Scenario
from needleplan.workflow.chapter6.believability import believability
from needleplan.workflow.chapter6.claims import claims
from needleplan.workflow.chapter6.problem import problem
from needleplan.workflow.chapter6.prototype import prototype
from needleplan.workflow.chapter6.solves import solve_all
from needleplan.workflow.chapter6.tables import tables

if TYPE_CHECKING:
    from needleplan.workflow.comparison import Comparison
    from needleplan.workflow.reproduce import Request

__all__ = ["run"]


def run(request: Request) -> list[Comparison]:
    """Reproduce the chapter."""
    from needleplan.workflow.reproduce import Effort

    thesis = Scenario.read("four_obstacles_thesis")
    comparisons = problem(thesis)
    if request.effort is Effort.QUICK:
        thesis = replace(thesis, grid=replace(thesis.grid, spacing_mm=(2.0, 2.0)))
    solves = solve_all(thesis, request.note)
    comparisons += [*tables(solves), *claims(solves)]
    believed, _ = believability(request)
    runs = 1000 if request.effort is Effort.QUICK else 20_000
    comparisons += [*believed, *prototype(request.note, request.effort is Effort.FULL, runs)]
    if request.effort is Effort.QUICK:
        coarse = "quick: coarse grids"
        comparisons = [replace(each, reason=f"{coarse}; {each.reason}".rstrip("; ")) for each in comparisons]
    return comparisons
