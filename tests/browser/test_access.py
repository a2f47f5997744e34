"""The page for everybody: keyboard only, screen readers, light and dark, tablets; and two plans side by side."""

import re
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.browser.browser import SCHEMES, TABLET, drag, flaws, label, opened, told, wait_for, wait_for_new_picture
from tests.page.served import Served

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("options", [{}, TABLET])
def test_axe_finds_nothing(browser: Browser, server: Served, options: dict[str, Any]) -> None:
    def both() -> list[str]:
        found = []
        for scheme in SCHEMES[: 1 if options else 2]:
            page.emulate_media(color_scheme=scheme)
            found += flaws(page)
        return found

    with opened(browser, server, **options) as page:
        wait_for(page, "done")
        assert both() == []
        page.get_by_role("button", name="Compare").click()
        page.locator("summary", has_text="File").click()
        assert both() == []
        page.locator("summary", has_text="File").click()
        page.focus('[data-key="body 0"]')
        assert both() == []


def test_everything_is_reached_and_moved_with_the_keyboard(page: Page) -> None:
    focused = "document.activeElement.dataset.key ?? document.activeElement.id"
    reached: list[str] = []
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.append(page.evaluate(focused))
        if reached[-1] == "entry":
            before = label(page, "entry")
            page.keyboard.press("ArrowUp")
            page.keyboard.press("Shift+ArrowDown")
            assert label(page, "entry") != before
        if reached[-1] == "heading":
            before = label(page, "heading")
            page.keyboard.press("ArrowUp")
            assert float(label(page, "heading").split()[-2]) - float(before.split()[-2]) == pytest.approx(1)
        if reached[-1].startswith("middle 0 1"):
            page.keyboard.press("Enter")
            assert page.evaluate(focused) == "polygon_mm 0 2"
            break
    assert [each for each in reached if each in ("entry", "heading", "target", "target radius", "body 0")]
    wait_for(page, "done")
    assert "Predicted success" in page.locator("#live").inner_text()
    page.keyboard.press("Delete")
    wait_for(page, "done")
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+z")
    wait_for(page, "done")
    assert page.locator('.handle[data-key^="polygon_mm 0"]').count() == 5


def test_two_plans_side_by_side(page: Page) -> None:
    before = told(page, "predicted")
    page.get_by_role("button", name="Compare").click()
    pinned = page.locator("#pinned canvas").screenshot()
    drag(page, "target", -60, 30)
    wait_for(page, "done")
    assert page.locator('[data-name="predicted"] + .pinned').inner_text() == before != told(page, "predicted")
    assert page.locator("#pinned canvas").screenshot() == pinned
    page.get_by_role("button", name="Compare").click()
    assert page.locator("#pinned").is_hidden()
    drag(page, "target", 20, 10)
    page.get_by_role("button", name="Compare").click()  # at once, before the executions are there
    wait_for(page, "done")
    expect(page.locator('[data-name="realised"] + .pinned')).to_have_text(re.compile(r"%$"))


def test_light_and_dark(page: Page) -> None:
    light = page.locator("#plane canvas").screenshot()
    page.get_by_role("button", name="Theme").click()
    expect(page.locator("body")).not_to_have_css("background-color", "rgb(255, 255, 255)")
    wait_for_new_picture(page, light)
    assert flaws(page) == []


def test_a_finger_drags_on_a_tablet(browser: Browser, server: Served) -> None:
    with opened(browser, server, **TABLET) as page:
        wait_for(page, "done")
        before = label(page, "target")
        session = page.context.new_cdp_session(page)
        box = page.locator('[data-key="target"]').bounding_box()
        assert box
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        for kind, points in (
            ("Start", [(x, y)]),
            ("Move", [(x - 40, y + 10)]),
            ("Move", [(x - 90, y + 30)]),
            ("End", []),
        ):
            touches = [{"x": across, "y": down} for across, down in points]
            session.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": touches})
        wait_for(page, "done")
        assert label(page, "target") != before
