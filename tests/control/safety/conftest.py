import pytest

from needleplan.control.safety import GuardedStage
from tests.control.safety.bench import Bench


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def guard(bench: Bench) -> GuardedStage:
    return bench.enabled()
