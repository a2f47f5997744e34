"""
The order of the partitions
===========================

The thesis solves the problem by prioritized partitions. The large numbers are the order in which the partitions were
visited first, the small ones their numbers. Grey partitions were never visited.
"""

from dataclasses import replace

import needleplan as npl

scenario = npl.Scenario.read("four_obstacles_thesis")
scenario = replace(
    scenario,
    grid=replace(scenario.grid, spacing_mm=(2.0, 2.0)),
    solver=replace(scenario.solver, method="ppvi", partitions=(12, 8)),
)
table = npl.plan(scenario)
print(f"{table.stats.partitions_processed} passes over {table.stats.partitions} partitions")
table.plot_order()
