"""
The heading decides
===================

The success probability of every position, for four headings of the tip. White shapes are obstacles.
"""

import math

from matplotlib import pyplot

import needleplan as npl

table = npl.plan("four_obstacles")
figure, panels = pyplot.subplots(2, 2, figsize=(10, 7), layout="constrained")
for panel, heading_deg in zip(panels.flat, (-30, 0, 30, 60), strict=True):
    table.plot(panel, heading_rad=math.radians(heading_deg))
