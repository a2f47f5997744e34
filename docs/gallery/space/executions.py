"""
3D executions
=============

One hundred executions with tip noise from the best entry of an invented brain: those that reach the target and those
that do not.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

from matplotlib import pyplot

from needleplan.anatomy import Anatomy, SpaceScenario, draw_bodies, write_phantom
from needleplan.planning import plan_space

with tempfile.TemporaryDirectory() as folder:
    anatomy = Anatomy.read(write_phantom("brain", Path(folder), seed=1))
lattice = replace(anatomy.file.lattice, spacing_mm=4.0, step_mm=8.0, directions_deg=8.0)
anatomy = replace(anatomy, file=replace(anatomy.file, lattice=lattice))

table = plan_space(SpaceScenario.of(anatomy))
runs = table.executions(table.best_entry(), runs=100, seed=0)

figure = pyplot.figure(figsize=(6.4, 5.6), layout="constrained")
view = figure.add_subplot(projection="3d")
draw_bodies(view, table.scenario.grid)
for run in range(100):
    view.plot(*runs.points(run).T, color="#0072B2" if runs.reached[run] else "#D55E00", linewidth=0.6)
view.set_title(f"{int(runs.reached.sum())} of 100 reach the target (blue)", loc="left", fontsize=10)
