"""Studies and figures of chapter 6 on a small scenario; the look of figures is checked by eye."""

import csv
import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import needleplan as npl
from needleplan import plotting
from needleplan.cli import main
from needleplan.planning import Outcome
from needleplan.reports.comparison import Agreement, Comparison, Evidence
from needleplan.scenario import Scenario, Transition
from needleplan_thesis.chapter6.entries import ExecutionRule, choose_entries, execute, planned, summary, write_entries
from needleplan_thesis.chapter6.partitions import dependent_points, draw_dependents
from needleplan_thesis.chapter6.paths import Panel, draw_panels, ending, nearest_heading
from needleplan_thesis.chapter6.phantom import EXPERIMENTS, miss_mm, published_phantom

pytestmark = pytest.mark.study


def test_dependents_lie_a_step_around_the_partition(table: npl.PolicyTable) -> None:
    scenario = table.scenario
    columns, rows = scenario.partitions
    column, row = 4, 2
    points = dependent_points(table, column * rows + row)
    nx, ny, *_ = scenario.shape
    i, j = np.meshgrid(np.arange(nx), np.arange(ny), indexing="ij")
    inside = (i * columns // nx == column) & (j * rows // ny == row)
    assert points[inside].mean() > 0.9  # all but target points
    members = np.argwhere(inside)
    reach = np.array([np.abs(members - point).max(axis=1).min() for point in np.argwhere(points)])
    assert 0 < reach.max() <= math.ceil(scenario.step_mm)
    figure, (axes,) = plotting.sheet(scenario.workspace, 1)
    draw_dependents(axes, table, column * rows + row)
    assert axes.images[0].get_array().count() == points.sum()
    assert len(figure.axes) == 1


def test_entries_follow_the_rule(small: Scenario) -> None:
    reference = planned(small, Transition.INTERPOLATED, 0.5)
    entries = choose_entries(reference)
    assert set(entries[:, 0]) == {0.0}
    assert set(entries[:, 1]) <= {10.0, 20.0, 30.0}
    assert {round(math.degrees(heading)) for heading in entries[:, 2]} <= {-30, 0, 30}
    assert len({(y, heading) for _, y, heading, _ in entries.tolist()}) == len(entries) >= 5
    assert (reference.lookup_many(entries).success > 0.01).all()


def test_the_study_counts_what_a_rollout_counts(small: Scenario, tmp_path: Path) -> None:
    table = planned(small, Transition.INTERPOLATED, 1.0)
    entries = choose_entries(table)
    study = execute("small", table, entries, ExecutionRule(), 2000)
    single = table.rollout(entries[0].tolist(), 2000, seed=6, nearest=True)
    assert study.realised[0] == single.success
    assert tuple(study.interval[0]) == single.interval
    assert study.predicted[0] == pytest.approx(single.predicted_success)
    assert np.abs(study.points).max() < 15
    mean, largest = summary(study)
    assert (mean.verdict, largest.verdict) == (Agreement.OURS, Agreement.OURS)
    assert largest.ours == pytest.approx(np.abs(study.points).max(), abs=1e-3)
    write_entries(tmp_path / "entries.csv", [study])
    rows = list(csv.DictReader((tmp_path / "entries.csv").read_text().splitlines()))
    assert len(rows) == len(entries)
    assert float(rows[0]["realised"]) == pytest.approx(single.success, abs=1e-4)


def test_the_goal_is_for_half_a_millimetre(small: Scenario) -> None:
    table = planned(small, Transition.INTERPOLATED, 0.5)
    study = execute("small", table, choose_entries(table), ExecutionRule(), 1000)
    for row, goal in zip(summary(study), (1.0, 2.0), strict=True):
        assert isinstance(row.ours, float)
        assert row.verdict is (Agreement.MET if row.ours <= goal else Agreement.MISSED)


def test_panels(table: npl.PolicyTable, tmp_path: Path) -> None:
    panel = Panel.of("a panel", table, table.best_entry().pose)
    assert panel.path.outcome is Outcome.TARGET
    assert ending(panel.path) == "reaches the target"
    assert miss_mm(panel) < 1e-6  # the execution ends where it meets the rim of the target
    assert 0 < panel.path.clearance_mm < 40
    draw_panels([panel, panel], "What is shown.", tmp_path / "panels.png")
    assert (tmp_path / "panels.png").read_bytes().startswith(b"\x89PNG")


def test_the_nearest_heading_with_success() -> None:
    table = planned(Scenario.read("four_obstacles"), Transition.NEAREST, 2.0)
    heading = nearest_heading(table, math.radians(-30))
    assert -30 < math.degrees(heading) < 30
    assert max(table.lookup(0.0, 20.0, heading, bevel).success for bevel in (-1, 1)) >= 0.75


def test_the_starts_of_section_6_5_are_entries_of_the_phantom() -> None:
    scenario = published_phantom()
    assert scenario.step_mm == pytest.approx(2.258, abs=1e-3)
    assert all(0 < each.y_mm < scenario.workspace.height_mm for each in EXPERIMENTS)
    assert {each.figure[:3] for each in EXPERIMENTS} == {"6.7", "6.8", "6.9"}


ROWS = [
    Comparison("ch6/table/a", 100, 25.0, "s", Agreement.DIFFERS, "another machine", kind=Evidence.COMPUTED),
    Comparison("ch6/table/b", None, 1_176_120, "states", Agreement.OURS, "another machine", kind=Evidence.COMPUTED),
    Comparison("ch6/statement/c", "yes", "no", "", Agreement.NOT_REPRODUCED, "because", kind=Evidence.QUALITATIVE),
    Comparison("ch6/statement/d", None, "it is so", "", Agreement.MISSED, kind=Evidence.OWN_DATA),
    Comparison(
        "ch6/statement/e", 196, 77.0, "passes", Agreement.SAME_ORDER, kind=Evidence.COMPUTED, source="thesis, f"
    ),
    Comparison("ch6/statement/g", 2, 2, "", Agreement.REPRODUCED, kind=Evidence.COMPUTED, earlier=True),
]


def test_the_printed_table(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("needleplan.reports.chapters.reproduce", lambda *_, **__: ROWS)
    assert run_reproduce("ch6") == 0
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert [line.split() for line in lines if line.startswith("  a ")] == [
        ["a", "100", "25", "0.25", "s", "differs", "(computed)", "[1]"]
    ]
    assert any("1,176,120" in line and "-" in line.split() for line in lines)
    assert "  [1] another machine" in lines
    assert "  c: not reproduced (qualitative); because" in lines
    assert "  d: it is so; missed (fit of own data)" in lines
    (same,) = [line for line in lines if line.startswith("  e ")]
    assert "same order, factor 2.55 (computed)" in same
    assert "  source: thesis, f" in lines
    assert "ch6/statement, beside an earlier computation of this project" in lines
    assert "ch6/statement, goals of this project" in lines
    at = [lines.index(title) for title in lines if title.startswith(("compared with", "goals of", "context"))]
    counted = [[line.split()[0] for line in lines[start + 1 : end - 1]] for start, end in pairwise([*at, -1])]
    assert counted == [["same", "differs", "not"], ["reproduced"], ["missed"], ["ours"]]
    assert lines[-1] == "same order: two numbers within a factor of 3; each row prints its factor"
    assert printed.err == "1 of 1 goals missed\n"


def test_the_printed_json(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("needleplan.reports.chapters.reproduce", lambda *_, **__: ROWS)
    assert run_reproduce("ch6", "--json") == 0
    records = json.loads(capsys.readouterr().out)
    keys = ["id", "published", "earlier", "ours", "unit", "verdict", "factor", "kind", "origin", "source", "reason"]
    assert [list(record) for record in records] == [keys] * len(ROWS)
    assert [record["origin"] for record in records] == [
        "thesis", "none", "thesis", "own goal", "thesis", "earlier computation",
    ]  # fmt: skip
    assert [record["factor"] for record in records[:4]] == [None] * 4
    assert records[4]["factor"] == pytest.approx(196 / 77)
    assert (records[5]["published"], records[5]["earlier"]) == (None, 2)
    assert (records[0]["verdict"], records[0]["kind"]) == ("differs", "computed")


def run_reproduce(*arguments: str) -> int:

    return main(["reproduce", *arguments])
