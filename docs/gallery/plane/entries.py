"""
Where to enter
==============

The success of the best heading at every position of two edges, and the heading that it needs.
"""

import numpy as np
from matplotlib import pyplot

import needleplan as npl
from needleplan.planning import edge_profile

pyplot.style.use("tableau-colorblind10")
table = npl.plan("four_obstacles")
figure, (success, heading) = pyplot.subplots(2, 1, figsize=(7.6, 5), layout="constrained", sharex=True)
for edge, style in (("left", "-"), ("bottom", "--")):
    profile = edge_profile(table, edge)
    success.plot(profile.position_mm, profile.success, style, label=f"{edge} edge")
    heading.plot(profile.position_mm, np.degrees(profile.heading_rad), style)
success.set(ylabel="success probability", ylim=(0, 1))
success.legend(frameon=False)
heading.set(xlabel="position along the edge (mm)", ylabel="best heading (degrees)")
