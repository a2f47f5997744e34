"""The page in a real browser: it shows the plan, and a drag changes the path."""

import pytest
from playwright.sync_api import Page

import needleplan as npl
from tests.browser.browser import drag, told, wait_for


def test_a_drag_changes_the_path(page: Page, table: npl.PolicyTable) -> None:
    best = table.best_entry()
    assert told(page, "predicted") == f"{100 * best.success:.1f} %"
    assert told(page, "length") == f"{table.path(best).length_mm:.1f} mm"
    assert float(told(page, "realised").split()[0]) == pytest.approx(100 * table.rollout(best, 2000).success, abs=0.051)
    before, entry = page.locator("#plane canvas").screenshot(), told(page, "entry")
    drag(page, "entry", 60, 40)
    wait_for(page, "planned", "done")
    assert told(page, "entry") != entry
    moved = told(page, "entry")
    assert moved != f"{best.pose.x_mm:.1f}"
    drag(page, "target", -40, -30)
    wait_for(page, "planned", "done")
    assert page.locator('.handle[data-key="target"]').get_attribute("aria-label") != "Target, x 50 mm, y 25 mm"
    assert page.locator("#plane canvas").screenshot() != before
    assert told(page, "entry") == moved
