"""Everything of chapter 5, in the order of the chapter."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from needleplan.reports.chapters import Effort
from needleplan_thesis.chapter5.table51 import table51
from needleplan_thesis.chapter5.table52 import table52
from needleplan_thesis.chapter5.table53 import table53

if TYPE_CHECKING:
    from needleplan.reports.chapters import Request
    from needleplan.reports.comparison import Comparison

__all__ = ["files", "run"]

_STEPS_MM = {Effort.QUICK: 4.0, Effort.DEFAULT: 1.0, Effort.FULL: 0.5}


def files(_: Request) -> tuple[str, ...]:
    """Return the names of the files that `run` writes into its folder."""
    return ("fig_5_1.png", "fig_5_2.png")


def run(request: Request) -> list[Comparison]:
    """Reproduce the chapter; fig_5_1.png and fig_5_2.png where there is a folder."""
    step = _STEPS_MM[request.effort]
    request.note("Tables 5.1 and 5.2")
    comparisons = [*table51(), *table52(step)]
    request.note("Table 5.3")
    comparisons += table53(step)
    if request.folder:
        from needleplan_thesis.chapter5.figures import figure_5_1, figure_5_2

        request.note("Figs. 5.1 and 5.2")
        figure_5_1(request.folder, step)
        figure_5_2(request.folder, step)
    if request.effort is Effort.QUICK:
        comparisons = [
            replace(each, reason=f"quick: steps of 4 mm; {each.reason}".rstrip("; ")) for each in comparisons
        ]
    return comparisons
