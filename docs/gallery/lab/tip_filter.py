"""
Where the tip is
================

The filter estimates the tip from stage and tracker while the needle goes in. Here the needle bends 20 % more than
expected: the estimate of the curvature, and the error of the estimated tip.
"""

import math

import numpy as np
from matplotlib import pyplot

from needleplan.estimation import Registration, TipFilter, TipSettings
from needleplan.simulation import open_lab

settings = TipSettings(position_sd_mm=0.05, angle_sd_rad=0.002, wander_sd_mm=0.05, heading_sd_rad_sqrt_mm=2e-4)
rows = []
with open_lab("sim://insertion?seed=3") as lab:
    tip = TipFilter(Registration(coil_offset_mm=1.5), (0.0, 0.0, 0.0), 0.001, settings)
    lab.stage.insert(80.0, 10.0)
    while tip.counts["used"] < 330:
        sample = lab.stage.read(1.0)
        tip.predict(sample)
        for pose in lab.tracker.waiting():
            tip.update(pose)
        found = tip.tip
        error_mm = math.dist((found.x_mm, found.y_mm), lab.plant.tip().position_mm[:2])
        rows.append((sample.depth_mm, found.curvature_factor, found.curvature_factor_sd, error_mm))
depth_mm, factor, sd, error_mm = np.array(rows).T

figure, (bend, error) = pyplot.subplots(2, 1, figsize=(7.2, 5), layout="constrained", sharex=True)
bend.fill_between(depth_mm, factor - 2 * sd, factor + 2 * sd, color="#56B4E9", alpha=0.4, linewidth=0)
bend.plot(depth_mm, factor, color="#0072B2")
bend.axhline(1.2, color="#D55E00", linestyle="--", linewidth=1)
bend.set(ylabel="curvature over expected one")
error.plot(depth_mm, error_mm, color="#1a1a1a", linewidth=0.8)
error.set(xlabel="depth (mm)", ylabel="error of the tip (mm)")
