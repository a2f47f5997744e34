from __future__ import annotations

import json
from pathlib import Path

import pytest

from needleplan.cli import main
from needleplan.models import ModelFile
from needleplan.models.effects import AugmentedModel
from needleplan.recording import write_records
from tests.diagnosis.trials import BASE, recordings


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("diagnose")
    ModelFile(BASE).write(place / "base.toml")
    write_records(recordings({"inertia": {"size": 2.0}}, seed=1), place / "data.csv")
    write_records(recordings({"inertia": {"size": 2.0}}, seed=1)[:1], place / "alone.csv")
    return place


@pytest.mark.slow
def test_it_names_and_writes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folder / "found"
    assert main(["diagnose", str(folder / "base.toml"), str(folder / "data.csv"), "-o", str(out)]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("named: passes all gates")
    assert "inertia of what hangs on the sensor" in shown
    document = json.loads((out / "diagnosis.json").read_text())
    assert document["verdict"] == "named"
    file = ModelFile.read(out / "model.toml")
    assert isinstance(file.model, AugmentedModel)
    assert file.model.effects[0].found_by == document["digest"]
    assert {each.name for each in file.parents} >= {"base", "trial 0"}


@pytest.mark.slow
def test_what_the_data_cannot_carry_is_said(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folder / "alone"
    assert main(["diagnose", str(folder / "base.toml"), str(folder / "alone.csv"), "-o", str(out), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] != "named"
    assert {"noise record", "held-out trial", "second training trial"} <= document["lacks"].keys()
    assert not (out / "model.toml").exists()


@pytest.mark.parametrize(("text", "says"), [("nothing", "is not TOML"), ('schema = "x"', "must be")])
def test_a_wrong_model_is_refused(folder: Path, capsys: pytest.CaptureFixture[str], text: str, says: str) -> None:
    (folder / "wrong.toml").write_text(text)
    arguments = ["diagnose", str(folder / "wrong.toml"), str(folder / "data.csv"), "-o", str(folder / "no")]
    assert main(arguments) == 2
    assert says in capsys.readouterr().err
