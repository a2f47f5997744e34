"""The three devices of an insertion by their addresses: real ones, or those of one simulated lab."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TypeVar

from needleplan.devices import Address, Closing, Device, ForceSensor, Stage, Station, SystemClock, Tracker
from needleplan.errors import AddressError, DeviceFault, Mistake
from needleplan.estimation.registration import Registration
from needleplan.models import Torsion
from needleplan.planning import PolicyTable, Pose
from needleplan.simulation import Entry, Experiment, Lab

__all__ = ["Bench", "are_simulated", "open_bench", "simulated_bench"]

_SIM = "sim"
_DEFAULT_EXPERIMENT = "steering"
_D = TypeVar("_D", bound=Device)


@dataclass(frozen=True)
class Bench(Closing):
    """Open devices. `lab` is the simulated lab that they are in, if any, and `truth` knows what no sensor tells.

    `registration`, `torsion` and `needle_length_mm` are those of the simulated lab; with real devices somebody must
    say them.
    """

    station: Station
    lab: Lab | None = None
    registration: Registration | None = None
    torsion: Torsion | None = None
    needle_length_mm: float | None = None

    def close(self) -> None:
        """Close all devices; closing twice is harmless."""
        with ExitStack() as closing:
            for device in (self.station.tracker, self.station.force_sensor, self.station.stage):
                closing.callback(device.close)

    @property
    def true_tip_mm(self) -> tuple[float, float, float] | None:
        """Where the tip really is, in the simulated lab."""
        return self.lab.plant.tip().position_mm if self.lab else None


def are_simulated(robot: str, force: str, tracker: str) -> bool:
    """Return whether three addresses are those of one simulated lab. Raises AddressError where they cannot be used."""
    addresses = {"--robot": robot, "--force": force, "--tracker": tracker}
    schemes, wrong = {}, []
    for name, address in addresses.items():
        try:
            schemes[name] = Address.parse(address).scheme
        except AddressError as error:
            wrong += [replace(mistake, key=name) for mistake in error.mistakes]
    if wrong:
        raise AddressError(wrong)
    simulated = [name for name, scheme in schemes.items() if scheme == _SIM]
    if len(simulated) == len(addresses):
        if len(set(addresses.values())) > 1:
            rule = "must be the same address as that of the other two: a simulated lab has all three devices"
            raise AddressError([Mistake(name, address, rule) for name, address in addresses.items()])
        return True
    known = {"--robot": [*_ROBOTS], "--force": [*_FORCES], "--tracker": [*_TRACKERS]}
    mistakes = [
        Mistake(name, addresses[name], f"must begin with {', '.join(f'{each}://' for each in (*known[name], _SIM))}")
        for name, scheme in schemes.items() if scheme not in known[name] and scheme != _SIM
    ]  # fmt: skip
    rule = "cannot be simulated where the others are not: their times are not the same"
    mistakes += [Mistake(name, addresses[name], rule) for name in simulated]
    if mistakes:
        raise AddressError(mistakes)
    return False


def open_bench(robot: str, force: str, tracker: str, table: PolicyTable, start: Pose) -> Bench:
    """Open the devices at three addresses.

    `sim://[EXPERIMENT][?seed=N]`, the same three times, is one simulated lab into which the needle goes at `start`.
    Raises AddressError for addresses that are wrong or do not go together, ConfigurationError and DeviceFault where a
    device is not what it should be. What was opened before is closed again.
    """
    addresses = {"--robot": robot, "--force": force, "--tracker": tracker}
    if are_simulated(robot, force, tracker):
        return _one_lab(addresses, table, start)
    with ExitStack() as opened:
        # The stage comes last: nothing that can move is held while somebody else is waited for.
        sensor = _opened(_FORCES, force, opened)
        eyes = _opened(_TRACKERS, tracker, opened)
        stage = _opened(_ROBOTS, robot, opened)
        opened.pop_all()
    return Bench(Station(stage, sensor, eyes, SystemClock()))


def simulated_bench(experiment: Experiment, table: PolicyTable, start: Pose, seed: int | None = None) -> Bench:
    """Return the devices of a lab into which the needle goes at `start` and bends as planned, but for the effects."""
    setup = experiment.setup
    entry = Entry(start.x_mm, start.y_mm, start.heading_rad, setup.entry.depth_mm, setup.entry.roll_rad)
    planned = replace(
        setup, entry=entry, scenario=table.scenario,
        plan_curvature_per_mm=1 / table.scenario.needle.curvature_radius_mm,
        tissue=replace(setup.tissue, curvature_per_mm=None),
        layers=tuple(replace(layer, curvature_per_mm=None) for layer in setup.layers),
    )  # fmt: skip
    lab = Lab(planned, experiment.seed if seed is None else seed)
    friction, shaft = setup.effects.torsional_friction_n, setup.shaft
    return Bench(
        Station(lab.stage, lab.force_sensor, lab.tracker, lab.clock),
        lab,
        Registration(coil_offset_mm=setup.effects.coil_offset_mm),
        Torsion(shaft.torsional_stiffness_n_mm2, friction) if friction else None,
        shaft.length_mm,
    )


def _one_lab(addresses: Mapping[str, str], table: PolicyTable, start: Pose) -> Bench:
    address = Address.parse(addresses["--robot"])
    address.only(("seed",))
    seed = address.option("seed", int, -1)
    if seed < -1 or (seed == -1 and "seed" in address.options):
        raise AddressError(Mistake("seed", str(seed), "must be a whole number from 0"), str(address))
    # A host is not case sensitive for the parser of addresses; the path of a file is.
    name = addresses["--robot"].partition("://")[2].partition("?")[0] or _DEFAULT_EXPERIMENT
    return simulated_bench(Experiment.read(name), table, start, None if seed == -1 else seed)


def _opened(openers: Mapping[str, Callable[[str], _D]], address: str, opened: ExitStack) -> _D:
    device = openers[Address.parse(address).scheme](address)
    opened.callback(_close, device)
    return device


def _close(device: Device) -> None:
    with contextlib.suppress(DeviceFault):
        device.close()


def _robot(address: str) -> Stage:
    from needleplan.devices.robot import RobotStage

    return RobotStage.open(address)


def _drives(address: str) -> Stage:
    from needleplan.devices.cia402 import CanopenStage

    return CanopenStage.open(address)


def _net_ft(address: str) -> ForceSensor:
    from needleplan.devices.ati import NetFt

    return NetFt.open(address)


def _ndi(address: str) -> Tracker:
    from needleplan.devices.ndi import NdiTracker

    return NdiTracker.open(address)


def _igtl(address: str) -> Tracker:
    from needleplan.devices.igtl import IgtlTracker

    return IgtlTracker.open(address)


_ROBOTS: dict[str, Callable[[str], Stage]] = {"udp": _robot, "canopen": _drives}
_FORCES: dict[str, Callable[[str], ForceSensor]] = {"udp": _net_ft}
_TRACKERS: dict[str, Callable[[str], Tracker]] = {"serial": _ndi, "tcp": _ndi, "igtl": _igtl}
