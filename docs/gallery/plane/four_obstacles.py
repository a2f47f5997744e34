"""
Four obstacles
==============

The scenario of the first tutorial: a target behind four obstacles, a needle that follows arcs of 40 mm radius, and
tip noise. The path without noise, 40 executions with noise, and the rotations of the bevel.
"""

from matplotlib import pyplot

import needleplan as npl

table = npl.plan("four_obstacles")
entry = table.best_entry()
print(entry)

figure, axes = pyplot.subplots(figsize=(6.4, 5.6), layout="constrained")
table.rollout(entry, runs=40, seed=0).plot(axes)
table.path(entry).plot(axes, scene=False)
figure.legend(loc="outside lower left", ncols=2, frameon=False)
