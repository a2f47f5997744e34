"""A small scenario that is planned in no time, and labs in which the needle bends as planned or otherwise."""

from functools import cache
from typing import Any

from needleplan.control import Insertion, InsertionReport, Options
from needleplan.control.safety import SafetyLimits
from needleplan.devices import Station
from needleplan.estimation.registration import Registration
from needleplan.estimation.tip import TipSettings
from needleplan.planning import PolicyTable, plan
from needleplan.scenario import Grid, Needle, Obstacle, Scenario, Target, TipMotion, Workspace
from needleplan.simulation import Effects, Lab, Robot, Setup, SimulatedEntry

FAST = Options(velocity_mm_s=20.0, velocity_rad_s=10.0)
SLOW_SERVO = Robot(servo_hz=400, bandwidth_hz=10.0)
WIDE = SafetyLimits(insertion_velocity_mm_s=25.0, out_of_plane_mm=20.0)

NOISY = Effects(
    tracker_noise_mm=0.1, tracker_angle_noise_rad=0.01, heading_noise_rad_sqrt_mm=0.003, coil_offset_mm=2.0,
    encoder_step_mm=0.001, encoder_step_rad=0.0005, force_noise_n=0.02, tracker_dropout=0.01,
)  # fmt: skip


@cache
def small_table() -> PolicyTable:
    return plan(
        Scenario(
            Workspace(60.0, 40.0),
            Target((50.0, 26.0), 1.5),
            Needle(40.0),
            obstacles=(Obstacle(((22.0, 14.0), (30.0, 14.0), (30.0, 24.0), (22.0, 24.0)), "vessel"),),
            motion=TipMotion(headings=72),
            grid=Grid((0.5, 0.5)),
        )
    )


def a_lab(effects: Effects | None = None, seed: int = 0, *, entry: SimulatedEntry | None = None) -> Lab:
    x, y, heading, _ = small_table().best_entry().pose
    return Lab(
        Setup(1 / 40, entry=entry or SimulatedEntry(x, y, heading), effects=effects or Effects(), robot=SLOW_SERVO),
        seed,
    )


def station_of(lab: Lab) -> Station:
    return Station(lab.stage, lab.force_sensor, lab.tracker, lab.clock)


def coil_of(lab: Lab) -> Registration:
    return Registration(coil_offset_mm=lab.plant.setup.effects.coil_offset_mm)


def insertion_in(lab: Lab, options: Options = FAST, **others: Any) -> Insertion:
    others = {"limits": WIDE, "accepted_limits": "a fast lab", "tip_settings": TipSettings()} | others
    return Insertion(small_table(), station_of(lab), options, registration=coil_of(lab), **others)


def run_in(lab: Lab, options: Options = FAST, **others: Any) -> InsertionReport:
    return insertion_in(lab, options, **others).run()
