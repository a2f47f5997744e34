"""What a diagnosis says of a published curve: one trial, no noise record. The how-to shows this run, word by word."""

import json
import shlex
from pathlib import Path

import pytest

from needleplan.cli import main
from needleplan.models import ModelFile
from needleplan.recording import read_records, write_records
from tests import pages
from tests.diagnosis.trials import BASE
from tests.real.shared import require

FILE = require("liver_force", "depth_force.csv")
PAGE = pages.ROOT / "docs" / "how-to" / "diagnose-published-curve.md"


@pytest.mark.study
def test_the_page_shows_what_is_printed_and_no_name_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = list(pages.blocks(PAGE))
    at = next(index for index, block in enumerate(found) if "no_puncture.toml" in block.text)
    code, command, told = (block.text for block in found[at : at + 3])
    (tmp_path / "depth_force.csv").symlink_to(FILE)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, str(PAGE), "exec"), {})
    capsys.readouterr()
    assert main(shlex.split(command)[1:]) == 1
    printed = capsys.readouterr().out
    assert pages.agrees(told, printed), printed
    document = json.loads((tmp_path / "liver" / "diagnosis.json").read_text())
    assert document["verdict"] not in ("named", "incomplete", "none", "underpowered")
    assert document["effects"] == []
    assert set(document["lacks"]) == {"noise record", "held-out trial", "second training trial"}
    # One of the best effects is at the deepest drop.
    known = [likely["parameters"] for likely in document["likely"]]
    places = [parameters["depth_mm"] for parameters in known if "depth_mm" in parameters]
    assert any(place["low"] < 36.8 < place["high"] and abs(place["value"] - 36.8) < 1 for place in places)
    # The next motion is another one, and not worse than a repetition.
    proposed = document["next_motion"]
    assert proposed["bits"] >= proposed["repeated_bits"] > 0
    assert {motion["name"] for motion in proposed["motions"]} <= {"rich", "rich_back", "speeds", "reversals", "patient"}


def test_digitised_points_are_refused_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_records(read_records(FILE, columns="depth=1[m], force=2[N], speed=3[mm/s]"), tmp_path / "curve.csv")
    ModelFile(BASE).write(tmp_path / "model.toml")
    arguments = [str(tmp_path / "model.toml"), str(tmp_path / "curve.csv"), "-o", str(tmp_path / "out")]
    assert main(["diagnose", *arguments]) == 2
    assert "is sampled unevenly" in capsys.readouterr().err
