"""Figures of plans and executions; importing this package does not import matplotlib."""

from needleplan.workflow.figures.canvas import require_drawable, save, sheet
from needleplan.workflow.figures.caption import caption
from needleplan.workflow.figures.dependents import dependent_points, draw_dependents
from needleplan.workflow.figures.partitions import draw_partition_order
from needleplan.workflow.figures.scene import draw_noisy, draw_path, draw_scene
from needleplan.workflow.figures.sheets import order_figure, path_figure, plan_figure
from needleplan.workflow.figures.success_map import draw_success_map
from needleplan.workflow.figures.tissues import draw_tissues

__all__ = [
    "caption",
    "dependent_points",
    "draw_dependents",
    "draw_noisy",
    "draw_partition_order",
    "draw_path",
    "draw_scene",
    "draw_success_map",
    "draw_tissues",
    "order_figure",
    "path_figure",
    "plan_figure",
    "require_drawable",
    "save",
    "sheet",
]
