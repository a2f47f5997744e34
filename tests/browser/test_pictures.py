"""Pictures of the key states of the page, in `out/pictures` for a person to look at.

The tests look for what a picture must not be: blank, wider than the window, or with one button over another.
"""

import re
from itertools import combinations, product
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, FloatRect, Page, ViewportSize, expect

from needleplan.anatomy import SpaceScenario
from needleplan.page import DiagnosisFile, DiagnosisPage, SpacePage
from tests import pages
from tests.anatomy.volumes import anatomy, box
from tests.browser.browser import SCHEMES, STALL, drag, opened, wait_for
from tests.page.diagnosed import written
from tests.page.served import Served, serving

pytestmark = [pytest.mark.study, pytest.mark.usefixtures("few_executions")]

PICTURES = pages.ROOT / "out" / "pictures"
SIZES: dict[str, ViewportSize] = {"screen": {"width": 1280, "height": 800}, "tablet": {"width": 820, "height": 1180}}
# Fewest colours of a canvas with a drawing: axes, texts and curves have shades at their edges.
FEWEST_COLOURS = 30


def overlap(one: FloatRect, other: FloatRect) -> bool:
    """Return whether two boxes share more than a pixel."""
    across = min(one["x"] + one["width"], other["x"] + other["width"]) - max(one["x"], other["x"])
    down = min(one["y"] + one["height"], other["y"] + other["height"]) - max(one["y"], other["y"])
    return across > 1 and down > 1


def picture(page: Page, name: str) -> None:
    """Take a picture of the page and look for faults."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=PICTURES / f"{name}.png")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), name
    buttons = [
        (each.inner_text(), each.bounding_box()) for each in page.locator(".tools > button, .tools summary").all()
    ]
    shown = [(text, place) for text, place in buttons if place]
    assert len(shown) > 1
    for (first, one), (second, other) in combinations(shown, 2):
        assert not overlap(one, other), (name, first, second)
    for canvas in page.locator("canvas:visible").all():
        file = PICTURES / f"{name}.canvas.png"
        canvas.screenshot(path=file)
        colours = np.unique(np.asarray(Image.open(file).convert("RGBA")).view(np.uint32)).size
        file.unlink()
        assert colours >= FEWEST_COLOURS, (name, canvas.get_attribute("aria-label"))


def pictures(page: Page, name: str) -> None:
    """Take a picture in each size and scheme: the page draws itself again for another window and another scheme."""
    for (size, viewport), scheme in product(SIZES.items(), SCHEMES):
        page.set_viewport_size(viewport)
        page.emulate_media(color_scheme=scheme)
        wait_for_two_frames(page)
        picture(page, f"{name}-{size}-{scheme}")
    page.set_viewport_size(SIZES["screen"])


def test_states_of_a_plan(browser: Browser, server: Served) -> None:
    with opened(browser, server) as page:
        wait_for(page, "done")
        pictures(page, "plan")
        page.get_by_role("button", name="Compare").click()
        drag(page, "target", -40, 20)
        wait_for(page, "done")
        pictures(page, "compare")


def test_states_of_an_insertion(browser: Browser, server: Served) -> None:
    with opened(browser, server) as page:
        wait_for(page, "done")
        page.locator("#twin summary").click()
        page.get_by_role("button", name="Insert").click()
        expect(page.locator("#replay output")).to_have_text(re.compile(r"end: \w+"), timeout=120_000)
        pictures(page, "insertion")


def wait_for_two_frames(page: Page) -> None:
    """Wait until the page has drawn what a change of its window asks for."""
    page.evaluate("new Promise(drawn => requestAnimationFrame(() => requestAnimationFrame(drawn)))")


def test_states_of_a_diagnosis(browser: Browser, tmp_path: Path) -> None:
    file = DiagnosisFile.read(written(tmp_path))
    with serving(DiagnosisPage(file)) as shown, opened(browser, shown) as page:
        wait_for(page, "done")
        pictures(page, "diagnosis")
        page.get_by_label("Horizontal axis").select_option("depth")
        pictures(page, "diagnosis-depth")


def test_states_in_space(browser: Browser) -> None:
    found = anatomy(box())
    with (
        serving(SpacePage(SpaceScenario.of(found), "box.toml", found)) as shown,
        opened(browser, shown, allowed=STALL) as page,
    ):
        wait_for(page, "done")
        pictures(page, "space")
