"""
Curvature from tracked points
=============================

Twenty insertions of 80 mm, seen by a tracker with 0.1 mm of noise. The 95 % interval of the curvature of each, and
the true one.
"""

import numpy as np
from matplotlib import pyplot

from needleplan.identification import arc_curvature
from needleplan.models import arc_step

true = 1 / 400
random = np.random.default_rng(4)
x, y, _ = arc_step(0.0, 0.0, 0.0, true, np.linspace(0, 80, 160))
found = [arc_curvature(np.column_stack([x, y]) + random.normal(0, 0.1, (160, 2))) for _ in range(20)]

figure, axes = pyplot.subplots(figsize=(6.4, 4), layout="constrained")
axes.axvline(1e3 * true, color="#8c8c8c", linewidth=1)
for row, each in enumerate(found):
    holds = each.low_per_mm < true < each.high_per_mm
    colour = "#0072B2" if holds else "#D55E00"
    axes.plot([1e3 * each.low_per_mm, 1e3 * each.high_per_mm], [row, row], color=colour)
    axes.plot(1e3 * each.curvature_per_mm, row, "o" if holds else "X", color=colour, markersize=4)
held = sum(each.low_per_mm < true < each.high_per_mm for each in found)
axes.set_yticks(range(0, 20, 5))
axes.set(xlabel="curvature (1/m)", ylabel="insertion", title=f"{held} of 20 intervals hold the true curvature")
