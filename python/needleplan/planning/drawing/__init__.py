"""Drawings of plans and executions; importing this package does not import matplotlib."""

from needleplan.planning.drawing.partitions import draw_partition_order
from needleplan.planning.drawing.scene import draw_noisy, draw_path, draw_scene
from needleplan.planning.drawing.sheets import order_figure, path_figure, plan_figure
from needleplan.planning.drawing.success_map import draw_success_map
from needleplan.planning.drawing.tissues import draw_tissues

__all__ = [
    "draw_noisy",
    "draw_partition_order",
    "draw_path",
    "draw_scene",
    "draw_success_map",
    "draw_tissues",
    "order_figure",
    "path_figure",
    "plan_figure",
]
