"""
A needle that bends otherwise than planned
==========================================

The true curvature is 0.7 of the planned one, and the tip noise of the lab is less than that of the plan. The tip
filter notices, and the loop plans again while the needle moves (dotted lines).
"""

from dataclasses import replace

import needleplan as npl
from needleplan.control import Insertion, Options
from needleplan.estimation.tip import TipSettings
from needleplan.reports.insertion import insertion_figure
from needleplan.simulation import Simulation, simulated_station

table = npl.plan("four_obstacles")
steering = Simulation.read("steering")
effects = replace(steering.setup.effects, curvature_error=-0.3, heading_noise_rad_sqrt_mm=0.002)
simulation = replace(steering, setup=replace(steering.setup, effects=effects))
station = simulated_station(simulation, table, table.best_entry().pose, seed=2)
options = Options(velocity_mm_s=10, torsion=station.torsion)
quiet = TipSettings(heading_sd_rad_sqrt_mm=0.002)
with station, Insertion(table, station, options, registration=station.registration, tip_settings=quiet) as insertion:
    report = insertion.run()
print(report.outcome, f"{report.error_in_space_mm:.2f} mm from the centre")
figure = insertion_figure(table, report, station.true_tip_mm)
