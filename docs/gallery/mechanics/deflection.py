"""
Deflection of a needle in gel
=============================

A steel needle on an elastic foundation, pushed aside by the force on its bevel: the tip that the needle has bent,
over depth, for gels of three stiffnesses.
"""

import math

import numpy as np
from matplotlib import pyplot

from needleplan.models import NeedleShaft
from needleplan.models.deflection import ElasticTissue, march

needle = NeedleShaft(
    outer_diameter_mm=0.718, inner_diameter_mm=0.413, length_mm=203, bevel_angle_rad=math.radians(24.8)
)
depth_mm = np.arange(81.0)
cutting_n = 0.055 * np.minimum(depth_mm / 20, 1) ** 2

figure, axes = pyplot.subplots(figsize=(6.4, 4), layout="constrained")
for stiffness, style, colour in ((2e-3, "-", "#0072B2"), (4e-3, "--", "#D55E00"), (8e-3, ":", "#009E73")):
    tip_mm = march(needle, ElasticTissue(stiffness), cutting_n, step_mm=1.0).tip_mm
    axes.plot(depth_mm, tip_mm, style, color=colour, label=f"{1e3 * stiffness:g} kN/m$^2$")
axes.set(xlabel="depth (mm)", ylabel="deflection of the tip (mm)")
axes.legend(frameon=False, title="stiffness of the gel")
