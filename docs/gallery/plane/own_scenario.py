"""
A scenario made in Python
=========================

Obstacles from shapely: a row of ribs and a thick vessel.
"""

from dataclasses import replace

from matplotlib import pyplot
from shapely.geometry import LineString, box

import needleplan as npl

ribs = [box(30, y_mm, 36, y_mm + 9) for y_mm in (4, 26, 48, 70)]
vessel = LineString([(60, 0), (70, 30), (62, 52)]).buffer(3.0)
obstacles = [*npl.Obstacle.from_shapely(vessel), *(each for rib in ribs for each in npl.Obstacle.from_shapely(rib))]
scenario = replace(npl.Scenario.read("four_obstacles"), title="Ribs and a vessel", obstacles=tuple(obstacles))

table = npl.plan(scenario)
entry = table.best_entry()
figure, axes = pyplot.subplots(figsize=(6.4, 5.6), layout="constrained")
table.rollout(entry, runs=40, seed=0).plot(axes)
table.path(entry).plot(axes, scene=False)
figure.legend(loc="outside lower left", ncols=2, frameon=False)
