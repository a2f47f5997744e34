"""
An invented prostate
====================

Transperineal access in a sagittal plane: pubic arch above, rectum below, the urethra in the gland. The geometry is
invented; it is no patient's.
"""

from matplotlib import pyplot

import needleplan as npl

table = npl.plan("prostate")
entry = table.best_entry()
print(entry)

figure, axes = pyplot.subplots(figsize=(6.4, 5.6), layout="constrained")
table.rollout(entry, runs=40, seed=0).plot(axes)
table.path(entry).plot(axes, scene=False)
figure.legend(loc="outside lower left", ncols=2, frameon=False)
