"""
Relaxing tissue
===============

Viscoelastic tissue pushes back with a force that decays while the needle rests. Ten millimetres at four speeds, then
a rest.
"""

import numpy as np
from matplotlib import pyplot

from needleplan.models import RelaxingForce, simulate
from needleplan.signals import Motion

model = RelaxingForce(
    contact_mm=2.0, stiffness=0.03, growth=0.12, branch_1=1.5, time_1_s=0.8, boundary_1_mm=11.0, friction=0.01
)
time_s = np.arange(3001) / 200
figure, axes = pyplot.subplots(figsize=(6.4, 4), layout="constrained")
for speed, style, colour in ((1, "-", "#0072B2"), (2, "--", "#D55E00"), (5, "-.", "#009E73"), (20, ":", "#1a1a1a")):
    force_n = simulate(model, Motion.sampled(time_s, np.minimum(speed * time_s, 10.0))).output
    axes.plot(time_s, force_n, style, color=colour, label=f"{speed} mm/s")
axes.set(xlabel="time (s)", ylabel="axial force (N)")
axes.legend(frameon=False)
