"""
An invented brain
=================

A burr-hole approach past two sulci with their vessels, a ventricle and an artery. The geometry is invented; it is no
patient's.
"""

from matplotlib import pyplot

import needleplan as npl

table = npl.plan("brain")
entry = table.best_entry()
print(entry)

figure, axes = pyplot.subplots(figsize=(6.4, 5.6), layout="constrained")
table.rollout(entry, runs=40, seed=0).plot(axes)
table.path(entry).plot(axes, scene=False)
figure.legend(loc="outside lower left", ncols=2, frameon=False)
