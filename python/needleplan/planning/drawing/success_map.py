"""Where an insertion may begin: the probability of reaching the target over the workspace."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from needleplan.planning.drawing.scene import draw_scene
from needleplan.plotting.canvas import VERMILLION, tall, title

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from needleplan.planning import PolicyTable

__all__ = ["draw_success_map"]


_IN_OBSTACLE = 4


def draw_success_map(axes: Axes, table: PolicyTable, heading_rad: float | None = None) -> None:
    """Draw the predicted success over positions, for one heading or at the best heading, with the better bevel."""
    scenario = table.scenario
    if heading_rad is None:
        shown = table.success.max(axis=(2, 3))
        title(axes, "Success probability at the best heading")
    else:
        heading = round(heading_rad / (2 * math.pi) * scenario.motion.headings) % scenario.motion.headings
        shown = table.success[:, :, heading].max(axis=2)
        title(axes, f"Success probability at {math.degrees(heading_rad):.3g} deg")
    draw_scene(axes, scenario, on_colour=True)
    dx, dy = scenario.grid.spacing_mm
    x, y = scenario.x_mm, scenario.y_mm
    outcomes = table.lattice.outcomes()[:, :, 0, 0]
    image = axes.imshow(
        np.ma.masked_where(outcomes == _IN_OBSTACLE, shown).T,
        origin="lower",
        extent=(-dx / 2, x[-1] + dx / 2, -dy / 2, y[-1] + dy / 2),
        aspect=axes.get_aspect(),
        cmap="cividis",
        vmin=0,
        vmax=1,
        interpolation="nearest",
    )
    axes.set_xlim(0, scenario.workspace.width_mm)
    axes.set_ylim(0, scenario.workspace.height_mm)
    bar = axes.figure.colorbar(image, ax=axes, shrink=0.85 if tall(scenario.workspace) else 1, pad=0.02)
    bar.set_label("probability of reaching the target")
    axes.plot(*scenario.target.center_mm, marker="+", color=VERMILLION, zorder=6)
