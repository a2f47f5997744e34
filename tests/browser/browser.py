"""Opens the page in Debian's chromium, and notes everything that must not happen: errors and foreign requests."""

import contextlib
import os
import shutil
import time
from collections.abc import Iterator
from typing import Any, Literal

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, sync_playwright

from tests.page.served import Served

SCHEMES: tuple[Literal["light", "dark"], ...] = ("light", "dark")
TABLET = {"viewport": {"width": 820, "height": 1180}, "has_touch": True, "is_mobile": True, "device_scale_factor": 2}
# Chromium says this of screenshots of WebGL when it has no graphics card.
STALL = "GPU stall due to ReadPixels"
# Longest wait in s for what the page should come to: it draws without a graphics card, on a busy machine.
PATIENCE_S = 120
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@contextlib.contextmanager
def chromium() -> Iterator[Browser]:
    """Run a browser without a window. Skip the test where there is none, but not in continuous integration."""
    if not CHROMIUM:
        if os.environ.get("CI") == "true":
            pytest.fail("chromium is missing")
        pytest.skip("chromium is not installed")
    # Chromium has no sandbox for root, as whom containers run.
    arguments = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield browser
        browser.close()


@contextlib.contextmanager
def opened(browser: Browser, server: Served, *, allowed: str = "", **options: Any) -> Iterator[Page]:
    """Open the page of a server in a new profile; at the end there must be no console error and no foreign request.

    Errors that contain the text `allowed` are accepted, if there is one.
    """
    wrong: list[str] = []
    context = browser.new_context(**{"viewport": {"width": 1280, "height": 800}, **options})
    page = context.new_page()
    page.set_default_timeout(1000 * PATIENCE_S)
    page.on("console", lambda message: wrong.append(message.text) if message.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    origin = server.address.split("#")[0]
    page.on(
        "request",
        lambda request: wrong.append(request.url) if not request.url.startswith((origin, "blob:", "data:")) else None,
    )
    page.goto(server.address)
    yield page
    wrong = [each for each in wrong if not allowed or allowed not in each]
    assert not wrong, wrong
    context.close()


def wait_for(page: Page, *states: str) -> None:
    """Wait until the page is in one of the states: changed, draft, planned, done, refused."""
    page.wait_for_selector(", ".join(f'body[data-state="{state}"]' for state in states))


def flaws(page: Page) -> list[str]:
    """Return what axe-core finds against the rules of accessibility."""
    found = Axe().run(page).response["violations"]
    return [f"{each['id']}: {each['nodes'][0]['target']}" for each in found]


def drag(page: Page, key: str, across: float, down: float) -> None:
    """Drag a handle by some pixels, in a few steps."""
    box = page.locator(f'.handle[data-key="{key}"]').bounding_box()
    assert box
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + across, y + down, steps=5)
    page.mouse.up()


def told(page: Page, name: str) -> str:
    """Return the text of an entry of the panel."""
    return page.locator(f'[data-name="{name}"]').inner_text()


def label(page: Page, key: str) -> str:
    """Return the name of a handle, as a screen reader says it."""
    name = page.locator(f'.handle[data-key="{key}"]').get_attribute("aria-label")
    assert name
    return name


def wait_for_new_picture(page: Page, before: bytes) -> None:
    """Wait until the plane looks otherwise than in the screenshot `before`."""
    end_s = time.monotonic() + PATIENCE_S
    while page.locator("#plane canvas").screenshot() == before:
        assert time.monotonic() < end_s, "the picture has not changed"
