"""Published results beside ours."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from needleplan import cli
from needleplan.errors import InputError, OutputError
from needleplan.scenario import Scenario
from needleplan.workflow import reproduce, reproduce_ch6
from needleplan.workflow.comparison import Comparison, Verdict


def test_unknown_chapters_and_folders_are_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='CHAPTER = "ch7": must be one of ch6'):
        reproduce.reproduce(["ch7"], None, print)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be made"):
        reproduce.reproduce(["ch6"], str(tmp_path / "file"), print)


def test_the_command_prints_a_list_and_says_no_where_a_result_is_missed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    agrees = Comparison("ch6/a", 1, 1.0, "s", Verdict.AGREES, "")
    monkeypatch.setitem(reproduce.CHAPTERS, "ch6", lambda _folder, _note: [agrees])
    assert cli.main(["reproduce", "ch6", "--json"]) == 0
    expected = {"id": "ch6/a", "published": 1, "ours": 1.0, "unit": "s", "verdict": "agrees", "reason": ""}
    assert json.loads(capsys.readouterr().out) == [expected]
    monkeypatch.setitem(reproduce.CHAPTERS, "ch6", lambda _folder, _note: [replace(agrees, verdict=Verdict.MISSED)])
    assert cli.main(["reproduce"]) == 1
    assert "1 of 1 missed: ch6/a" in capsys.readouterr().err


def test_chapter_six_on_a_coarse_grid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    full = Scenario.read("four_obstacles_thesis")
    coarse = replace(full, grid=replace(full.grid, spacing_mm=(4, 4)))
    monkeypatch.setattr(Scenario, "read", lambda _name: coarse)
    comparisons = reproduce_ch6.run(tmp_path, print)
    by_id = {each.id: each for each in comparisons}
    assert len(by_id) == len(comparisons) >= 19
    assert by_id["ch6/section 6.4/states"].verdict is Verdict.MISSED
    assert by_id["ch6/table 6.3/6x4 H1/partitions processed"].published == 24
    assert len(list(tmp_path.glob("*.png"))) == 6
