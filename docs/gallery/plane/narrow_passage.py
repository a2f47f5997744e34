"""
A narrow passage
================

A wall with a gap of 10 mm, a little more than two insertion steps wide, and a target behind it. The geometry is
invented.
"""

from matplotlib import pyplot

import needleplan as npl

table = npl.plan("narrow_passage")
entry = table.best_entry()
print(entry)

figure, axes = pyplot.subplots(figsize=(6.4, 5.6), layout="constrained")
table.rollout(entry, runs=40, seed=0).plot(axes)
table.path(entry).plot(axes, scene=False)
figure.legend(loc="outside lower left", ncols=2, frameon=False)
