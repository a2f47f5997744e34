"""
Needles that bend more or less
==============================

A needle with a smaller radius can correct more of its tip noise. One plan for each needle, and its path from the same
pose.
"""

from dataclasses import replace

from matplotlib import pyplot

import needleplan as npl

scenario = npl.Scenario.read("four_obstacles")
figure, axes = pyplot.subplots(figsize=(6.4, 4.6), layout="constrained")
scenario.plot(axes)
for radius_mm, colour in ((30, "#D55E00"), (40, "#0072B2"), (60, "#009E73"), (120, "#8c8c8c")):
    needle = replace(scenario.needle, curvature_radius_mm=float(radius_mm))
    table = npl.plan(replace(scenario, needle=needle))
    path = table.path(npl.Pose.deg(0, 62, -10))
    label = f"R {radius_mm} mm: success {table.lookup(path.start).success:.2f}"
    axes.plot(*path.poses[:, :2].T, color=colour, linewidth=1.8, label=label)
figure.legend(loc="outside lower left", ncols=2, frameon=False)
