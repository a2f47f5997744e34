"""What every stage, force sensor and tracker must do, whoever makes it.

A test class derives from the contract and gives the three devices and a way to let time pass.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise

import pytest

from needleplan.devices import ForceSensor, Health, Stage, StageSample, Tracker
from needleplan.errors import DeviceFault


@dataclass(frozen=True)
class Devices:
    stage: Stage
    force_sensor: ForceSensor
    tracker: Tracker


class DeviceContract(ABC):
    @abstractmethod
    @contextmanager
    def devices(self) -> Iterator[Devices]:
        """Open the devices: the needle at rest at the surface, nothing missing, little noise."""

    def settled(self, stage: Stage, limit_s: float = 20.0) -> StageSample:
        """Read until the stage stands still."""
        begin = None
        while True:
            sample = stage.read(1.0)
            assert sample is not None
            begin = begin or sample.stamp.received_ns
            if not sample.moving:
                return sample
            assert sample.stamp.received_ns - begin < limit_s * 1e9

    def test_samples_come_in_order_and_once(self) -> None:
        with self.devices() as devices:
            for device in (devices.stage, devices.force_sensor, devices.tracker):
                stamps = [sample.stamp for sample in (device.read(1.0) for _ in range(5)) if sample]
                assert len(stamps) == 5
                for before, after in pairwise(stamps):
                    assert after.sequence == before.sequence + 1 + after.lost
                    assert after.received_ns >= before.received_ns

    def test_nothing_comes_at_once(self) -> None:
        with self.devices() as devices:
            while devices.tracker.read(0.0) is not None:
                pass
            assert devices.tracker.read(0.0) is None

    def test_it_goes_where_it_is_sent(self) -> None:
        with self.devices() as devices:
            devices.stage.insert(10.0, 10.0)
            assert self.settled(devices.stage).depth_mm == pytest.approx(10.0, abs=0.05)
            devices.stage.rotate(math.pi, 6.0)
            assert self.settled(devices.stage).roll_rad == pytest.approx(math.pi, abs=0.02)
            devices.stage.insert(0.0, 10.0)
            assert self.settled(devices.stage).depth_mm == pytest.approx(0.0, abs=0.05)

    def test_it_stops(self) -> None:
        with self.devices() as devices:
            devices.stage.insert(40.0, 10.0)
            for _ in range(20):
                devices.stage.read(1.0)
            devices.stage.stop()
            depth = self.settled(devices.stage).depth_mm
            assert depth < 20
            for _ in range(50):
                later = devices.stage.read(1.0)
            assert later is not None
            assert later.depth_mm == pytest.approx(depth, abs=0.05)

    def test_what_it_cannot_do_is_a_fault_and_moves_nothing(self) -> None:
        with self.devices() as devices:
            for depth, velocity in ((math.nan, 1.0), (10.0, 0.0), (10.0, -1.0), (10.0, math.inf), (1e9, 1.0)):
                with pytest.raises(DeviceFault):
                    devices.stage.insert(depth, velocity)
            for roll, speed in ((math.nan, 1.0), (1.0, 0.0), (1.0, math.nan)):
                with pytest.raises(DeviceFault):
                    devices.stage.rotate(roll, speed)
            sample = devices.stage.read(1.0)
            assert sample is not None
            assert not sample.moving

    def test_bias_takes_the_present_wrench_as_zero(self) -> None:
        with self.devices() as devices:
            devices.force_sensor.read(1.0)
            devices.force_sensor.bias()
            samples = [devices.force_sensor.read(1.0) for _ in range(20)]
            assert sum(each.force_n[2] for each in samples if each) / 20 == pytest.approx(0.0, abs=0.1)

    def test_the_tracker_sees_the_tip(self) -> None:
        with self.devices() as devices:
            sample = devices.tracker.read(1.0)
            assert sample is not None
            assert sample.health is Health.GOOD
            assert all(map(math.isfinite, sample.position_mm))
            assert math.hypot(*sample.quaternion) == pytest.approx(1.0, abs=1e-3)

    def test_closed_is_closed(self) -> None:
        with self.devices() as devices:
            for device in (devices.stage, devices.force_sensor, devices.tracker):
                device.close()
                device.close()
                with pytest.raises(DeviceFault):
                    device.read(0.0)
