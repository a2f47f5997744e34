"""Document, report, model and motions of a diagnosis."""

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.diagnosis import Diagnosis, Library, Settings, Verdict, diagnose, ranked_hypotheses
from needleplan.models import ModelFile, simulate
from needleplan.models.effects import effect_named
from needleplan.recording import write_records
from needleplan.reports.diagnosis import (
    FILES,
    document_of,
    next_trials_of,
    traces_of,
    write_folder,
)
from needleplan.reports.diagnosis.words import advice
from needleplan.signals import lspb
from tests.diagnosis.trials import BASE, recordings
from tests.pages import ROOT

FEW = Library([effect_named(name) for name in ("viscous", "stribeck", "relaxation", "drift")], BASE)
WEAK, STRONG = 1.7e-5, 1e-4


@pytest.fixture(scope="module")
def weak() -> Diagnosis:
    return diagnose(BASE, recordings({"viscous": {"size": WEAK}}, seed=1), library=FEW)


@pytest.fixture(scope="module")
def strong() -> Diagnosis:
    return diagnose(BASE, recordings({"viscous": {"size": STRONG}}, seed=1), library=FEW)


def against_the_schema(document: dict[str, Any]) -> list[str]:
    """Return what contradicts the schema of the documentation."""
    validator = pytest.importorskip("jsonschema").Draft202012Validator
    schema = json.loads((ROOT / "docs/reference/diagnosis.schema.json").read_text())
    return [error.message for error in validator(schema).iter_errors(document)]


@pytest.mark.slow
def test_every_hypothesis_has_a_reason_and_the_most_probable_is_first(weak: Diagnosis) -> None:
    ranked = ranked_hypotheses(weak, 12)
    probabilities = [each.probability for each in ranked]
    assert probabilities == sorted(probabilities, reverse=True)
    assert ((), "") in [(each.effects, each.component) for each in ranked]
    assert ranked[0].because.startswith("it leads ")
    assert all(re.match(r"\d+\.\d nats behind", each.because) for each in ranked[1:])


def test_the_parts_of_a_reason_add_up_to_the_whole(weak: Diagnosis) -> None:
    found = weak
    top, names = found.posterior.ranked[0][1:], ("viscous",)
    row = next(each for each in ranked_hypotheses(found, 50) if each.effects == names and not each.component)
    behind = found.posterior.logs[top] - found.posterior.logs[names, ""]
    parts = 0.0
    for sentence in row.because.split(": ", 1)[1].split("; "):
        size = float(re.findall(r"([\d.]+) nats", sentence)[0])
        parts += -size if re.search("better|less freedom|more probable", sentence) else size
    assert parts == pytest.approx(behind, abs=1.2)  # a part below 1 nat is left out


@pytest.mark.slow
def test_a_named_effect_has_an_interval_and_needs_no_motion(strong: Diagnosis) -> None:
    assert next_trials_of(strong) is None
    document = document_of(strong, traces_of(strong), None)
    assert (document["verdict"], document["names"]) == ("named", ["viscous"])
    assert not against_the_schema(document)
    assert against_the_schema({**document, "other": 1})
    [effect] = document["effects"]
    assert effect["parameters"]["size"]["low"] < STRONG < effect["parameters"]["size"]["high"]
    assert effect["probability"] > 0.9
    assert effect["share"] == 1
    nothing = next(each for each in document["hypotheses"] if not each["effects"] and not each["component"])
    assert "its fit is worse by" in nothing["because"]
    held = document["held_out"]
    assert held["after_rms"] < 1.1 * held["floor_rms"] < held["before_rms"]
    assert held["shrink"] == pytest.approx(strong.shrink)
    assert 0.5 < strong.shrink <= 1


@pytest.mark.slow
def test_the_report_begins_with_the_gap_and_says_what_the_document_says(weak: Diagnosis, tmp_path: Path) -> None:
    next_ = next_trials_of(weak, 2)
    assert next_ is not None
    written = write_folder(weak, ModelFile(BASE), FEW, str(tmp_path / "new"), next_=next_)
    names = [Path(each).name for each in written]
    assert names[:3] == ["diagnosis.json", "report.html", "traces.h5"]
    assert "model.toml" not in names
    document = json.loads(Path(written[0]).read_text())
    assert not against_the_schema(document)
    page = Path(written[1]).read_text()
    assert page.startswith("<!DOCTYPE html>")
    assert "<script" not in page
    assert "Gap budget" in page[page.index("<table>") :][:200]
    for each in document["hypotheses"]:
        assert each["because"] in page
    assert sum(each["probability"] for each in document["hypotheses"]) <= 1.0001
    assert len(document["settings"]) == len(Settings().described())
    motions = document["next_motion"]["motions"]
    assert len(motions) == 2
    assert {each["file"] for each in motions if each["file"]} == {each for each in names if each.startswith("next")}
    assert document["next_motion"]["bits"] >= document["next_motion"]["repeated_bits"]
    for name in names:
        if name.startswith("next"):  # the parameters of the given model, not of the calibrated one
            assert tomllib.loads((tmp_path / "new" / name).read_text())["tissue"]["cutting_n"] == BASE.cutting


@pytest.mark.slow
def test_beside_a_base_of_other_laws_the_advice_is_another_base_and_no_motion(weak: Diagnosis) -> None:
    next_ = next_trials_of(weak)
    assert next_ is not None
    ambiguous = replace(weak.decision, verdict=Verdict.AMBIGUOUS)
    unsure = replace(weak, decision=ambiguous)
    one = replace(next_, motions=next_.motions[:1])
    assert any("Record the motion below" in each for each in advice(unsure, one))
    assert any("Record the motions below" in each for each in advice(unsure, replace(one, motions=one.motions * 2)))
    again = replace(one.motions[0], program=None, repeats="first")
    assert any("Record first once more" in each for each in advice(unsure, replace(one, motions=(again,))))
    lawless = replace(weak, decision=replace(ambiguous, other_laws=("friction reverses",)))
    found = list(advice(lawless, next_))
    assert not any("below" in each for each in found)
    assert any("extend the law" in each for each in found)


def test_parts_of_the_gap_have_shares_and_the_limits_are_those_of_a_name(strong: Diagnosis) -> None:
    axes = {each.axis for each in strong.where}
    assert {"depth_mm", "speed_mm_s", "phase"} <= axes
    for axis in axes:
        assert sum(each.share for each in strong.where if each.axis == axis) == pytest.approx(1)
    limit = next(each for each in strong.detection_limits if each.effect == "viscous")
    assert limit.visible
    assert 0 < limit.amplitude < STRONG


@pytest.mark.slow
def test_the_command_writes_all_files_and_the_model_predicts_a_further_trial(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ModelFile(BASE).write(tmp_path / "base.toml")
    write_records(recordings({"viscous": {"size": STRONG}}, seed=1), tmp_path / "data.csv")
    out = tmp_path / "out"
    assert main(["diagnose", str(tmp_path / "base.toml"), str(tmp_path / "data.csv"), "-o", str(out), "--verbose"]) == 0
    assert capsys.readouterr().out.splitlines()[2].startswith("named: viscous: ")
    written = {each.name for each in out.iterdir()}
    assert written == {"diagnosis.json", "report.html", "traces.h5", "model.toml"}
    assert written < set(FILES)
    file, document = ModelFile.read(out / "model.toml"), json.loads((out / "diagnosis.json").read_text())
    assert document["source"]["data"] == [str(tmp_path / "data.csv")]
    added = file.model.effects[0]
    assert (added.name, added.estimates["size"].low < STRONG < added.estimates["size"].high) == ("viscous", True)
    assert added.found_by == document["digest"]
    truth = effect_named("viscous").apply(file.model.base, {"size": STRONG})
    path = lspb([-2, 50, 20, -2], [3, 12, 9], rate_hz=50.0)
    wanted = simulate(truth, path).output
    gap, left = (float(np.std(simulate(each, path).output - wanted)) for each in (file.model.base, file.model))
    assert left < 0.2 * gap


@pytest.mark.slow
def test_a_diagnosis_without_a_name_removes_what_an_earlier_one_wrote(weak: Diagnosis, tmp_path: Path) -> None:
    for name in ("model.toml", "next_motion_2.toml"):
        (tmp_path / name).write_text("of yesterday")
    write_folder(weak, ModelFile(BASE), FEW, str(tmp_path))
    assert not (tmp_path / "model.toml").exists()
    assert not (tmp_path / "next_motion_2.toml").exists()
    write_folder(weak, ModelFile(BASE), FEW, str(tmp_path), merge_anyway=True)
    assert (tmp_path / "model.toml").exists() == bool(weak.likely)
