"""What every stage, force sensor and tracker does, whoever makes it: a class of tests for each of them to inherit.

A test class offers a fixture `sensor`: the open device, at rest, with nothing missing, unloaded, and hardly any noise.
It may be one in this process, one behind a real line, or hardware.
"""

import math
from itertools import pairwise
from typing import Any

import pytest

from needleplan.devices import ForceSensor, Health, Stage, StageSample, Tracker
from needleplan.errors import DeviceFault


def heard_and_read(stage: Stage, timeout_s: float) -> StageSample | None:
    """Do one iteration of a loop that is alive: a heartbeat, and the next sample."""
    stage.heartbeat()
    return stage.read(timeout_s)


class SensorContract:
    """What all of them do; a stage is a sensor of where it is."""

    @staticmethod
    def read(sensor: Any) -> Any:
        if isinstance(sensor, Stage):
            sensor.heartbeat()
        sample = sensor.read(2.0)
        assert sample is not None
        return sample

    def test_samples_come_in_order_with_their_time(self, sensor: Any) -> None:
        samples = [self.read(sensor) for _ in range(20)]
        numbers = [each.stamp.sequence for each in samples]
        assert numbers == sorted(set(numbers))
        times = [each.stamp.received_ns for each in samples]
        assert times == sorted(times)
        gaps = [after - before - 1 for before, after in pairwise(numbers)]
        assert gaps == [each.stamp.lost for each in samples[1:]]

    def test_not_waiting_does_not_repeat_a_sample(self, sensor: Any) -> None:
        numbers = [each.stamp.sequence for each in (sensor.read(0) for _ in range(200)) if each is not None]
        assert numbers == sorted(set(numbers))
        assert self.read(sensor).stamp.sequence not in numbers

    def test_a_closed_one_says_so_and_closing_twice_is_harmless(self, sensor: Any) -> None:
        with sensor:
            self.read(sensor)
        sensor.close()
        with pytest.raises(DeviceFault):
            sensor.read(0)


class ForceSensorContract(SensorContract):
    def test_samples_are_numbers_and_healthy(self, sensor: ForceSensor) -> None:
        sample = self.read(sensor)
        assert sample.health is Health.GOOD, sample.notes
        assert all(map(math.isfinite, (*sample.force_n, *sample.torque_n_mm)))

    def test_after_a_bias_the_force_is_zero(self, sensor: ForceSensor) -> None:
        sensor.bias()
        mean_n = [math.fsum(axis) / 20 for axis in zip(*(self.read(sensor).force_n for _ in range(20)), strict=True)]
        assert max(map(abs, mean_n)) < 0.1


class TrackerContract(SensorContract):
    def test_poses_are_unit_quaternions_without_jumps(self, sensor: Tracker) -> None:
        samples = [self.read(sensor) for _ in range(10)]
        assert {each.health for each in samples} == {Health.GOOD}, [each.notes for each in samples]
        for before, after in pairwise(samples):
            assert math.hypot(*after.quaternion) == pytest.approx(1)
            assert math.fsum(a * b for a, b in zip(before.quaternion, after.quaternion, strict=True)) > 0.9
            assert math.dist(before.position_mm, after.position_mm) < 5


class StageContract(SensorContract):
    def settled(self, stage: Stage, limit_s: float = 20.0) -> StageSample:
        """Read until the stage stands still."""
        begin = None
        while True:
            sample = heard_and_read(stage, 1.0)
            assert sample is not None
            begin = begin or sample.stamp.received_ns
            if not sample.moving:
                return sample
            assert sample.stamp.received_ns - begin < limit_s * 1e9

    def test_it_goes_where_it_is_sent(self, sensor: Stage) -> None:
        sensor.insert(10.0, 10.0)
        assert self.settled(sensor).depth_mm == pytest.approx(10.0, abs=0.05)
        sensor.rotate(math.pi, 6.0)
        assert self.settled(sensor).roll_rad == pytest.approx(math.pi, abs=0.02)
        sensor.insert(0.0, 10.0)
        assert self.settled(sensor).depth_mm == pytest.approx(0.0, abs=0.05)

    def test_it_stops(self, sensor: Stage) -> None:
        sensor.insert(40.0, 10.0)
        for _ in range(20):
            heard_and_read(sensor, 1.0)
        sensor.stop()
        depth = self.settled(sensor).depth_mm
        assert depth < 20
        for _ in range(50):
            later = heard_and_read(sensor, 1.0)
        assert later is not None
        assert later.depth_mm == pytest.approx(depth, abs=0.05)

    def test_what_it_cannot_do_is_a_fault_and_moves_nothing(self, sensor: Stage) -> None:
        for depth, velocity in ((math.nan, 1.0), (10.0, 0.0), (10.0, -1.0), (10.0, math.inf), (1e9, 1.0)):
            with pytest.raises(DeviceFault):
                sensor.insert(depth, velocity)
        for roll, speed in ((math.nan, 1.0), (1.0, 0.0), (1.0, math.nan)):
            with pytest.raises(DeviceFault):
                sensor.rotate(roll, speed)
        sample = sensor.read(1.0)
        assert sample is not None
        assert not sample.moving
