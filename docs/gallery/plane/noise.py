"""
Predicted and realised success
==============================

The table predicts the success probability of an entry. Here it is compared with 10,000 executions each in the
continuous model, for entries all along the left edge.
"""

import numpy as np
from matplotlib import pyplot

import needleplan as npl
from needleplan.planning import edge_profile

table = npl.plan("four_obstacles")
profile = edge_profile(table)
every = slice(2, None, 6)
runs = [
    table.rollout((0.0, float(y_mm), float(heading_rad)), runs=10_000, seed=0)
    for y_mm, heading_rad in zip(profile.position_mm[every], profile.heading_rad[every], strict=True)
]
predicted = np.array([each.predicted_success for each in runs])
realised = np.array([each.success for each in runs])
reach = np.abs(np.array([each.interval for each in runs]).T - realised)

figure, axes = pyplot.subplots(figsize=(4.8, 4.6), layout="constrained")
axes.plot([0, 1], [0, 1], color="#8c8c8c", linewidth=0.8)
axes.errorbar(predicted, realised, reach, fmt="o", color="#0072B2", markersize=4, capsize=2)
axes.set(xlabel="predicted success", ylabel="realised success, 95 % interval", aspect="equal")
low = min(predicted.min(), realised.min()) - 0.05
axes.set(xlim=(low, 1.02), ylim=(low, 1.02))
