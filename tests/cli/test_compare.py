"""`needleplan compare`: the gap of each trial with the effects of a model and without."""

import json
from pathlib import Path

import pytest

from needleplan.models import ModelFile
from needleplan.models.effects import AddedEffect, AugmentedModel
from needleplan.recording import write_records
from needleplan.signals import Role
from tests.cli.commands import needleplan, refused
from tests.diagnosis.trials import BASE, NOISE_N, recordings

HIDDEN = {"viscous": {"size": 3e-4}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("compare")
    records = recordings(HIDDEN, seed=7)
    write_records([each for each in records if each.role is not Role.NOISE], place / "data.csv")
    write_records([each for each in records if each.role is Role.NOISE], place / "air.csv")
    ModelFile(BASE).write(place / "base.toml")
    for name, size in (("found", 3e-4), ("wrong", -3e-4)):
        ModelFile(AugmentedModel(BASE, (AddedEffect("viscous", {"size": size}),))).write(place / f"{name}.toml")
    return place


def test_the_effects_close_the_gap_of_every_trial(folder: Path) -> None:
    done = needleplan("compare", "found.toml", "data.csv", "--noise", "air.csv", "--fit", "--json", cwd=folder)
    assert done.returncode == 0
    found = json.loads(done.stdout)
    assert (found["effects"], found["fitted"], found["unit"], found["ok"]) == (["viscous"], True, "N", True)
    assert [each["trial"] for each in found["trials"]] == ["trial 0", "trial 1", "trial 2"]
    for each in found["trials"]:
        assert each["noise"] == pytest.approx(NOISE_N, rel=0.1)
        assert each["gap"] == pytest.approx(NOISE_N, rel=0.1)
        assert each["without"] > 1.5 * NOISE_N
        assert each["explained"] > 0.9


def test_parameters_of_the_file_leave_the_scatter_of_the_tissue(folder: Path) -> None:
    kept, fitted = (
        json.loads(needleplan("compare", "found.toml", "data.csv", "--json", *more, cwd=folder).stdout)
        for more in ([], ["--fit"])
    )
    assert all(a["gap"] > b["gap"] for a, b in zip(kept["trials"], fitted["trials"], strict=True))
    assert "no noise record" in kept["remarks"][0]


def test_an_effect_that_makes_the_gap_larger_is_told_by_the_exit_code(folder: Path) -> None:
    done = needleplan("compare", "wrong.toml", "data.csv", "--noise", "air.csv", "--fit", cwd=folder)
    assert done.returncode == 1
    assert "the effects do not make the gap smaller in trial 0, trial 1, trial 2" in done.stdout


def test_a_model_without_effects_has_one_gap(folder: Path) -> None:
    done = needleplan("compare", "base.toml", "data.csv", "--noise", "air.csv", cwd=folder)
    assert done.returncode == 0
    assert done.stdout.startswith("shaft_and_tip: RMS of measured minus modelled output, parameters of the file")
    assert "without effects" not in done.stdout


def test_what_cannot_be_compared_is_refused(folder: Path) -> None:
    refused(needleplan("compare", "found.toml", "air.csv", cwd=folder), "compare: role: no trial has the role train")
    refused(needleplan("compare", "air.csv", "data.csv", cwd=folder), "air.csv: is not TOML")
