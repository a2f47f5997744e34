"""
What the sensors of the lab see
===============================

A simulated insertion into a phantom with a membrane: depth and force over time, and the tip as the tracker sees it.
"""

from matplotlib import pyplot

from needleplan.simulation import Simulation, run_simulation

record = run_simulation(Simulation.read("insertion")).record()
figure, panels = pyplot.subplots(3, 1, figsize=(7.6, 6), layout="constrained", sharex=True)
for panel, name, label in zip(
    panels,
    ("depth_mm", "force_n", "y_mm"),
    ("depth (mm)", "force (N)", "tip y (mm)"),
    strict=True,
):
    style = "." if name == "y_mm" else "-"  # the tracker has fewer frames
    panel.plot(record["time_s"], record[name], style, color="#0072B2", markersize=2, linewidth=0.8)
    panel.set_ylabel(label)
panels[-1].set_xlabel("time (s)")
figure.align_ylabels(panels)
