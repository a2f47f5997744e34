"""
Layers of tissue
================

In each layer the needle follows arcs of another radius. The success probability for a needle that enters straight.
"""

from matplotlib import pyplot

import needleplan as npl

table = npl.plan("layered")
figure, (scene, success) = pyplot.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
entry = table.best_entry()
table.path(entry).plot(scene)
scene.set_title(f"path from the best entry, success {entry.success:.2f}", loc="left", fontsize=10)
table.plot(success, heading_rad=0.0)
