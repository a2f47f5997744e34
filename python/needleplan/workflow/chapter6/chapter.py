"""Everything of chapter 6, in the order of the chapter."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from needleplan.scenario import Scenario
from needleplan.workflow.chapter6.claims import claims
from needleplan.workflow.chapter6.problem import problem
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
    if request.effort is Effort.QUICK:
        coarse = "a quick run on coarse grids: the numbers do not count"
        comparisons = [replace(each, reason=f"{coarse}; {each.reason}".rstrip("; ")) for each in comparisons]
    return comparisons
