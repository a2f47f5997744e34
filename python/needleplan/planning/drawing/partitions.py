"""In which order the partitions were processed (Figs. 6.3 and 6.6 of the thesis)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from needleplan.errors import InputError, Mistake
from needleplan.planning.drawing.scene import draw_scene
from needleplan.plotting.canvas import BLACK, BLUE, GREY, title
from needleplan.scenario import Method

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from needleplan.planning import PolicyTable

__all__ = ["draw_partition_order"]


def draw_partition_order(axes: Axes, table: PolicyTable) -> None:
    """Draw the partitions; in each, large, its place in the order, and small its number. Grey: never processed.

    Raises InputError for a table that was not solved partition by partition.
    """
    from matplotlib import colormaps
    from matplotlib.patches import Rectangle

    scenario = table.scenario
    if scenario.solver.method is not Method.PPVI:
        rule = 'must be "ppvi" for this figure; the other methods know no partitions'
        raise InputError(Mistake("solver.method", f'"{scenario.solver.method}"', rule))
    columns, rows = scenario.partitions
    width, height = scenario.workspace.width_mm / columns, scenario.workspace.height_mm / rows
    places = {partition: place for place, partition in enumerate(table.stats.order, start=1)}
    shade = colormaps["Blues"]
    size = min(9.0, 110 / max(columns, rows))
    draw_scene(axes, scenario)
    for partition in range(columns * rows):
        column, row = divmod(partition, rows)
        place = places.get(partition)
        fill = "#e6e6e6" if place is None else shade(0.6 * (1 - place / (len(places) + 1)))
        corner = (column * width, row * height)
        axes.add_patch(Rectangle(corner, width, height, facecolor=fill, edgecolor="white", linewidth=0.6, zorder=1))
        if place is not None:
            middle = (corner[0] + width * 0.46, corner[1] + height * 0.55)
            axes.text(*middle, str(place), ha="center", va="center", fontsize=size, color=BLACK, zorder=4)
        if columns <= 16:
            end = (corner[0] + width * 0.95, corner[1] + height * 0.07)
            axes.text(*end, str(partition + 1), ha="right", va="bottom", fontsize=size * 0.6, color=BLUE, zorder=4)
    for patch in axes.patches[: len(scenario.obstacles)]:
        patch.set(facecolor="none", edgecolor=GREY, linewidth=1.2)
    title(axes, f"Order of processing: {len(places)} of {columns * rows} partitions")
