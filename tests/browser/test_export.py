"""`view --export`: the page of one plan in one file, opened from the disk."""

from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page

import needleplan as npl
from tests.browser.browser import drag, told, wait_for
from tests.cli.commands import needleplan, refused
from tests.conftest import SMALL

pytestmark = pytest.mark.slow


def test_the_file_shows_the_plan_without_a_server(browser: Browser, table: npl.PolicyTable, tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL.replace('"Small"', '"</script><b>Small"'))
    done = needleplan("view", tmp_path / "small.toml", "--start=0,20,-5", "--export", tmp_path / "plan.html")
    assert done.returncode == 0, done.stderr
    wrong: list[str] = []
    context = browser.new_context(viewport={"width": 1280, "height": 800}, offline=True)
    context.grant_permissions(["clipboard-read", "clipboard-write"])
    page = context.new_page()
    page.on("console", lambda message: wrong.append(message.text))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on(
        "request",
        lambda request: None if request.url.startswith(("file:", "data:", "blob:")) else wrong.append(request.url),
    )
    page.goto((tmp_path / "plan.html").as_uri())
    wait_for(page, "done")
    path = table.path(npl.Pose.deg(0, 20, -5))
    assert told(page, "length") == f"{path.length_mm:.1f} mm"
    assert page.locator("#title").inner_text() == "</script><b>Small"
    assert page.locator(".handle").first.is_hidden()
    assert page.get_by_role("button", name="Undo").is_hidden()
    page.mouse.move(400, 400)
    assert "success" in page.locator("#values").inner_text()
    with page.expect_download() as download:
        page.locator("summary", has_text="File").click()
        page.get_by_role("button", name="Save scenario").click()
    download.value.save_as(tmp_path / "again.toml")
    assert npl.Scenario.read(tmp_path / "again.toml") == npl.Scenario.read(tmp_path / "small.toml")
    assert not wrong, wrong
    context.close()


def test_the_page_writes_what_it_shows(page: Page, browser: Browser, tmp_path: Path) -> None:
    drag(page, "target", -60, 20)
    wait_for(page, "done")
    with page.expect_download() as download:
        page.locator("summary", has_text="File").click()
        page.get_by_role("button", name="Download page").click()
    download.value.save_as(tmp_path / "plan.html")
    copy = browser.new_page()
    copy.goto((tmp_path / "plan.html").as_uri())
    wait_for(copy, "done")
    for name in ("predicted", "realised", "interval", "length", "turns", "entry", "states"):
        assert told(copy, name) == told(page, name)
    copy.close()


def test_a_file_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "plan.html").write_text("mine")
    refused(needleplan("view", "layered", "--export", tmp_path / "plan.html"), "plan.html", "--force")
    assert (tmp_path / "plan.html").read_text() == "mine"


def test_the_widget_of_a_notebook_shows_the_plan(browser: Browser, table: npl.PolicyTable, tmp_path: Path) -> None:
    start = npl.Pose.deg(0, 20, -5)
    (tmp_path / "notebook.html").write_text(f"<!doctype html><p>{npl.view(table, start)._repr_html_()}")
    wrong: list[str] = []
    context = browser.new_context(viewport={"width": 1000, "height": 900}, offline=True)
    page = context.new_page()
    page.on("console", lambda message: wrong.append(message.text))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto((tmp_path / "notebook.html").as_uri())
    frame = page.frame_locator("iframe")
    length = frame.locator('[data-name="length"]')
    length.get_by_text(f"{table.path(start).length_mm:.1f} mm").wait_for()
    page.mouse.move(400, 400)
    assert "success" in frame.locator("#values").inner_text()
    assert not wrong, wrong
    context.close()
