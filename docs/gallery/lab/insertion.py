"""
An insertion in the lab twin
============================

The intraoperative loop with imperfect sensors, twisting shaft and scattered curvature: planned and executed path,
deviation, force.
"""

import needleplan as npl
from needleplan.control import Insertion, Options
from needleplan.reports.insertion import insertion_figure
from needleplan.simulation import Simulation, simulated_station

table = npl.plan("four_obstacles")
station = simulated_station(Simulation.read("steering"), table, table.best_entry().pose, seed=3)
options = Options(velocity_mm_s=10, torsion=station.torsion)
with station, Insertion(table, station, options, registration=station.registration) as insertion:
    report = insertion.run()
print(report.outcome, f"{report.error_in_space_mm:.2f} mm from the centre")
figure = insertion_figure(table, report, station.true_tip_mm)
