"""
Friction of a published recording
=================================

An excerpt of a record of another laboratory comes with needleplan: a rubbing contact with strokes of 0.23 mm. The
choice between the models, the fit and its residuals.
"""

from pathlib import Path

import numpy as np
from matplotlib import pyplot

import needleplan
from needleplan.identification import friction
from needleplan.signals import Record

file = Path(needleplan.__file__).parent / "examples" / "friction_rig.txt"
time_s, _, position_mm, friction_un = np.loadtxt(file, skiprows=1).T
depth_mm = position_mm + 210.0
columns = {
    "time_s": time_s - time_s[0],
    "depth_mm": depth_mm,
    "velocity_mm_s": np.gradient(depth_mm, time_s),
    "force_n": -1e-6 * friction_un,
}
found = friction.identify([Record(columns, "rig")])
found.draw(pyplot.figure(figsize=(9, 6.4), layout="constrained"))
