"""The devices of a simulated lab for an insertion, and the choice between real and simulated devices by address."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from needleplan.config import SEED
from needleplan.devices import Address, Source, Station, open_station, require_schemes
from needleplan.errors import AddressError, Mistake
from needleplan.models import Torsion
from needleplan.planning import Entry, Pose, SpacePose, Table, guide_pose, planned_noise
from needleplan.simulation._lab import Lab
from needleplan.simulation._setup import Setup, SimulatedEntry
from needleplan.simulation._simulation import Simulation

if TYPE_CHECKING:
    from needleplan.devices.robot import MotionLimits
    from needleplan.estimation.registration import Registration

__all__ = [
    "SimulatedStation",
    "are_simulated",
    "open_insertion_station",
    "simulated_coil_mm",
    "simulated_station",
    "tip_noise_remark",
]

_SIM = "sim"
_DEFAULT_SIMULATION = "steering"
# Path length (mm) after which a remark states the tip noise, as anatomy files do.
_NOISE_LENGTH_MM = 10.0
# Relative difference of two tip noises up to which they are called equal: that of two digits.
_SAME_NOISE = 0.01


@dataclass(repr=False)
class SimulatedStation(Station):
    """The devices of a simulated lab, with the properties of the lab that an insertion needs."""

    lab: Lab
    registration: Registration
    """Registration with the offset of the coil; tracker frame and plan frame are the same."""

    torsion: Torsion | None
    """Model of the torsional lag of the simulated needle; None if the tip turns exactly with the base."""

    needle_length_mm: float

    @property
    def true_tip_mm(self) -> tuple[float, float, float]:
        """True position (mm) of the tip, without errors of sensors."""
        return self.lab.plant.tip().position_mm

    @property
    def exhaled_s(self) -> float:
        """Time (s) of the clock at the end of an exhalation."""
        return self.lab.exhaled_s

    def true_target_mm(self, center_mm: tuple[float, ...]) -> tuple[float, float, float]:
        """Return the true position (mm) of the target's centre, which the push of the needle displaces."""
        x, y, z = (*center_mm, 0.0)[:3]
        return self.lab.plant.target_mm((x, y, z))


def tip_noise_remark(setup: Setup) -> str | None:
    """Return a remark with both numbers if a simulation sets another tip noise than the plan has, else None."""
    own, planned = setup.effects.heading_noise_rad_sqrt_mm, setup.planned_noise.in_plane_rad_sqrt_mm
    if own is None or math.isclose(own, planned, rel_tol=_SAME_NOISE):
        return None
    in_lab, in_plan = (f"{math.degrees(each) * math.sqrt(_NOISE_LENGTH_MM):.1f}" for each in (own, planned))
    return (
        f"tip noise: {in_lab} degrees after {_NOISE_LENGTH_MM:g} mm in the simulation, {in_plan} in the plan, for "
        "which its success holds; without effects.heading_noise_rad_sqrt_mm the lab has that of the plan"
    )


def are_simulated(robot: str, force: str, tracker: str) -> bool:
    """Return whether three addresses are the same address of a simulated lab.

    Parameters
    ----------
    robot : str
        Address of the stage.
    force : str
        Address of the force sensor.
    tracker : str
        Address of the tracker.

    Returns
    -------
    bool

    Raises
    ------
    AddressError
        An address is invalid, or the addresses cannot be used together. The error lists all mistakes.
    """
    addresses = {"--robot": robot, "--force-sensor": force, "--tracker": tracker}
    schemes = require_schemes(robot, force, tracker, also=(_SIM,))
    simulated = [name for name, scheme in schemes.items() if scheme == _SIM]
    if len(simulated) == len(addresses):
        if len(set(addresses.values())) > 1:
            rule = "must be the same address for all three devices: a simulated lab contains all three"
            raise AddressError([Mistake(name, address, rule) for name, address in addresses.items()])
        return True
    if simulated:
        rule = "cannot be simulated together with real devices: simulated time differs from real time"
        raise AddressError([Mistake(name, addresses[name], rule) for name in simulated])
    return False


def open_insertion_station(
    robot: str,
    force: str,
    tracker: str,
    table: Table,
    start: Pose | SpacePose,
    motion: MotionLimits | None = None,
) -> Station:
    """Open the three devices of an insertion, real or simulated.

    If all three addresses are the same `sim://[SIMULATION][?seed=N]`, a simulated lab is opened and the result is a
    SimulatedStation. By default, the simulation is `steering`, and the seed is that of the simulation.

    Parameters
    ----------
    robot : str
        Address of the stage.
    force : str
        Address of the force sensor.
    tracker : str
        Address of the tracker.
    table : PolicyTable or SpaceTable
        Table of the plan, for a simulated lab.
    start : Pose or SpacePose
        Pose at which the simulated needle enters.
    motion : MotionLimits, optional
        Limits that a real robot is asked for. Default: the limits of the robot.

    Returns
    -------
    Station

    Raises
    ------
    AddressError
        An address is invalid, or the addresses cannot be used together.
    SimulationError
        The simulation is invalid.
    ConfigurationError
        The configuration of a device cannot be used.
    DeviceFault
        A device cannot be used.
    """
    if not are_simulated(robot, force, tracker):
        return open_station(robot, force, tracker, motion)
    address = Address.parse(robot)
    address.only(("seed",))
    seed = address.option("seed", SEED, None)
    return simulated_station(_simulation_at(robot), table, start, seed)


def simulated_coil_mm(address: str) -> float:
    """Return the distance of the coil behind the tip in a simulated lab.

    Parameters
    ----------
    address : str
        Address `sim://[SIMULATION][?seed=N]`.

    Returns
    -------
    float
        Distance (mm).

    Raises
    ------
    SimulationError
        The simulation is invalid.
    """
    return _simulation_at(address).setup.effects.coil_offset_mm


def _simulation_at(address: str) -> Simulation:
    # The address parser converts the host to lower case, so the name, which may be the path of a file, is read here.
    return Simulation.read(address.partition("://")[2].partition("?")[0] or _DEFAULT_SIMULATION)


def simulated_station(
    simulation: Simulation,
    table: Table,
    start: Pose | SpacePose | Entry[Any],
    seed: int | None = None,
) -> SimulatedStation:
    """Return the devices of a simulated lab in which the needle enters at `start` with planned curvature and tip noise.

    The effects of the simulation still change this curvature. A heading noise of the simulation replaces the tip noise.

    Parameters
    ----------
    simulation
        Robot, needle, tissue and effects of the lab. Entry pose, scenario and curvatures are replaced by the planned
        values.
    table
        Policy table whose scenario determines the curvature of the needle at each position.
    start
        Pose at which the needle enters the tissue, or entry of the table; with `needle` in the table `[entry]`, the
        mean pose.
    seed
        Seed of all random effects; None: the seed of the simulation.

    Returns
    -------
    SimulatedStation
    """
    # Imported here, because estimation imports scipy.stats, which takes long and is not needed for simulations.
    from needleplan.estimation.registration import Registration

    setup = simulation.setup
    pose = start.pose if isinstance(start, Entry) else start
    entry = _space_entry(setup.entry, pose) if isinstance(pose, SpacePose) else _plane_entry(setup.entry, pose)
    planned = replace(
        setup, entry=entry, scenario=table.scenario, planned_noise=planned_noise(table.scenario),
        plan_curvature_per_mm=1 / table.scenario.needle.curvature_radius_mm,
        tissue=replace(setup.tissue, curvature_per_mm=None),
        layers=tuple(replace(layer, curvature_per_mm=None) for layer in setup.layers),
    )  # fmt: skip
    lab = Lab(planned, simulation.seed if seed is None else seed)
    friction, shaft = setup.effects.torsional_friction_n, setup.shaft
    return SimulatedStation(
        lab.stage, lab.force_sensor, lab.tracker, lab.clock, lab,
        registration=Registration(coil_offset_mm=setup.effects.coil_offset_mm),
        torsion=Torsion(shaft.torsional_stiffness_n_mm2, friction) if friction else None,
        needle_length_mm=shaft.length_mm, fibre=setup.fibre, plane=setup.ultrasound,
        more={
            **({Source.FIBRE: lab.fibre} if setup.fibre else {}),
            **({Source.IMAGE: lab.ultrasound} if setup.ultrasound else {}),
        },
    )  # fmt: skip


def _plane_entry(entry: SimulatedEntry, start: Pose) -> SimulatedEntry:
    """Return the entry with the pose of the guide for which the tip enters the tissue at the pose `start`."""
    needle, guide = entry.needle, start
    if needle:
        guide = guide_pose(start, needle)
        # SimulatedEntry multiplies `side` by the bevel at `roll_rad`. At the entry the bevel is `start.bevel` instead.
        roll_bevel = 1 if math.cos(entry.roll_rad) >= 0 else -1
        needle = replace(needle, side=needle.side * start.bevel * roll_bevel)
    return replace(entry, x_mm=guide.x_mm, y_mm=guide.y_mm, heading_rad=guide.heading_rad, needle=needle)


def _space_entry(entry: SimulatedEntry, start: SpacePose) -> SimulatedEntry:
    """Return the entry with the guide at `start`."""
    heading, elevation = start.angles_rad
    x, y, z = start.position_mm
    return replace(entry, x_mm=x, y_mm=y, z_mm=z, heading_rad=heading, guide_elevation_rad=elevation)
