"""
Success, clearance and rotations
================================

Costs choose between success, distance to the obstacles, and few rotations. Blue plans are beaten by no other plan in
all goals at once.
"""

import tempfile

import needleplan as npl
from needleplan.sweep import Engine, Sweep, SweptParameter, draw_pareto, make_table_set, pareto_front

sweep = Sweep(
    title="Trade-off of the costs",
    scenario="four_obstacles",
    parameters=(
        SweptParameter("objective.rotation", values=[1.0, 8.0, 64.0]),
        SweptParameter("objective.clearance_per_mm", values=[0.01, 1.0, 16.0]),
        SweptParameter("objective.clearance_mm", values=[6.0]),
        SweptParameter("grid.spacing_mm", name="grid", values=[[2.0, 2.0]]),
    ),
)
with tempfile.TemporaryDirectory() as folder:
    make_table_set(sweep, folder, Engine(workers=0))
    table_set = npl.TableSet.open(folder)
    figure = draw_pareto(table_set, pareto_front(table_set), table_set=table_set)
