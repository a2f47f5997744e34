import pytest

from needleplan.devices.robot import RobotStage
from tests.devices.robot.bench import Bench


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def stage(bench: Bench) -> RobotStage:
    return bench.stage()
