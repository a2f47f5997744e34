"""A small anatomy that is planned in no time, and labs in 3D."""

from dataclasses import replace
from functools import cache
from typing import Any

from needleplan.anatomy import SpaceScenario
from needleplan.control import Insertion, InsertionReport, Options
from needleplan.control.safety import SafetyLimits
from needleplan.estimation.tip import TipSettings
from needleplan.planning import SpaceTable, plan_space
from needleplan.simulation import Effects, Robot, SimulatedStation, Simulation, simulated_station
from tests.anatomy.volumes import TEXT, anatomy, box

FAST = Options(velocity_mm_s=20.0, velocity_rad_s=10.0)
WIDE = SafetyLimits(insertion_velocity_mm_s=25.0)
QUIET = Effects(coil_offset_mm=2.0, heading_noise_rad_sqrt_mm=0.0)


@cache
def box_table(straight: bool = True, bent: bool = False) -> SpaceTable:
    """Return the plan through a box; `bent`: with another radius of curvature in the entry region."""
    text = TEXT if straight else TEXT.replace("[lattice]", "straight_steps = false\n[lattice]")
    if bent:
        text = text.replace("[needle]", '[[anatomy.curvature]]\nlabel = "body"\nradius_mm = 50.0\n[needle]')
    return plan_space(SpaceScenario.of(anatomy(box(), text)), threads=1)


def space_station(
    table: SpaceTable, effects: Effects = QUIET, seed: int = 0, modulus_n_mm2: float | None = None
) -> SimulatedStation:
    """Return a lab with these effects, in which the needle enters at the best entry; with a modulus, of soft tissue."""
    simulation = Simulation.read("steering")
    tissue, robot = simulation.setup.tissue, Robot(servo_hz=400, bandwidth_hz=10.0)
    tissue = replace(tissue, shear_modulus_n_mm2=modulus_n_mm2)
    setup = replace(simulation.setup, effects=effects, robot=robot, tissue=tissue)
    return simulated_station(replace(simulation, setup=setup), table, table.best_entry().pose, seed)


def inserted(
    table: SpaceTable,
    effects: Effects = QUIET,
    seed: int = 0,
    options: Options = FAST,
    station: SimulatedStation | None = None,
    **others: Any,
) -> tuple[InsertionReport, SimulatedStation]:
    """Return the report of an insertion, and its lab."""
    station = station or space_station(table, effects, seed)
    noise = max(effects.heading_noise_rad_sqrt_mm or 0.0, 0.002)
    others = {"limits": WIDE, "accepted_limits": "a fast lab", "registration": station.registration,
              "tip_settings": TipSettings(heading_sd_rad_sqrt_mm=noise)} | others  # fmt: skip
    with Insertion(table, station, replace(options, torsion=station.torsion), **others) as insertion:
        return insertion.run(), station
