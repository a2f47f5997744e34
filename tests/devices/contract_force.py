"""What every force sensor does, whoever makes it: a class of tests for each of them to inherit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import pytest

from needleplan.devices import ForceSample, ForceSensor, Health
from needleplan.errors import LinkClosed


class ForceSensorContract:
    """Offer a fixture `sensor`: an open, unloaded sensor. Nothing here loads it or moves anything."""

    @pytest.fixture
    def sensor(self) -> Iterator[ForceSensor]:
        raise NotImplementedError

    @staticmethod
    def read(sensor: ForceSensor) -> ForceSample:
        sample = sensor.read(1.0)
        assert sample is not None
        return sample

    def test_samples_come_in_order_with_their_time(self, sensor: ForceSensor) -> None:
        samples = [self.read(sensor) for _ in range(20)]
        numbers = [each.stamp.sequence for each in samples]
        assert numbers == sorted(set(numbers))
        times = [each.stamp.received_ns for each in samples]
        assert times == sorted(times)
        gaps = [after - before - 1 for before, after in pairwise(numbers)]
        assert gaps == [each.stamp.lost for each in samples[1:]]

    def test_samples_are_numbers_and_healthy(self, sensor: ForceSensor) -> None:
        sample = self.read(sensor)
        assert sample.health is Health.GOOD, sample.notes
        assert all(map(math.isfinite, (*sample.force_n, *sample.torque_n_mm)))

    def test_after_a_bias_the_force_is_zero(self, sensor: ForceSensor) -> None:
        sensor.bias()
        mean_n = [math.fsum(axis) / 20 for axis in zip(*(self.read(sensor).force_n for _ in range(20)), strict=True)]
        assert max(map(abs, mean_n)) < 0.1

    def test_not_waiting_does_not_repeat_a_sample(self, sensor: ForceSensor) -> None:
        numbers = []
        for _ in range(200):
            sample = sensor.read(0)
            if sample is not None:
                numbers.append(sample.stamp.sequence)
        assert numbers == sorted(set(numbers))

    def test_a_closed_sensor_says_so_and_closing_twice_is_harmless(self, sensor: ForceSensor) -> None:
        with sensor:
            self.read(sensor)
        sensor.close()
        with pytest.raises(LinkClosed):
            sensor.read(0)
