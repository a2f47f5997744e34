"""`npl.view`: the page of a plan in a notebook."""

import html
import re
from pathlib import Path

import pytest

import needleplan as npl
from needleplan.anatomy import SpaceScenario
from needleplan.errors import InputError
from needleplan.planning import plan_space
from tests.anatomy.volumes import anatomy, box

pytestmark = pytest.mark.usefixtures("few_executions")


def shown(view: object) -> str:
    """Return the page in the frame that a notebook gets."""
    (content,) = re.findall(r'<iframe [^>]*srcdoc="([^"]*)"></iframe>', view._repr_html_())  # type: ignore[attr-defined]
    return html.unescape(content)


def test_the_frame_holds_the_page(table: npl.PolicyTable, tmp_path: Path) -> None:
    view = npl.view(table, height_px=500)
    assert "height: 500px" in view._repr_html_()
    view.write(tmp_path / "plan.html")
    assert (tmp_path / "plan.html").read_text(encoding="utf-8") == shown(view)
    assert "<!doctype html>" in shown(view).lower()
    assert not re.findall(r'(?:src|href)="https?:', shown(view))


def test_table_scenario_and_name_show_the_same_plan(table: npl.PolicyTable, small: npl.Scenario) -> None:
    messages = re.compile(r'"/api/executions": "([^"]+)"')
    (from_table,) = messages.findall(shown(npl.view(table)))
    (from_scenario,) = messages.findall(shown(npl.view(small)))
    assert from_table == from_scenario


@pytest.mark.slow
def test_the_code_of_a_plan_without_a_file_holds_the_scenario(table: npl.PolicyTable) -> None:
    text = shown(npl.view(table))
    assert "npl.Scenario.from_toml(" in text
    assert "npl.PolicyTable.read(" not in text
    assert "npl.Scenario.read('layered')" in shown(npl.view("layered"))


def test_the_start_is_that_of_the_call(table: npl.PolicyTable) -> None:
    assert "npl.Pose.deg(0.0, 20.0, 0.0" in shown(npl.view(table, (0.0, 20.0, 0.0)))
    entry = table.best_entry()
    assert f"npl.Pose.deg({entry.pose.x_mm!r}, {entry.pose.y_mm!r}" in shown(npl.view(table, entry))


@pytest.mark.parametrize("height_px", [0, 199, 5000, "tall"])
def test_an_unusable_height_is_refused(table: npl.PolicyTable, height_px: int) -> None:
    with pytest.raises(npl.InputError, match="height_px"):
        npl.view(table, height_px=height_px)


def test_a_plan_in_space_has_the_ranked_entries() -> None:
    table = plan_space(SpaceScenario.of(anatomy(box())), threads=1)
    found = npl.view(table)
    assert (found.title, b"/api/volume" in found.html) == ("A box (invented)", True)
    with pytest.raises(InputError, match=r"start = .* in 3D, choose an entry in the page"):
        npl.view(table, (0, 0, 0))
