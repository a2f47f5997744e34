"""
The shape of a needle from its sensors
======================================

A needle in two layers of tissue, with four curvature sensors: the measured curvatures at three depths, the fitted
curvature along the needle, and the shape that follows from it.
"""

import numpy as np
from matplotlib import pyplot

from needleplan.models import LayeredShape
from needleplan.models.deflection import fit_shape

sensors_mm, depths_mm, colours = [10.0, 35.0, 70.0, 100.0], [90.0, 120.0, 150.0], ("#0072B2", "#D55E00", "#009E73")
needle = LayeredShape(0.002, start_n_per_mm=0.009, start_b_per_mm=-0.001, second_per_mm=0.011, boundary_mm=70.0)
noise = 2e-4 * np.random.default_rng(1).standard_normal((3, 4, 2))
measured = needle.curvatures(depths_mm, sensors_mm) + noise
start = LayeredShape(0.001, start_n_per_mm=0.001, second_per_mm=0.001, boundary_mm=70.0)
free = ["intrinsic_per_mm", "second_per_mm", "start_n_per_mm", "start_b_per_mm"]
found = fit_shape(start, depths_mm, sensors_mm, measured, free=free).model

figure, (bend, side) = pyplot.subplots(2, 1, figsize=(7.2, 5.4), layout="constrained", sharex=True)
for depth_mm, seen, colour in zip(depths_mm, measured, colours, strict=True):
    shape = found.shape(depth_mm, np.linspace(0.0, depth_mm, 200))
    place_mm = depth_mm - np.array(sensors_mm)
    bend.plot(shape.place_mm, 1e3 * shape.curvature_per_mm[:, 0], color=colour)
    bend.plot(place_mm[place_mm >= 0], 1e3 * seen[place_mm >= 0, 0], "o", color=colour)
    side.plot(shape.place_mm, shape.position_mm[:, 1], color=colour, label=f"{depth_mm:g} mm inserted")
bend.axvline(70.0, color="#8c8c8c", linewidth=0.8, linestyle="--")
bend.set(ylabel="curvature toward the bevel (1/m)")
side.set(xlabel="distance from the entry along the needle (mm)", ylabel="deflection (mm)")
side.legend(frameon=False)
