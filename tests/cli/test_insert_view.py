"""What a person sees of an insertion while it goes on."""

import argparse
import io
import math
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from rich.console import Console
from rich.live import Live

from needleplan.cli.insert_view import LiveView, PlainView, view
from needleplan.control import InsertionOutcome
from needleplan.control.slicer import SlicerView
from needleplan.devices.igtl import SlicerServer, StatusCode
from tests.control.scenes import FAST, NOISY, a_lab, insertion_in, small_table
from tests.control.space_scenes import FAST as SPACE_FAST
from tests.control.space_scenes import box_table, inserted

pytestmark = pytest.mark.usefixtures("few_executions")


@pytest.mark.slow
def test_the_live_view_shows_what_is_now() -> None:
    console = Console(file=io.StringIO(), width=100, force_terminal=True)
    with Live(console=console, auto_refresh=False) as live:
        shown = LiveView(live, small_table(), FAST)
        report = insertion_in(a_lab(NOISY, 1), listeners=[shown]).run()
    assert report.outcome is InsertionOutcome.TARGET
    console = Console(file=io.StringIO(), width=100)
    console.print(shown.rows())
    text = console.file.getvalue()  # type: ignore[attr-defined]
    rows = {line.split()[0]: line for line in text.splitlines() if line.strip()}
    assert set(rows) == {"state", "depth", "force", "tip", "target", "plan", "radius", "action", "ages"}
    assert "DISABLED" in rows["state"]
    assert f"{report.inserted_mm:7.2f} mm" in rows["depth"]
    assert f"{report.error_mm:7.2f} mm away" in rows["target"]
    assert f"step {report.steps[-1].number}: insert" in rows["action"]
    assert "tracker" in rows["ages"]


@pytest.mark.slow
def test_elsewhere_it_is_lines(capsys: pytest.CaptureFixture[str]) -> None:
    lab = a_lab(replace(NOISY, curvature_error=0.25), 1)
    with view(small_table(), FAST, argparse.Namespace(quiet=False, json=False)) as shown:
        assert type(shown) is PlainView
        report = insertion_in(lab, listeners=[shown]).run()
    lines = capsys.readouterr().err.splitlines()
    assert sum(line.startswith("step ") for line in lines) == len(report.steps)
    assert sum(line.startswith("table swapped: new table for a radius of") for line in lines) == report.replans >= 1


@pytest.mark.slow
def test_json_leaves_the_events_and_quiet_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    lab = a_lab(replace(NOISY, curvature_error=0.25), 1)
    with (
        view(small_table(), FAST, argparse.Namespace(quiet=False, json=True)) as events,
        view(small_table(), FAST, argparse.Namespace(quiet=True, json=False)) as nothing,
    ):
        report = insertion_in(lab, listeners=[events, nothing]).run()
    lines = capsys.readouterr().err.splitlines()
    assert sum(line.startswith("table swapped: new table for a radius of") for line in lines) == report.replans >= 1
    assert not [line for line in lines if line.startswith("step ")]


@pytest.mark.slow
def test_positions_in_space_name_the_lattice(capsys: pytest.CaptureFixture[str]) -> None:
    with view(box_table(), SPACE_FAST, argparse.Namespace(quiet=False, json=False)) as shown:
        report, _ = inserted(box_table(), listeners=[shown])
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("step ")]
    assert len(lines) == len(report.steps)
    place = r": lattice x +-?\d+\.\d\d, y +-?\d+\.\d\d, z +-?\d+\.\d\d mm, +-?\d+\.\d deg, success "
    assert all(re.search(place, line) for line in lines), lines[0]
    away, risk = zip(
        *(re.findall(r"; ([\d.]+) mm to the target, ([\d.]+) mm from an obst", x)[0] for x in lines), strict=True
    )
    target, grid = box_table().scenario.target_mm, box_table().scenario.grid
    tips = np.array([step.estimate.position_mm for step in report.steps])
    assert [float(each) for each in away] == pytest.approx([math.dist(tip, target) for tip in tips], abs=0.05)
    assert [float(each) for each in risk] == pytest.approx(grid.clearance_at(tips), abs=0.05)
    with Live(console=Console(file=io.StringIO()), auto_refresh=False) as live:
        now = LiveView(live, box_table(), SPACE_FAST)
        assert report.tip
        now.tip(0, 0.0, report.tip)
        console = Console(file=io.StringIO(), width=120)
        console.print(now.rows())
    assert "tip lattice x" in " ".join(console.file.getvalue().split())  # type: ignore[attr-defined]


class Told:
    """Takes note of what Slicer would be shown."""

    def __init__(self) -> None:
        self.shown: dict[str, list[tuple[Any, ...]]] = {}

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *what: self.shown.setdefault(name, []).append(what)


@pytest.mark.slow
def test_slicer_is_shown_the_run() -> None:
    told = Told()
    report = insertion_in(a_lab(NOISY, 1), listeners=[SlicerView(cast("SlicerServer", told), small_table())]).run()
    shown = told.shown
    x, y = small_table().scenario.target.center_mm
    assert shown["show_target"] == [((x, y, 0.0), 3.0)]
    ((plan,),) = shown["show_plan"]
    assert len(plan) > 20
    (path,) = shown["show_path"][-1]
    assert math.dist(path[-1], (*report.executed_mm[-1],)) < 0.6
    (place, turn) = shown["show_tip"][-1]
    assert place == pytest.approx((*report.executed_mm[-1],))
    assert math.hypot(*turn) == pytest.approx(1)
    assert [state for state, *_ in shown["show_state"]][-1] == "DISABLED"
    assert ("ENABLED", StatusCode.OK, "") in shown["show_state"]
    assert shown["show_note"][-1][0].startswith("end: the tip is")
    assert len(shown["show_force"]) == pytest.approx(10 * report.duration_s, rel=0.2)
