"""The process of the robot: it steps the plant, and tells the sensors what they measure."""

from __future__ import annotations

import socket
from multiprocessing.connection import Connection

from needleplan.devices import ForceSample, PoseSample, no_long_collections
from needleplan.devices.processes import FeedSender, LabPlaces, Ready, Served, call_at_end, place_or_tell, tell
from needleplan.devices.robot import RobotLimits, RobotMachine, RobotServer
from needleplan.simulation.lab import Lab
from needleplan.simulation.processes.drive import PlantDrive, limits_of
from needleplan.simulation.setup import Setup

__all__ = ["serve_robot"]


def serve_robot(
    boss: Connection, setup: Setup, seed: int, places: LabPlaces, limits: RobotLimits,
    to_force: socket.socket, to_tracker: socket.socket,
) -> None:  # fmt: skip
    """Step the plant in real time, and be the robot."""
    forces, poses = FeedSender(to_force), FeedSender(to_tracker)
    begun = False

    def measured(sample: ForceSample | PoseSample) -> None:
        nonlocal begun
        (forces if isinstance(sample, ForceSample) else poses).send(sample)
        if not begun:  # who opened a sensor earlier would find one that does not measure
            begun = True
            assert server is not None
            boss.send(Ready(server.address))

    lab = Lab(setup, seed)
    machine = RobotMachine(PlantDrive(lab, measured), limits, limits_of(lab))
    server = place_or_tell(boss, lambda: RobotServer(machine, places.host, places.robot_port))
    if server is None:
        return
    call_at_end(boss, server.stop)
    with no_long_collections():
        server.run()
    server.close()
    tell(boss, Served(server.ticks, machine.overruns, server.worst_overrun_s))
