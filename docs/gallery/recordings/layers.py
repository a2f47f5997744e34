"""
Curvature by depth
==================

Six insertions through two layers, each with noise of the tracker and of the tissue. One circle does not fit them: the
insertions that are left out choose a curvature by depth.
"""

import numpy as np
from matplotlib import pyplot

from needleplan.identification import curvature
from needleplan.models import arc_step
from needleplan.signals import Record

random = np.random.default_rng(0)
trials = []
for number in range(6):
    pose, points = (0.0, 0.0, random.normal(0, 0.02)), []
    for _ in range(140):  # pieces of 0.5 mm
        points.append(pose[:2])
        pose = arc_step(*pose, 1 / 60 if pose[0] < 35 else 1 / 90, 0.5)
        pose = (*pose[:2], pose[2] + random.normal(0, 0.006))
    x, y = np.array(points).T + random.normal(0, 0.03, (2, 140))
    columns = {"time_s": np.arange(140) / 20, "depth_mm": 0.5 * np.arange(140), "x_mm": x, "y_mm": y}
    trials.append(Record(columns, f"trial {number}"))
found = curvature.identify(trials)
print(found.model)
found.draw(pyplot.figure(figsize=(9, 6.4), layout="constrained"))
