"""What may go wrong around the page: there is a message, never a blank page, and no work is lost."""

from dataclasses import replace

import numpy as np
import pytest
from playwright.sync_api import Browser, Page

import needleplan as npl
from tests.browser.browser import drag, label, opened, wait_for
from tests.page.served import Served, served

pytestmark = pytest.mark.slow


def alert(page: Page, text: str) -> None:
    """Wait for a message with a text."""
    page.get_by_role("alert").filter(has_text=text).wait_for()


def test_a_target_in_an_obstacle_is_a_message_and_the_plan_stays(page: Page) -> None:
    page.focus('[data-key="target"]')
    for _ in range(5):
        page.keyboard.press("Shift+ArrowLeft")
    for _ in range(3):
        page.keyboard.press("Shift+ArrowDown")
    wait_for(page, "refused")
    alert(page, "must not lie in or on an obstacle")
    page.keyboard.press("Control+z")
    wait_for(page, "done")
    assert page.get_by_role("alert").is_hidden()


def test_the_server_is_restarted(browser: Browser, small: npl.Scenario, table: npl.PolicyTable) -> None:
    with served(small, table) as first, opened(browser, first, allowed="Failed to load resource") as page:
        wait_for(page, "done")
        first_label = label(page, "target")
        drag(page, "target", -40, 20)
        wait_for(page, "done")
        port = first.port
        context = page.context
        first.stop()
        drag(page, "entry", 0, -60)
        alert(page, "does not answer")
        moved, entry = label(page, "target"), label(page, "entry")
        assert moved != first_label
        with served(small, table, port=port, token="another") as second:
            alert(page, "the token is wrong")
            tab = context.new_page()
            tab.goto(second.address)
            wait_for(tab, "done")
            assert (label(tab, "target"), label(tab, "entry")) == (moved, entry)  # the edits are back
            wait_for(page, "done")  # the first tab goes on with the token of the second
            assert (label(page, "target"), label(page, "entry")) == (moved, entry)
            tab.keyboard.press("Control+z")
            wait_for(tab, "done")
            assert label(tab, "target") == first_label


def test_two_tabs_do_not_disturb_each_other(page: Page, server: Served) -> None:
    other = page.context.new_page()
    other.goto(server.address)
    wait_for(other, "done")
    for _ in range(2):
        for tab, across in ((page, -20), (other, 10)):
            tab.bring_to_front()  # browsers draw the visible tab only
            drag(tab, "target", across, 15)
    wait_for(other, "done")
    page.bring_to_front()
    wait_for(page, "done")
    assert label(page, "target") != label(other, "target")


def test_a_dropped_table_is_planned_again(page: Page, server: Served) -> None:
    server.page.queue.forget()
    drag(page, "entry", 0, 30)
    wait_for(page, "done")


def test_a_reload_keeps_the_edits(page: Page) -> None:
    drag(page, "target", -50, 30)
    wait_for(page, "done")
    moved = label(page, "target")
    page.reload()
    wait_for(page, "done")
    alert(page, "Your edits of this scenario are back")
    assert label(page, "target") == moved
    page.get_by_role("button", name="Undo").click()
    wait_for(page, "done")
    assert label(page, "target") == "Target, x 50 mm, y 25 mm"


def test_without_the_token_there_is_a_message(browser: Browser, server: Served) -> None:
    with opened(browser, server, allowed="Failed to load resource") as page:
        wait_for(page, "done")
        page.evaluate("localStorage.clear()")
        page.goto("about:blank")
        page.goto(server.address.split("#")[0])
        alert(page, "open the address that `needleplan view` has printed")


def test_kept_rubbish_does_no_harm(page: Page) -> None:
    page.evaluate(
        """for (const storage of [localStorage, sessionStorage])
             for (const [key] of Object.entries(storage)) if (key.startsWith("needleplan edits")) storage[key] = "{";"""
    )
    drag(page, "entry", 0, 20)
    page.evaluate(
        "for (const key in sessionStorage) if (key.startsWith('needleplan edits')) sessionStorage[key] = '[1'"
    )
    page.evaluate("for (const key in localStorage) if (key.startsWith('needleplan edits')) localStorage[key] = 'null'")
    page.reload()
    wait_for(page, "done")
    assert label(page, "target") == "Target, x 50 mm, y 25 mm"


@pytest.mark.study
def test_an_obstacle_with_thousands_of_corners(browser: Browser, small: npl.Scenario) -> None:
    """Segmented organs have many corners; only the body of such an obstacle has a handle."""
    turns = np.linspace(0, 2 * np.pi, 4000, endpoint=False)
    organ = npl.Obstacle(np.column_stack([25 + 5 * np.cos(turns), 10 + 5 * np.sin(turns)]).round(4).tolist(), "organ")
    organ_scene = replace(small, obstacles=(*small.obstacles, organ), title="organ")
    with served(organ_scene) as server, opened(browser, server) as page:
        wait_for(page, "done")
        assert page.locator(".handle").count() < 20
        page.focus('[data-key="body 0"]')
        assert page.locator('.handle[data-key^="polygon_mm 0"]').count() == 5
        before = label(page, "body 1")
        drag(page, "body 1", 20, 10)
        wait_for(page, "done")
        assert label(page, "body 1") != before
