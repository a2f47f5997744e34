"""
A table for the wrong needle
============================

A plan for a needle of 40 mm radius, executed with needles that bend otherwise, beside the right plan for each. A
table decides by where the tip is, so it corrects most of what it did not foresee.
"""

from dataclasses import replace

import numpy as np
from matplotlib import pyplot

import needleplan as npl

scenario = npl.Scenario.read("four_obstacles")
scenario = replace(scenario, grid=replace(scenario.grid, spacing_mm=(2.0, 2.0)))
planned = npl.plan(scenario)
start = planned.best_entry()
ratios = np.array([0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3])  # true over planned curvature
wrong, right = [], []
for ratio in ratios:
    true = npl.plan(scenario.with_curvature(ratio / 40.0))
    # the actions of the plan, in the scenario of the true needle
    meant = replace(planned, scenario=true.scenario)
    wrong.append(meant.rollout(start, runs=4000, seed=0, nearest=True).success)
    right.append(true.rollout(true.best_entry(), runs=4000, seed=0, nearest=True).success)

figure, axes = pyplot.subplots(figsize=(6.4, 4), layout="constrained")
axes.plot(ratios, right, "o-", color="#0072B2", label="planned for the true curvature")
axes.plot(ratios, wrong, "s--", color="#D55E00", label="planned for 1/40 mm")
axes.set(xlabel="true curvature over planned curvature", ylabel="realised success", ylim=(0.7, 1))
axes.legend(frameon=False)
