"""
Axial force of an insertion
===========================

Insertion and retraction at 10 mm/s with published parameters: needle A in tissue A.
"""

import numpy as np
from matplotlib import pyplot

from needleplan.identification.force_library import ForceLibrary
from needleplan.models import simulate
from needleplan.signals import insertion_cycles

published = ForceLibrary.read("published").combinations[0]
motion = insertion_cycles(80.0, 10.0)
force_n = simulate(published.model, motion).output
inward = motion.direction > 0

figure, axes = pyplot.subplots(figsize=(6.4, 4), layout="constrained")
axes.plot(motion.depth_mm, np.where(inward, force_n, np.nan), color="#0072B2", label="insertion")
axes.plot(motion.depth_mm, np.where(inward, np.nan, force_n), "--", color="#D55E00", label="retraction")
axes.axhline(0, color="#8c8c8c", linewidth=0.6)
axes.set(xlabel="depth (mm)", ylabel="axial force (N)", title=published.title)
axes.legend(frameon=False)
