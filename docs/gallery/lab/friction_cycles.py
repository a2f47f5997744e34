"""
Friction measured in the lab twin
=================================

The simulation for friction: the force over depth of its strokes, the first one in fresh tissue.
"""

import numpy as np
from matplotlib import pyplot

from needleplan.simulation import Simulation, run_simulation

record = run_simulation(Simulation.read("friction")).record()
figure, axes = pyplot.subplots(figsize=(6.8, 4.2), layout="constrained")
dots = axes.scatter(record["depth_mm"], record["force_n"], c=record["time_s"], s=2, cmap="cividis")
figure.colorbar(dots, label="time (s)")
axes.set(xlabel="depth (mm)", ylabel="axial force (N)")
print(f"{np.ptp(record['time_s']):.0f} s")
