"""The figures of the commands, ready to save."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from needleplan.planning import Path, PolicyTable
from needleplan.planning.drawing.partitions import draw_partition_order
from needleplan.planning.drawing.scene import draw_noisy, draw_path, draw_scene
from needleplan.planning.drawing.success_map import draw_success_map
from needleplan.plotting.canvas import sheet, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["order_figure", "path_figure", "plan_figure"]


def plan_figure(table: PolicyTable, path: Path, noisy: Sequence[Path] = ()) -> Figure:
    """Return the execution from one entry beside the success map of the whole workspace."""
    figure, (left, right) = sheet(table.scenario.workspace, 2)
    _draw_executions(left, table, path, noisy)
    draw_success_map(right, table)
    return figure


def path_figure(table: PolicyTable, path: Path, noisy: Sequence[Path] = ()) -> Figure:
    """Return one execution in the workspace."""
    figure, (axes,) = sheet(table.scenario.workspace, 1)
    _draw_executions(axes, table, path, noisy)
    return figure


def order_figure(table: PolicyTable) -> Figure:
    """Return the order in which the partitions were processed."""
    figure, (axes,) = sheet(table.scenario.workspace, 1)
    draw_partition_order(axes, table)
    return figure


def _draw_executions(axes: Axes, table: PolicyTable, path: Path, noisy: Sequence[Path]) -> None:
    draw_scene(axes, table.scenario)
    draw_noisy(axes, noisy)
    draw_path(axes, path)
    title(axes, table.scenario.title or "Execution")
    axes.figure.legend(*axes.get_legend_handles_labels(), loc="outside lower left", ncols=4, frameon=False, fontsize=8)
