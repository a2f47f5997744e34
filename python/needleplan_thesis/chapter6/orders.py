"""Figs. 6.3 and 6.6: in which order the partitions were processed, and who depends on one of them."""

from __future__ import annotations

from pathlib import Path

from needleplan.planning import PolicyTable
from needleplan.plotting import caption, save, sheet
from needleplan.plotting.canvas import title
from needleplan.scenario import Priority
from needleplan_thesis.chapter6.dependents import draw_dependents
from needleplan_thesis.chapter6.solves import Solves

__all__ = ["orders"]

_SAMPLE = (8, 4)
"""Column and row of the sample partition among (12, 8), from 0: in the open, so that its dependents are seen."""


def orders(solves: Solves, folder: Path) -> None:
    """Draw both figures; H1 is the default of the thesis."""
    _order(solves.partitioned[(12, 8), Priority.H1], folder / "fig_6_3.png", sample=_SAMPLE)
    _order(solves.partitioned[(24, 16), Priority.H1], folder / "fig_6_6.png", sample=None)


def _order(table: PolicyTable, file: Path, sample: tuple[int, int] | None) -> None:
    scenario = table.scenario
    columns, rows = scenario.partitions
    figure, (axes,) = sheet(scenario.workspace, 1)
    table.plot_order(axes)
    left_out = columns * rows - len(table.stats.order)
    text = (
        f"Large: place in the order of first processing. Grey: never processed ({left_out} of {columns * rows}). "
        f"({columns}, {rows}) partitions, H1, costs of the thesis; the obstacles are ours, the thesis prints none."
    )
    if sample:
        partition = sample[0] * rows + sample[1]
        draw_dependents(axes, table, partition)
        text = (
            f"Small: number of the partition. Red: partition {partition + 1}; cyan: where its state dependents SDP "
            f"lie, a step around it (the thesis shows its number 26). {text}"
        )
    title(
        axes, f"Fig. {file.stem.removeprefix('fig_').replace('_', '.')}: order of processing, ({columns}, {rows}), H1"
    )
    caption(figure, text)
    save(figure, file)
