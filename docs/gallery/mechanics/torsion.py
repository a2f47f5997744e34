"""
The tip turns later than the base
=================================

Friction along the shaft holds the tip while the base turns: the angle of the tip and the torque at the base, for
turns to and fro.
"""

import numpy as np
from matplotlib import pyplot

from needleplan.models import Torsion
from needleplan.models.path import TwistedShaft

shaft = TwistedShaft(Torsion(stiffness_n_mm2=15_000, torque_per_length_n=0.05), length_mm=200)
base_rad = 0.2 * np.sin(np.linspace(0, 4 * np.pi, 800))
tip_rad, torque_n_mm = np.empty_like(base_rad), np.empty_like(base_rad)
for number, angle in enumerate(base_rad):
    tip_rad[number] = shaft.step(float(angle), 80.0)
    torque_n_mm[number] = shaft.torque_n_mm

figure, (turn, torque) = pyplot.subplots(1, 2, figsize=(9, 4), layout="constrained")
turn.plot(np.degrees(base_rad), np.degrees(tip_rad), color="#0072B2")
turn.set(xlabel="angle of the base (degrees)", ylabel="angle of the tip (degrees)")
torque.plot(np.degrees(base_rad), torque_n_mm, color="#D55E00")
torque.set(xlabel="angle of the base (degrees)", ylabel="torque at the base (N mm)")
