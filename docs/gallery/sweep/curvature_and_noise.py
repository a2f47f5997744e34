"""
Success over curvature and noise
================================

A table set solves a table for every combination of two parameters; a study draws what they say.
"""

import tempfile

import needleplan as npl
from needleplan.sweep import Engine, Sweep, SweptParameter, draw_quantity_map, make_table_set, quantity_map

sweep = Sweep(
    title="Needle and noise",
    scenario="four_obstacles",
    parameters=(
        SweptParameter("needle.curvature_radius_mm", values=[30.0, 40.0, 60.0, 80.0]),
        SweptParameter("motion.tip_noise_step_deg", name="noise_deg", values=[2.0, 5.0, 8.0]),
        SweptParameter("grid.spacing_mm", name="grid", values=[[2.0, 2.0]]),
    ),
)
with tempfile.TemporaryDirectory() as folder:
    make_table_set(sweep, folder, Engine(workers=0))
    table_set = npl.TableSet.open(folder)
    study = quantity_map(table_set, "curvature_radius_mm", "noise_deg")
figure = draw_quantity_map(study, "curvature_radius_mm", "noise_deg", "success", table_set=table_set)
