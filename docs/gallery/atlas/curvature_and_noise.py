"""
Success over curvature and noise
================================

An atlas solves a table for every combination of two parameters; a study draws what they say.
"""

import tempfile

import needleplan as npl
from needleplan.atlas import Engine, Sweep, SweptParameter, draw_quantity_map, make_atlas, quantity_map

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
    make_atlas(sweep, folder, Engine(workers=0))
    atlas = npl.Atlas.open(folder)
    study = quantity_map(atlas, "curvature_radius_mm", "noise_deg")
figure = draw_quantity_map(study, "curvature_radius_mm", "noise_deg", "success", atlas=atlas)
