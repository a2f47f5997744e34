from collections.abc import Iterator

import pytest

from needleplan.devices import ForceSensor, Stage, Tracker, VirtualClock
from needleplan.errors import SimulationError
from needleplan.simulation import Effects, Lab, Setup, SimulatedEntry, open_lab
from tests.devices.contract import ForceSensorContract, StageContract, TrackerContract


@pytest.fixture
def lab() -> Iterator[Lab]:
    effects = Effects(encoder_step_mm=0.001, force_noise_n=0.01, force_offset_n=0.5, tracker_noise_mm=0.1)
    with Lab(Setup(1 / 40, effects=effects), seed=3) as lab:
        yield lab


class TestStage(StageContract):
    @pytest.fixture
    def sensor(self, lab: Lab) -> Stage:
        return lab.stage


class TestForceSensor(ForceSensorContract):
    @pytest.fixture
    def sensor(self, lab: Lab) -> ForceSensor:
        return lab.force_sensor


class TestTracker(TrackerContract):
    @pytest.fixture
    def sensor(self, lab: Lab) -> Tracker:
        return lab.tracker


def test_waiting_for_a_sample_lets_time_pass_for_all() -> None:
    clock = VirtualClock(7_000_000)
    with Lab(Setup(0.025), clock=clock) as lab:
        frame = lab.tracker.read(1.0)
        assert frame is not None
        assert frame.stamp.received_ns == clock.now_ns() == 7_000_000 + 25_000_000
        assert len(lab.stage.waiting()) == 25
        assert [each.stamp.device_time_s for each in lab.force_sensor.waiting()] == pytest.approx(
            [0.005, 0.01, 0.015, 0.02, 0.025]
        )
        assert lab.tracker.read(0.0101) is None
        assert clock.now_ns() == 7_000_000 + 35_100_000
        clock.sleep(0.0399)
        assert [lab.tracker.read(0.0) is None for _ in range(3)] == [False, False, True]


def test_who_does_not_read_is_told_how_much_was_lost() -> None:
    with Lab(Setup(0.025)) as lab:
        lab.advance(3.0)
        sample = lab.stage.read(0.0)
        assert sample is not None
        assert (sample.stamp.lost, sample.stamp.sequence) == (1000, 1001)
        after = lab.stage.read(0.0)
        assert after is not None
        assert (after.stamp.lost, after.stamp.sequence) == (0, 1002)


def test_closing_the_stage_stops_it() -> None:
    lab = Lab(Setup(0.025, entry=SimulatedEntry(depth_mm=-10)))
    lab.stage.insert(50.0, 10.0)
    lab.advance(1.0)
    lab.close()
    lab.advance(1.0)
    assert lab.plant.insertion.velocity == pytest.approx(0, abs=1e-6)
    assert lab.plant.insertion.position < 5


def test_a_lab_has_an_address() -> None:
    with open_lab("sim://insertion?seed=9") as lab:
        assert lab.plant.seed == 9
        assert lab.plant.setup.effects.curvature_error == 0.2


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("udp://1.2.3.4", ["must be sim://SIMULATION"]),
        ("sim://", ["must be sim://SIMULATION"]),
        ("sim://insertion?sede=1&seed=x", ['did you mean "seed"?', "seed = x: must be a whole number"]),
        ("sim://insertoin", ['did you mean "insertion"?']),
    ],
)
def test_a_wrong_address_is_refused(url: str, words: list[str]) -> None:
    with pytest.raises(SimulationError) as refused:
        open_lab(url)
    assert all(word in str(refused.value) for word in words)
