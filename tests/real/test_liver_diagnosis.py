"""What a diagnosis says of a published curve: one trial, no noise record. The how-to shows this run, word by word."""

from __future__ import annotations

import contextlib
import doctest
import io
import json
import shlex
from pathlib import Path
from typing import Any

import pytest

from needleplan.cli import main
from needleplan.models import ModelFile
from needleplan.recording import read_depth_force, write_records
from tests import pages
from tests.diagnosis.trials import BASE
from tests.real.shared import require

FILE = require("liver_force", "depth_force.csv")
PAGE = pages.ROOT / "docs" / "how-to" / "diagnose.md"


@pytest.fixture(scope="module")
def shown() -> tuple[str, list[str], str]:
    """Code, arguments of the command, and what it prints, as on the page."""
    found = list(pages.blocks(PAGE))
    at = next(index for index, block in enumerate(found) if "no_puncture.toml" in block.text)
    code, command, printed = (block.text for block in found[at : at + 3])
    return code, shlex.split(command)[1:], printed


@pytest.fixture(scope="module")
def run(shown: tuple[str, list[str], str], tmp_path_factory: pytest.TempPathFactory) -> tuple[str, dict[str, Any]]:
    """What the command printed, and the document that it wrote."""
    folder = tmp_path_factory.mktemp("liver")
    (folder / "depth_force.csv").symlink_to(FILE)
    code, arguments, _ = shown
    output = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(output):
        patch.chdir(folder)
        exec(compile(code, str(PAGE), "exec"), {})
        assert main(arguments) == 1
    return output.getvalue(), json.loads((folder / "liver" / "diagnosis.json").read_text())


@pytest.mark.slow
def test_the_page_shows_what_is_printed(shown: tuple[str, list[str], str], run: tuple[str, dict[str, Any]]) -> None:
    agrees = doctest.OutputChecker().check_output(shown[2], run[0], doctest.ELLIPSIS)
    assert agrees, run[0]


@pytest.mark.slow
def test_no_name_is_given_and_what_lacks_is_said(run: tuple[str, dict[str, Any]]) -> None:
    _, document = run
    assert document["verdict"] not in ("named", "incomplete", "none", "underpowered")
    assert document["effects"] == []
    assert set(document["lacks"]) == {"noise record", "held-out trial", "second training trial"}


@pytest.mark.slow
def test_one_of_the_best_effects_is_at_the_deepest_drop(run: tuple[str, dict[str, Any]]) -> None:
    known = [each["parameters"] for each in run[1]["likely"]]
    places = [each["depth_mm"] for each in known if "depth_mm" in each]
    assert any(each["low"] < 36.8 < each["high"] and abs(each["value"] - 36.8) < 1 for each in places)


@pytest.mark.slow
def test_the_next_motion_is_another_one_and_not_worse_than_a_repetition(run: tuple[str, dict[str, Any]]) -> None:
    proposed = run[1]["next_motion"]
    assert proposed["bits"] >= proposed["repeated_bits"] > 0
    assert {each["name"] for each in proposed["motions"]} <= {"rich", "rich_back", "speeds", "reversals", "patient"}


def test_digitised_points_are_refused_as_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_records([read_depth_force(FILE, 3.0)], tmp_path / "curve.csv")
    ModelFile(BASE).write(tmp_path / "model.toml")
    arguments = [str(tmp_path / "model.toml"), str(tmp_path / "curve.csv"), "-o", str(tmp_path / "out")]
    assert main(["diagnose", *arguments]) == 2
    assert "is sampled unevenly" in capsys.readouterr().err
