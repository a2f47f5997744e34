"""Editing a scenario in the page: values, handles, history, sliders, files, and code that reproduces what is shown."""

import contextlib
import io
import math
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

import needleplan as npl
from tests.browser.browser import drag, label, opened, told, wait_for, wait_for_new_picture
from tests.conftest import SMALL
from tests.page.served import served

pytestmark = pytest.mark.slow


def menu(page: Page, name: str, action: str) -> None:
    """Choose an entry of a menu."""
    page.locator("summary", has_text=name).click()
    page.get_by_role("button", name=action).click()


def test_values_are_those_of_the_table_under_the_pointer(page: Page, table: npl.PolicyTable) -> None:
    box = page.locator("#plane").bounding_box()
    assert box
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.25 * box["height"])
    position, success, heading = page.locator("#values div").all_inner_texts()
    x, y = (float(word) for word in position.replace("x", "").replace("y", "").replace("mm", "").split(","))
    best = table.success[round(x), round(y)].max()
    assert float(success.split()[1]) == pytest.approx(100 * best, abs=0.06)
    assert heading.startswith("heading ")


def test_corners_and_bodies_are_dragged_added_and_deleted(page: Page) -> None:
    drag(page, "polygon_mm 0 3", 20, -60)
    wait_for(page, "planned", "done")
    assert label(page, "polygon_mm 0 3") != "Point 4 of obstacle rod, x 25 mm, y 18 mm"
    drag(page, "body 0", 30, 0)
    wait_for(page, "planned", "done")
    drag(page, "middle 0 0", 0, -30)
    wait_for(page, "planned", "done")
    assert page.locator('.handle[data-key^="polygon_mm 0"]').count() == 6
    page.keyboard.press("Delete")
    assert page.locator('.handle[data-key^="polygon_mm 0"]').count() == 5
    menu(page, "Add", "Disc")
    assert label(page, "radius 1").startswith("Radius of obstacle 2")
    drag(page, "radius 1", 25, 0)
    wait_for(page, "planned", "done")
    page.get_by_role("button", name="Delete").click()
    assert page.locator('.handle[data-key="radius 1"]').count() == 0
    menu(page, "Add", "Capsule")
    wait_for(page, "done")
    assert page.locator('.handle[data-key^="ends_mm 1"]').count() == 2


def test_one_drag_is_one_step_of_the_history(page: Page) -> None:
    before = label(page, "target")
    drag(page, "target", -80, 40)
    after = label(page, "target")
    page.keyboard.press("Control+z")
    wait_for(page, "done")
    assert label(page, "target") == before
    page.keyboard.press("Control+Shift+z")
    wait_for(page, "done")
    assert label(page, "target") == after != before


def test_sliders_plan_again(page: Page, small: npl.Scenario, tmp_path: Path) -> None:
    slider = page.locator('[data-slider="curvature radius"]')
    before = told(page, "predicted")
    slider.fill("1.9")
    wait_for(page, "done")
    assert told(page, "predicted") != before
    for name, value in (
        ("tip noise", "3"),
        ("rotation cost", "2"),
        ("grid spacing", "0.3"),
        ("refinement", "2"),
        ("collision cost", "3"),
        ("exit cost", "2"),
        ("clearance", "3"),
    ):
        page.locator(f'[data-slider="{name}"]').fill(value)
        wait_for(page, "done")
    assert told(page, "states") != f"{small.states:,}"
    with page.expect_download() as download:
        menu(page, "File", "Save scenario")
    download.value.save_as(tmp_path / "changed.toml")
    objective = npl.Scenario.read(tmp_path / "changed.toml").objective
    assert (objective.rotation, objective.collision, objective.exit) == (100, 1000, 100)
    assert (objective.clearance_mm, objective.clearance_per_mm) == (3, 4)
    page.locator('[data-slider="clearance"]').fill("0")
    wait_for(page, "done")


def test_the_field_of_one_heading(page: Page) -> None:
    before = page.locator("#plane canvas").screenshot()
    page.get_by_label("field at the best heading").uncheck()
    page.locator('[data-slider="heading of the field"]').fill("60")
    wait_for_new_picture(page, before)


def test_a_scenario_is_saved_and_opened_again(page: Page, tmp_path: Path) -> None:
    drag(page, "target", -60, 30)
    wait_for(page, "done")
    moved = label(page, "target")
    with page.expect_download() as download:
        menu(page, "File", "Save scenario")
    file = tmp_path / download.value.suggested_filename
    download.value.save_as(file)
    x, y = npl.Scenario.read(file).target.center_mm
    assert moved == f"Target, x {x:g} mm, y {y:g} mm"
    page.keyboard.press("Control+z")
    page.locator("#file").set_input_files(file)
    expect(page.locator('[data-key="target"]')).to_have_attribute("aria-label", moved)
    wait_for(page, "done")


def test_a_wrong_file_changes_nothing(page: Page, tmp_path: Path) -> None:
    (tmp_path / "wrong.toml").write_text('schema = "needleplan.scenario/1"\ntarget = 3\n')
    page.locator("#file").set_input_files(tmp_path / "wrong.toml")
    page.get_by_role("alert").filter(has_text="wrong.toml").wait_for()
    assert label(page, "target") == "Target, x 50 mm, y 25 mm"


def test_downloads(page: Page, table: npl.PolicyTable, tmp_path: Path) -> None:
    for action, start in (
        ("Download table", b"needleplan.table"),
        ("figure (.svg)", b"<?xml"),
        ("figure (.png)", b"\x89PNG"),
    ):
        with page.expect_download() as download:
            menu(page, "File", action)
        download.value.save_as(tmp_path / "file")
        assert (tmp_path / "file").read_bytes().startswith(start)
        if start == b"needleplan.table":
            (tmp_path / "file").rename(tmp_path / "table.h5")
            assert npl.PolicyTable.read(tmp_path / "table.h5").digest == table.digest


def test_copied_python_prints_the_numbers_of_the_panel(page: Page) -> None:
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    drag(page, "polygon_mm 0 3", 20, -60)
    drag(page, "entry", 0, 40)
    wait_for(page, "done")
    menu(page, "File", "Copy as Python")
    page.get_by_role("alert").filter(has_text="Copied").wait_for()
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(page.evaluate("navigator.clipboard.readText()"), {})
    path, rollouts = printed.getvalue().splitlines()
    assert f"after {told(page, 'length')}" in path
    assert f"{told(page, 'turns')} turns" in path
    assert 100 * float(rollouts.split("success ")[1].split()[0]) == pytest.approx(
        float(told(page, "realised").split()[0]), abs=0.1
    )


def test_a_flat_workspace_is_stretched(browser: Browser) -> None:
    """The handle of the heading stays beside the entry, and a direction on the screen is read in the plane."""
    text = SMALL.replace("height_mm = 40.0", "height_mm = 5.0").replace("[50, 25]", "[50, 2.5]")
    text = text.replace("radius_mm = 2\n", "radius_mm = 0.5\n")
    text = text.replace("[[20, 0], [30, 0], [30, 15], [25, 18], [20, 15]]", "[[20, 4], [30, 4], [25, 6]]")
    with served(npl.Scenario.from_toml(text)) as server, opened(browser, server) as page:
        wait_for(page, "done")
        places = {key: page.locator(f'[data-key="{key}"]').bounding_box() for key in ("entry", "heading")}
        entry, heading = ((each["x"], each["y"]) for each in places.values() if each)
        assert math.dist(entry, heading) == pytest.approx(52, abs=2)
        drag(page, "heading", entry[0] + 60 - heading[0], entry[1] - 60 - heading[1])
        wait_for(page, "done")
        stretch = 60 / 5 / 6
        assert float(label(page, "heading").split()[-2]) == pytest.approx(math.degrees(math.atan(1 / stretch)), abs=0.5)


TISSUES = """
[[needle.layer]]
from_mm = 20
curvature_radius_mm = 30

[[needle.layer]]
from_mm = 40
curvature_radius_mm = 35

[[tissue]]
name = "organ"
curvature_radius_mm = 45
polygon_mm = [[8, 4], [22, 4], [22, 16], [8, 16]]
holes_mm = [[[12, 8], [18, 8], [18, 12], [12, 12]]]

[[tissue]]
curvature_radius_mm = 50
center_mm = [45, 8]
radius_mm = 4
"""


@pytest.mark.study
def test_tissues_holes_and_layers_are_dragged(browser: Browser) -> None:
    scenario = npl.Scenario.from_toml(SMALL + TISSUES)
    with served(scenario) as server, opened(browser, server) as page:
        wait_for(page, "done")
        for key, across, down, before in (
            ("tissue body 0", 30, 0, "All of tissue organ, x 15 mm, y 10 mm"),
            ("tissue polygon_mm 0 2", 20, -20, "x 22 mm"),
            ("tissue holes_mm 0 0 1", -10, 0, "Point 2 of hole 1 of tissue organ"),
            ("tissue radius 1", 15, 0, "Radius of tissue 2, 4 mm"),
            ("layer 1", 40, 0, "Begin of layer 2, x 40 mm"),
        ):
            first = label(page, key)
            drag(page, key, across, down)
            wait_for(page, "planned", "done")
            assert label(page, key) != first
            assert page.locator("#message").is_hidden()
            assert before in first or key.startswith("tissue polygon")
        drag(page, "layer 0", 900, 0)
        wait_for(page, "planned", "done")
        ends = [float(label(page, f"layer {number}").split()[-2]) for number in (0, 1)]
        assert ends[0] == pytest.approx(ends[1] - 0.1)
        page.focus('[data-key="tissue body 1"]')
        page.keyboard.press("Delete")
        expect(page.locator('.handle[data-key="tissue body 1"]')).to_have_count(0)
        page.get_by_role("button", name="Undo").click()
        expect(page.locator('.handle[data-key="tissue body 1"]')).to_have_count(1)


def test_executions_are_played(page: Page) -> None:
    whole = page.locator("#plane canvas").screenshot()
    page.get_by_role("button", name="Play the executions").click()
    wait_for_new_picture(page, whole)
    page.get_by_role("button", name="Show all of the executions").click()
    expect(page.get_by_role("button", name="Play the executions")).to_be_visible()
    assert page.locator("#plane canvas").screenshot() == whole
    page.get_by_role("button", name="Play the executions").click()
    drag(page, "target", -10, 5)
    expect(page.get_by_role("button", name="Play the executions")).to_be_visible()
    wait_for(page, "done")
