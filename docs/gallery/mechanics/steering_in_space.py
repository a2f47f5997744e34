"""
3D arcs
=======

The tip follows an arc in the direction of its bevel. Three needles of 60 mm radius: one never turns, one turns by a
quarter every 25 mm, one by half a turn.
"""

import math

import numpy as np
from matplotlib import pyplot

from needleplan.models import TipFrame


def path(turn_rad):
    """Return the places of the tip of a needle that turns after every 25 mm."""
    frame, places = TipFrame.planar(0.0, 0.0, 0.0), []
    for number in range(100):
        places.append(frame.position_mm)
        roll = turn_rad * (number // 25)
        frame = frame.arc(math.cos(roll) / 60, math.sin(roll) / 60, 1.0)
    return np.array(places)


figure = pyplot.figure(figsize=(6.4, 5), layout="constrained")
view = figure.add_subplot(projection="3d")
for label, turn_deg, colour in (("no turn", 0, "#8c8c8c"), ("quarter", 90, "#0072B2"), ("half", 180, "#D55E00")):
    view.plot(*path(math.radians(turn_deg)).T, color=colour, label=label)
view.set(xlabel="x (mm)", ylabel="y (mm)", zlabel="z (mm)")
view.legend(frameon=False)
