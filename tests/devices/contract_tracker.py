"""What every tracker does, whoever makes it: a class of tests for each of them to inherit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import pytest

from needleplan.devices import Health, PoseSample, Tracker
from needleplan.errors import LinkClosed


class TrackerContract:
    """Offer a fixture `tracker`: open, with its coil in view and at rest or slowly moving."""

    @pytest.fixture
    def tracker(self) -> Iterator[Tracker]:
        raise NotImplementedError

    @staticmethod
    def read(tracker: Tracker) -> PoseSample:
        sample = tracker.read(2.0)
        assert sample is not None
        return sample

    def test_frames_come_in_order_with_their_time(self, tracker: Tracker) -> None:
        samples = [self.read(tracker) for _ in range(10)]
        numbers = [each.stamp.sequence for each in samples]
        assert numbers == sorted(set(numbers))
        times = [each.stamp.received_ns for each in samples]
        assert times == sorted(times)
        gaps = [after - before - 1 for before, after in pairwise(numbers)]
        assert gaps == [each.stamp.lost for each in samples[1:]]

    def test_poses_are_unit_quaternions_without_jumps(self, tracker: Tracker) -> None:
        samples = [self.read(tracker) for _ in range(10)]
        assert {each.health for each in samples} == {Health.GOOD}, [each.notes for each in samples]
        for before, after in pairwise(samples):
            assert math.hypot(*after.quaternion) == pytest.approx(1)
            assert math.fsum(a * b for a, b in zip(before.quaternion, after.quaternion, strict=True)) > 0.9
            assert math.dist(before.position_mm, after.position_mm) < 5

    def test_not_waiting_does_not_repeat_a_frame(self, tracker: Tracker) -> None:
        numbers = [each.stamp.sequence for each in (tracker.read(0) for _ in range(100)) if each is not None]
        assert numbers == sorted(set(numbers))
        assert self.read(tracker).stamp.sequence not in numbers

    def test_a_closed_tracker_says_so_and_closing_twice_is_harmless(self, tracker: Tracker) -> None:
        with tracker:
            self.read(tracker)
        tracker.close()
        with pytest.raises(LinkClosed):
            tracker.read(0)
