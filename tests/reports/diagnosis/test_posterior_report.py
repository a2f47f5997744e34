"""The second edition's ranked table, its reasons, and its files."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from needleplan.cli import main
from needleplan.diagnosis import Library
from needleplan.diagnosis.posterior import Settings, diagnose_posterior, ranked_hypotheses
from needleplan.models import ModelFile, simulate
from needleplan.models.effects import effect_named
from needleplan.recording import write_records
from needleplan.reports.diagnosis import POSTERIOR_FILES, PosteriorReport, posterior_report
from needleplan.signals import lspb
from tests.diagnosis.trials import BASE, recordings

FEW = Library([effect_named(name) for name in ("viscous", "stribeck", "relaxation", "drift")], BASE)
WEAK, STRONG = 1.7e-5, 1e-4


@pytest.fixture(scope="module")
def weak() -> PosteriorReport:
    return posterior_report(diagnose_posterior(BASE, recordings({"viscous": {"size": WEAK}}, seed=1), library=FEW), 2)


@pytest.fixture(scope="module")
def strong() -> PosteriorReport:
    return posterior_report(diagnose_posterior(BASE, recordings({"viscous": {"size": STRONG}}, seed=1), library=FEW))


def test_every_hypothesis_has_a_reason_and_the_most_probable_is_first(weak: PosteriorReport) -> None:
    probabilities = [each.probability for each in weak.ranked]
    assert probabilities == sorted(probabilities, reverse=True)
    assert ((), "") in [(each.effects, each.component) for each in weak.ranked]
    assert weak.ranked[0].because.startswith("it leads ")
    assert all(re.match(r"\d+\.\d nats behind", each.because) for each in weak.ranked[1:])


def test_the_parts_of_a_reason_add_up_to_the_whole(weak: PosteriorReport) -> None:
    found = weak.found
    top, names = found.posterior.ranked[0][1:], ("relaxation",)
    row = next(each for each in ranked_hypotheses(found, 50) if each.effects == names and not each.component)
    behind = found.posterior.logs[top] - found.posterior.logs[names, ""]
    parts = 0.0
    for sentence in row.because.split(": ", 1)[1].split("; "):
        size = float(re.findall(r"([\d.]+) nats", sentence)[0])
        parts += -size if re.search("better|less freedom|more probable", sentence) else size
    assert parts == pytest.approx(behind, abs=1.2)  # a part below 1 nat is left out


def test_a_named_effect_has_an_interval_and_needs_no_motion(strong: PosteriorReport) -> None:
    document = strong.document()
    assert (document["answer"], document["names"]) == ("named", ["viscous"])
    assert document["next_motion"] is None
    [size] = document["estimates"]
    assert size["low"] < STRONG < size["high"]
    nothing = next(each for each in document["ranked"] if not each["effects"] and not each["component"])
    assert "its fit is worse by" in nothing["because"]


def test_the_page_and_the_document_say_the_same(weak: PosteriorReport, tmp_path: Path) -> None:
    written = weak.write(str(tmp_path / "new"), ModelFile(BASE))
    assert [Path(each).name for each in written] == ["hypotheses.json", "hypotheses.html"]
    document = json.loads(Path(written[0]).read_text())
    page = Path(written[1]).read_text()
    assert page.startswith("<!DOCTYPE html>")
    assert "<script" not in page
    for each in document["ranked"]:
        assert each["because"] in page
    assert sum(each["probability"] for each in document["ranked"]) <= 1.0001
    assert len(document["settings"]) == len(Settings().described())
    assert len(document["next_motion"]["motions"]) == 2
    assert document["next_motion"]["bits"] >= document["next_motion"]["repeated_bits"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    ModelFile(BASE).write(tmp_path / "base.toml")
    write_records(recordings({"viscous": {"size": STRONG}}, seed=1), tmp_path / "data.csv")
    return tmp_path


def test_the_corrected_model_is_written_and_predicts_a_further_trial(folder: Path) -> None:
    arguments = ["diagnose", str(folder / "base.toml"), str(folder / "data.csv"), "-o", str(folder / "out")]
    assert main([*arguments, "--edition", "2"]) == 0
    file = ModelFile.read(folder / "out" / "model.toml")
    added = file.model.effects[0]
    assert (added.name, added.estimates["size"].low < STRONG < added.estimates["size"].high) == ("viscous", True)
    document = json.loads((folder / "out" / "hypotheses.json").read_text())
    assert added.found_by == document["digest"]
    truth = effect_named("viscous").apply(file.model.base, {"size": STRONG})
    path = lspb([-2, 50, 20, -2], [3, 12, 9], rate_hz=50.0)
    wanted = simulate(truth, path).output
    gap, left = (float(np.std(simulate(each, path).output - wanted)) for each in (file.model.base, file.model))
    assert left < 0.2 * gap


def test_a_diagnosis_without_a_name_removes_the_model_of_an_earlier_one(weak: PosteriorReport, tmp_path: Path) -> None:
    (tmp_path / "model.toml").write_text("of yesterday")
    weak.write(str(tmp_path), ModelFile(BASE))
    assert not (tmp_path / "model.toml").exists()


def test_the_command_writes_all_files(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["diagnose", str(folder / "base.toml"), str(folder / "data.csv"), "-o", str(folder / "out")]
    assert main([*arguments, "--edition", "2", "--verbose"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("named: viscous: ")
    assert "the second edition is under test" in shown.lower()
    assert sorted(each.name for each in (folder / "out").iterdir()) == sorted(POSTERIOR_FILES)


@pytest.mark.parametrize(("options", "says"), [
    (["--edition", "2", "--scenario", "a.toml"], "--scenario: belongs to --edition 1"),
    (["--edition", "2", "--merge-anyway"], "--merge-anyway: belongs to --edition 1"),
    (["--trials", "2"], "--trials: belongs to --edition 2"),
    (["--edition", "2", "--trials", "0"], "--trials = 0: must be 1 to 10"),
])  # fmt: skip
def test_options_of_the_other_edition_are_refused(
    folder: Path, capsys: pytest.CaptureFixture[str], options: list[str], says: str
) -> None:
    arguments = ["diagnose", str(folder / "base.toml"), str(folder / "data.csv"), "-o", str(folder / "out"), *options]
    assert main(arguments) == 2
    assert says in capsys.readouterr().err
    assert not (folder / "out").exists()
