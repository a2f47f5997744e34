"""From the lab twin through identification and back to the plant's parameters."""

from pathlib import Path

import pytest

from needleplan.identification import curvature, friction
from needleplan.models.friction import LumpedLuGre
from needleplan.recording import read_records, write_records
from needleplan.signals import MovingAverage
from needleplan.simulation import Simulation, run_simulation


@pytest.mark.slow
def test_the_curvature_of_the_plant_is_found_and_not_that_of_the_plan(tmp_path: Path) -> None:
    simulation = Simulation.read("insertion")
    file = tmp_path / "run.h5"
    write_records([run_simulation(simulation, seed).record() for seed in (1, 2, 3, 4)], file)
    found = curvature.identify(read_records(file)).estimates["curvature_per_mm"]
    planned = simulation.setup.plan_curvature_per_mm
    assert found.low < 1.2 * planned < found.high
    assert found.low > planned


@pytest.mark.slow
def test_the_friction_of_the_plant_is_found() -> None:
    simulation = Simulation.read("friction")
    true = simulation.setup.friction
    assert isinstance(true, LumpedLuGre)
    record = run_simulation(simulation).record()
    found = friction.identify([record], models=("Karnopp", "II"), smooth=MovingAverage(5).centred)
    assert found.model is not None
    assert found.model.name == "lumped_lugre"
    for name, estimate in found.estimates.items():
        # Six 95 % intervals at once: each has to hold at the level of 99.9 %, 1.7 times as wide.
        reach = 1.7 * (estimate.high - estimate.low) / 2
        assert estimate.value == pytest.approx(getattr(true, name), abs=reach), name
        assert estimate.value == pytest.approx(getattr(true, name), rel=0.1), name
