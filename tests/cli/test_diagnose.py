import json
from pathlib import Path

import pytest

from needleplan.cli import main
from needleplan.diagnosis import Library, diagnose
from needleplan.models import ModelFile
from needleplan.models.effects import AugmentedModel, effect_named, effects_of
from needleplan.recording import write_records
from needleplan.reports import diagnosis as reports
from needleplan.reports.diagnosis import FILES
from tests.diagnosis.trials import BASE, recordings

# All effects of the catalogue would take several times as long.
FEW = Library([effect_named(name) for name in ("inertia", "puncture", "viscous")], BASE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("diagnose")
    ModelFile(BASE).write(place / "base.toml")
    write_records(recordings({"inertia": {"size": 2.0}}, seed=1), place / "data.csv")
    write_records(recordings({"inertia": {"size": 2.0}}, seed=1)[:1], place / "alone.csv")
    return place


@pytest.mark.slow
def test_it_names_and_writes(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reports.folder, "default_library", lambda _: FEW)
    out = folder / "found"
    assert main(["diagnose", str(folder / "base.toml"), str(folder / "data.csv"), "-o", str(out)]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("gap: the given model is off by ")
    assert "\nnamed: inertia: that inertia is missing has the probability" in shown
    assert "inertia of what hangs on the sensor" in shown
    document = json.loads((out / "diagnosis.json").read_text())
    assert document["verdict"] == "named"
    file = ModelFile.read(out / "model.toml")
    assert isinstance(file.model, AugmentedModel)
    assert file.model.effects[0].found_by == document["digest"]
    assert {each.name for each in file.parents} >= {"base", "trial 0"}


@pytest.mark.study
def test_what_the_data_cannot_carry_is_said(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folder / "alone"
    assert main(["diagnose", str(folder / "base.toml"), str(folder / "alone.csv"), "-o", str(out), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] != "named"
    assert document["removed"] == []
    assert {"noise record", "held-out trial", "second training trial"} <= document["lacks"].keys()
    assert not (out / "model.toml").exists()


@pytest.mark.parametrize(("text", "says"), [("nothing", "is not TOML"), ('schema = "x"', "must be")])
def test_a_wrong_model_is_refused(folder: Path, capsys: pytest.CaptureFixture[str], text: str, says: str) -> None:
    (folder / "wrong.toml").write_text(text)
    arguments = ["diagnose", str(folder / "wrong.toml"), str(folder / "data.csv"), "-o", str(folder / "no")]
    assert main(arguments) == 2
    assert says in capsys.readouterr().err


@pytest.mark.slow
def test_a_model_of_an_earlier_diagnosis_does_not_stay_beside_a_new_one_without_a_model(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = folder / "again"
    out.mkdir()
    for name in FILES:
        (out / name).write_text("old")
    alone = recordings({}, seed=2)[:1]  # without held-out trial and noise record, nothing is named
    found = diagnose(BASE, alone, library=FEW)
    arguments = ["diagnose", str(folder / "base.toml"), str(folder / "alone.csv"), "-o", str(out)]
    assert main(arguments) == 2
    assert "exists already; --force overwrites it" in capsys.readouterr().err
    monkeypatch.setattr(
        reports, "diagnose_records", lambda *_, **__: (found, ModelFile(BASE), Library(effects_of(BASE.channel), BASE))
    )
    main([*arguments, "--force"])
    told = capsys.readouterr().err
    assert f"removed {out / 'model.toml'}: it belongs to an earlier diagnosis" in told
    assert not (out / "model.toml").exists()
    assert not (out / "scenario.toml").exists()
    assert all(each.read_bytes() != b"old" for each in out.iterdir() if each.name != "effect_to_name.py")
    assert not (out / "next_motion_10.toml").exists()


def test_the_folder_is_tried_before_the_work(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reports, "diagnose_records", lambda *_, **__: pytest.fail("the work began"))
    for place in (folder / "data.csv", folder / "data.csv" / "below"):
        assert main(["diagnose", str(folder / "base.toml"), str(folder / "alone.csv"), "-o", str(place)]) == 2
        assert f"{place}: cannot be a folder for the results: " in capsys.readouterr().err


def test_a_file_of_references_has_no_other_role(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trial = str(folder / "alone.csv")
    arguments = ["diagnose", str(folder / "base.toml"), trial, "--reference", trial, "-o", str(folder / "no")]
    assert main(arguments) == 2
    assert "alone.csv: is given twice, or with two roles" in capsys.readouterr().err
    assert not (folder / "no").exists()


@pytest.mark.parametrize("trials", ["0", "11"])
def test_the_number_of_trials_has_a_range(folder: Path, capsys: pytest.CaptureFixture[str], trials: str) -> None:
    arguments = ["diagnose", str(folder / "base.toml"), str(folder / "data.csv"), "-o", str(folder / "no")]
    assert main([*arguments, "--trials", trials]) == 2
    assert f"--trials = {trials}: must be a whole number from 1 to 10" in capsys.readouterr().err
    assert not (folder / "no").exists()


def test_an_input_is_never_removed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = folder / "inputs"
    out.mkdir()
    ModelFile(BASE).write(out / "model.toml")
    before = (out / "model.toml").read_bytes()
    assert main(["diagnose", str(out / "model.toml"), str(folder / "data.csv"), "-o", str(out), "--force"]) == 2
    assert "which is an input file" in capsys.readouterr().err
    assert (out / "model.toml").read_bytes() == before
