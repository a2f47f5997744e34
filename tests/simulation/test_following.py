"""A lab that follows a robot outside: the needle moves with the positions that the robot reports."""

import contextlib
import math
import socket
import threading
import time

import pytest

from needleplan.devices import open_link
from needleplan.devices.robot import (
    RobotLimits,
    RobotMachine,
    RobotRelay,
    RobotServer,
    RobotStage,
    RobotTiming,
    SteadyDrive,
)
from needleplan.errors import DeviceFault
from needleplan.simulation import Plant, Simulation
from needleplan.simulation._axis import SimulatedAxis

PATIENT = RobotLimits(longest_silence_s=20.0, longest_valid_s=20.0)


def axis() -> SimulatedAxis:
    return SimulatedAxis(0.0, interval_s=0.001, bandwidth_hz=20.0, acceleration=100.0, resolution=0.0)


def test_an_axis_takes_the_first_sample_over_and_follows_a_motion_without_lag() -> None:
    followed = axis()
    followed.follow(-3.0, 0.0)
    assert followed.position == -3.0
    for tick in range(200):
        followed.follow(-3.0 + 0.005 * tick, 5.0)
        followed.step(0.001 * tick)
    assert followed.position == pytest.approx(-3.0 + 0.005 * 199, abs=0.006)
    assert (followed.velocity, followed.measured_velocity) == pytest.approx((5.0, 5.0))
    followed.follow(math.nan, 0.0)
    followed.follow(-2.0, 0.0)
    for tick in range(200, 300):
        followed.step(0.001 * tick)
    assert followed.position == pytest.approx(-2.0, abs=1e-6)


def test_force_and_tip_are_those_of_a_needle_that_the_robot_has_inserted() -> None:
    plant = Plant(Simulation.read("steering").setup, 1)
    depth_mm, begin_mm = plant.insertion.position, plant.insertion.position
    forces = []
    while depth_mm < 20.0:
        plant.insertion.follow(depth_mm, 5.0)
        plant.roll.follow(0.0, 0.0)
        plant.step()
        forces.append(plant.force_n)
        depth_mm += 0.005
    assert plant.path_mm == pytest.approx(20.0, abs=1.5)  # the tissue goes along with the needle
    assert plant.tip().position_mm[0] > begin_mm + 15.0
    assert abs(plant.tip().position_mm[1]) > 0.5  # its bevel bends it
    assert max(forces[-1000:]) > max(forces[:100]) + 0.05


def test_a_relay_passes_commands_and_statuses_on_and_reads_them() -> None:
    seen: list[float] = []
    ticks: list[float] = []
    timing = RobotTiming(silence_s=20.0, valid_s=20.0, answer_s=20.0, lost_s=20.0)
    with RobotServer(RobotMachine(SteadyDrive(), PATIENT, key=b"a key of 16 bytes")) as robot:
        relay = RobotRelay((robot.host, robot.port), lambda status: seen.append(status.depth_mm), ticks.append)
        thread = threading.Thread(target=relay.run)
        thread.start()
        try:
            with pytest.raises(DeviceFault, match="requires another key"):
                RobotStage.open(relay.address, timing=timing)
            with RobotStage(open_link(relay.address), timing=timing, key=b"a key of 16 bytes") as stage:
                stage.insert(0.5, 10.0)
                end_s = time.monotonic() + 20.0
                while (sample := stage.read(1.0)) is None or sample.moving:
                    assert time.monotonic() < end_s
                    stage.heartbeat()
        finally:
            relay.stop()
            thread.join()
            relay.close()
    assert max(seen) == pytest.approx(0.5, abs=0.02)
    assert relay.ticks == len(ticks) > 10
    assert relay.statuses == len(seen)


def test_a_relay_survives_more_controllers_than_it_has_ways_for() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot, contextlib.ExitStack() as stack:
        robot.bind(("127.0.0.1", 0))
        robot.settimeout(20.0)
        relay = RobotRelay(robot.getsockname(), lambda _: None, lambda _: None)
        host, port = relay.address.removeprefix("udp://").split(":")
        peers = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(17)]
        thread = threading.Thread(target=relay.run)
        for peer in peers[:16]:
            peer.sendto(b"hello", (host, int(port)))
        thread.start()
        try:
            first, *_ = [robot.recvfrom(64)[1] for _ in range(16)]
            relay.stop()
            thread.join()
            # Both wait: a 17th controller, for which the oldest way is closed, and an answer on this way.
            peers[16].sendto(b"hello", (host, int(port)))
            robot.sendto(b"answer", first)
            relay._stopping.clear()
            thread = threading.Thread(target=relay.run)
            thread.start()
            assert robot.recvfrom(64)[0] == b"hello"
            peers[16].sendto(b"again", (host, int(port)))
            assert robot.recvfrom(64)[0] == b"again"
        finally:
            relay.stop()
            thread.join()
            relay.close()
