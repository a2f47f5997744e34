"""The lab goes from tick to tick without detours; here it is taken by hand, one thing after the other."""

from dataclasses import replace

import pytest

from needleplan.devices import ForceSample, PoseSample, StageSample, Stamp
from needleplan.simulation import Lab, Plant, Setup, Simulation
from needleplan.simulation._sensors import ForceReading, TrackerReading


def by_hand(setup: Setup, seed: int, seconds: float) -> tuple[list[StageSample], list[ForceSample], list[PoseSample]]:
    plant, hz = Plant(setup, seed), setup.robot.servo_hz
    force, tracker = ForceReading(setup.effects, seed), TrackerReading(setup.effects, seed)
    stage: list[StageSample] = []
    forces: list[ForceSample] = []
    poses: list[PoseSample] = []
    plant.insert(8.0, 20.0)
    plant.rotate(2.0, 6.0)
    for tick in range(1, round(seconds * hz) + 1):
        plant.step()
        now_s, now_ns = tick * (1 / hz), round(tick * (1e9 / hz))
        moving = plant.insertion.moving(now_s) or plant.roll.moving(now_s)
        depth, roll = plant.insertion, plant.roll
        stamp = Stamp(now_ns, tick, device_time_s=now_s)
        stage.append(StageSample(stamp, depth.measured, depth.measured_velocity, roll.measured, moving))
        if tick % (hz // 200) == 0:
            stamp = Stamp(now_ns, tick // (hz // 200), device_time_s=now_s)
            forces.append(force.sample(stamp, plant.force_n, plant.torque_n_mm, now_s))
        if tick % (hz // 40) == 0:
            stamp = Stamp(now_ns, tick // (hz // 40), device_time_s=now_s)
            poses.append(tracker.sample(stamp, plant.frame_behind(setup.effects.coil_offset_mm)))
    return stage, forces, poses


@pytest.mark.parametrize("servo_hz", [1000, 600])
def test_the_devices_say_what_a_plant_stepped_by_hand_has(servo_hz: int) -> None:
    setup = Simulation.read("steering").setup
    effects = replace(setup.effects, respiration_across_mm=0.5, respiration_along_mm=1.0, tracker_dropout=0.0)
    setup = replace(setup, effects=effects, robot=replace(setup.robot, servo_hz=servo_hz))
    with Lab(setup, seed=4) as lab:
        lab.stage.insert(8.0, 20.0)
        lab.stage.rotate(2.0, 6.0)
        found: list[StageSample] = []
        for _ in range(30):  # in all the ways in which time passes: waiting, sleeping, advancing
            first = lab.stage.read(1.0)
            assert first is not None
            lab.clock.sleep(0.011)
            lab.advance(0.02)
            found += [first, *lab.stage.waiting()]
        forces, poses = lab.force_sensor.waiting(), lab.tracker.waiting()
    seconds = len(found) / servo_hz
    assert (found, forces, poses) == by_hand(setup, 4, seconds)
    assert seconds > 0.9
    assert len(poses) > 30


def test_asking_without_waiting_lets_no_time_pass() -> None:
    with Lab(Simulation.read("steering").setup) as lab:
        lab.advance(0.0123)
        before = lab.clock.now_ns(), lab.plant.ticks
        assert lab.tracker.read(0.0) is None
        assert (lab.clock.now_ns(), lab.plant.ticks) == before
        assert lab.force_sensor.read(0.0) is not None
