"""Files and code that the page hands out."""

import contextlib
import io
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import needleplan as npl
from needleplan.planning import draw_plan
from tests.page.served import Served, served
from tests.pages import environment

START = {"x_mm": 0.0, "y_mm": 21.5, "heading_deg": -3.5, "bevel": 1}


@pytest.fixture(scope="module")
def server(small: npl.Scenario, table: npl.PolicyTable) -> Iterator[Served]:
    with served(small, table) as found:
        yield found


@pytest.fixture(scope="module")
def raw(server: Served) -> Any:
    return server.ask("/api/start").told["scenario"]


def test_a_saved_scenario_reads_back_and_has_comments(server: Served, raw: Any, small: npl.Scenario) -> None:
    text = server.ask("/api/toml", {"scenario": raw}).body.decode()
    assert npl.Scenario.from_toml(text) == small
    assert "radius of the arc" in text
    opened = server.ask("/api/open", {"text": text, "name": "again.toml"}).told["scenario"]
    assert server.ask("/api/toml", {"scenario": opened}).body.decode() == text


def test_files_with_mistakes_are_not_opened(server: Served) -> None:
    found = server.ask("/api/open", {"text": "schema = 3", "name": "mine.toml"})
    assert found.told["kind"] == "input"
    assert "mine.toml" in found.told["text"]
    assert server.ask("/api/open", {"shipped": "../../secret"}).told["kind"] == "input"
    assert server.ask("/api/open", {"shipped": "layered"}).told["scenario"]["needle"]["layer"]


@pytest.mark.study
def test_the_table_and_the_figure_are_those_of_the_command(
    server: Served, raw: Any, table: npl.PolicyTable, tmp_path: Path
) -> None:
    (tmp_path / "got.h5").write_bytes(server.ask("/api/table", {"scenario": raw}).body)
    assert npl.PolicyTable.read(tmp_path / "got.h5").digest == table.digest
    draw_plan(table, npl.Pose.deg(0, 21.5, -3.5, 1), tmp_path / "plan.png")
    assert (
        server.ask("/api/figure", {"scenario": raw, "start": START, "format": "png"}).body
        == (tmp_path / "plan.png").read_bytes()
    )
    assert b"<svg" in server.ask("/api/figure", {"scenario": raw, "format": "svg"}).body
    assert server.ask("/api/figure", {"scenario": raw, "format": "exe"}).told["kind"] == "input"


@pytest.mark.parametrize("start", [None, START])
def test_the_copied_python_computes_what_is_shown(server: Served, raw: Any, start: object, tmp_path: Path) -> None:
    changed = {**raw, "needle": {"curvature_radius_mm": 38.5}, "title": "It's \"mine\" \\ '''"}
    code = server.ask("/api/code", {"scenario": changed, "start": start, "runs": 500, "language": "python"}).body
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.chdir(tmp_path):
        exec(code.decode(), {})
    plan = server.ask("/api/plan", {"tab": "p", "scenario": changed, "start": start}).told
    told = server.ask("/api/executions", {"plan": plan["plan"], "start": start, "runs": 500}).told
    assert f"after {plan['length_mm']:.1f} mm" in printed.getvalue()
    assert f"success {told['success']:.3f} in 500 runs" in printed.getvalue()


@pytest.mark.slow
def test_the_copied_commands_compute_what_is_shown(server: Served, raw: Any, tmp_path: Path) -> None:
    changed = {**raw, "needle": {"curvature_radius_mm": 38.5}, "title": "$(touch hacked) 'x'"}
    body = {"scenario": changed, "start": START, "runs": 500, "language": "command", "name": "My plan; rm"}
    script = server.ask("/api/code", body).body.decode()
    done = subprocess.run(
        ["bash", "-euc", script],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    plan = server.ask("/api/plan", {"tab": "c", "scenario": changed, "start": START}).told
    told = server.ask("/api/executions", {"plan": plan["plan"], "start": START, "runs": 500}).told
    assert f"{plan['length_mm']:.1f} mm in" in done.stdout
    assert f"{100 * told['success']:.1f} % of 500 runs" in done.stdout
    assert sorted(each.name for each in tmp_path.iterdir()) == ["my_plan_rm.h5", "my_plan_rm.toml"]


def test_what_was_opened_is_named_not_repeated(small: npl.Scenario, server: Served) -> None:
    raw = server.ask("/api/start").told["scenario"]
    code = server.ask("/api/code", {"scenario": raw, "language": "python"}).body.decode()
    assert "npl.PolicyTable.read('small.toml')" in code
    with served(small) as other:
        code = other.ask("/api/code", {"scenario": raw, "language": "command", "name": "Small"}).body.decode()
    assert code.startswith("needleplan plan small.toml -o small.h5\nneedleplan path small.h5\n")
    assert server.ask("/api/code", {"scenario": raw, "language": "cobol"}).told["kind"] == "input"
