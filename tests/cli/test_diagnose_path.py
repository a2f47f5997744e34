"""From a diagnosis of a tip's path to all that loads its model: planner, tip filter, lab twin."""

import argparse
import json
from pathlib import Path

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.cli.plan import with_identified
from needleplan.estimation.registration import Registration
from needleplan.estimation.tip import TipFilter
from needleplan.models import ModelFile, ShaftAndTip, simulate
from needleplan.recording import write_records
from needleplan.scenario import Scenario
from needleplan.signals import Role
from needleplan.simulation import Simulation, run_simulation
from tests.diagnosis.tip_trials import BASE, recordings

SIMULATION = """schema = "needleplan.simulation/1"
model = "found/model.toml"
[robot]
servo_hz = 200
[[move]]
insert_to_mm = 60.0
velocity_mm_s = 20.0
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("path")
    ModelFile(BASE).write(place / "base.toml")
    hidden = {"curvature_layer": {"size": 0.6, "depth_mm": 30.0}}
    write_records(recordings(hidden, seed=3), place / "data.csv")
    ModelFile(ShaftAndTip(friction=0.012, cutting=0.4, onset_mm=4.0, presliding_mm=0.05)).write(place / "force.toml")
    return place


@pytest.mark.slow
def test_what_was_diagnosed_is_planned_estimated_and_simulated(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    assert main(["diagnose", "base.toml", "data.csv", "-o", "found", "--scenario", "prostate"]) == 0
    shown = capsys.readouterr().out
    assert "layers behind it: 1" in shown
    assert "Curvature with the named effects: curvature_layer" in shown
    assert (
        Path("found/scenario.toml").read_text().startswith("# Curvature with the named effects: curvature_layer. Diag")
    )
    scenario = Scenario.read("found/scenario.toml")
    (layer,) = scenario.needle.layers
    assert 27 < layer.from_mm < 32
    assert scenario.needle.curvature_radius_mm / layer.curvature_radius_mm == pytest.approx(1.6, abs=0.2)

    options = argparse.Namespace(needle="found/model.toml", tissue=[], scenario="prostate")
    planned, (replaced,) = with_identified(Scenario.read("prostate"), options)
    assert len(replaced.found.pieces) == 2
    assert planned.needle.layers[0].from_mm == pytest.approx(layer.from_mm, abs=1.5)

    model = ModelFile.read("found/model.toml").model
    record = run_simulation(Simulation.from_toml(SIMULATION)).record()
    seen = record.select(np.isfinite(record["x_mm"]))
    said = simulate(model, seen.motion()).output
    assert np.array([seen[name] for name in ("x_mm", "y_mm", "z_mm")]) == pytest.approx(said, abs=0.1)

    predictor = TipFilter.for_scenario(scenario, Registration(), (0.0, 35.0, 0.0))._predictor
    deep, shallow = (predictor.planned_at(np.array([x_mm, 35.0, 0.0])) for x_mm in (50.0, 10.0))
    assert deep / shallow == pytest.approx(1.6, abs=0.2)


@pytest.mark.study
def test_without_a_name_the_scenario_has_the_calibrated_curvature(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    hidden = {"curvature_layer": {"size": 0.6, "depth_mm": 30.0}}
    write_records([each for each in recordings(hidden, seed=3) if each.role is not Role.HOLDOUT], "few.csv")
    assert main(["diagnose", "base.toml", "few.csv", "-o", "open", "--scenario", "prostate"]) == 1
    assert "plan: Curvature calibrated to these recordings, without effects" in capsys.readouterr().out
    text = Path("open/scenario.toml").read_text()
    assert text.startswith("# Curvature calibrated to these recordings, without effects (verdict: ambiguous)")
    needle = Scenario.read("open/scenario.toml").needle
    assert not needle.layers
    said = json.loads(Path("open/diagnosis.json").read_text())["base"]["curvature_per_mm"]
    assert needle.curvature_radius_mm == pytest.approx(1 / said["value"], rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["force.toml", "--scenario", "prostate"], "tip's 3D path"),
        (["base.toml", "--scenario", "nowhere"], "nowhere"),
        (["base.toml", "--scenario", "prostate", "--speed", "0"], "--speed"),
    ],
)
def test_what_no_plan_follows_from_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], says: str
) -> None:
    model, *rest = arguments
    assert main(["diagnose", str(folder / model), str(folder / "data.csv"), "-o", str(folder / "no"), *rest]) == 2
    assert says in capsys.readouterr().err
    assert not (folder / "no").exists()
