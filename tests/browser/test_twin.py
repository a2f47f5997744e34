"""Insertions in the lab twin from the page: followed while they run, stepped through, stopped, and left by an edit."""

import re
import threading

import pytest
from playwright.sync_api import Browser, Page, expect

import needleplan as npl
from needleplan.anatomy import SpaceScenario
from needleplan.control import ExecutedStep, Insertion
from needleplan.page import SpacePage
from needleplan.page._inserted import _TwinRun
from tests.anatomy.volumes import anatomy, box
from tests.browser.browser import drag, opened, told, wait_for
from tests.page.served import Served, serving

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("few_executions")]

LONG_MS = 120_000


def begin(page: Page, percent: int, seed: int) -> None:
    page.locator("#twin summary").click()
    page.locator('#twin [name="curvature_error"]').fill(str(percent))
    page.locator('#twin [name="seed"]').fill(str(seed))
    page.get_by_role("button", name="Insert").click()


@pytest.mark.study
def test_an_insertion_is_followed_and_stepped_through(page: Page, server: Served) -> None:
    begin(page, 25, 3)
    output = page.locator("#replay output")
    expect(output).to_have_text(re.compile(r"deviation \d+\.\d\d mm"), timeout=LONG_MS)
    expect(output).to_have_text(re.compile(r"end: \w+"), timeout=LONG_MS)
    found = server.ask("/api/inserted", {}).told
    assert not found["running"]
    assert (found["seed"], found["curvature_error"]) == (3, 0.25)
    last = found["decisions"][-1]["time_s"]
    page.get_by_role("button", name="To the decision before").click()
    assert output.inner_text().startswith(f"{last:.1f} s")
    page.get_by_role("button", name="To the decision before").click()
    assert output.inner_text().startswith(f"{found['decisions'][-2]['time_s']:.1f} s")
    page.get_by_role("button", name="To the next decision").click()
    assert output.inner_text().startswith(f"{last:.1f} s")
    drag(page, "target", -20, 10)
    expect(page.locator("#replay")).to_be_hidden()


@pytest.fixture
def waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """After its second decision an insertion waits for the stop: simulated time would not."""
    stopped, stop, step = threading.Event(), Insertion.stop, _TwinRun.step

    def stop_and_tell(self: Insertion, why: str) -> None:
        stopped.set()
        stop(self, why)

    def wait(self: _TwinRun, executed: ExecutedStep) -> None:
        step(self, executed)
        assert len(self._decisions) < 2 or stopped.wait(LONG_MS / 1e3)

    monkeypatch.setattr(Insertion, "stop", stop_and_tell)
    monkeypatch.setattr(_TwinRun, "step", wait)


@pytest.mark.usefixtures("waiting")
def test_an_insertion_is_stopped(page: Page, server: Served) -> None:
    begin(page, 0, 1)
    output = page.locator("#replay output")
    expect(output).to_have_text(re.compile(r"deviation"), timeout=LONG_MS)
    page.locator("#twin summary").click()
    page.get_by_role("button", name="Stop").click()
    expect(output).to_have_text(re.compile(r"end: stopped"), timeout=LONG_MS)
    assert re.search(r" risk \d+\.\d mm ", output.inner_text())
    assert server.ask("/api/inserted", {}).told["events"][-1]["text"] == "stopped in the page"


@pytest.mark.study
def test_an_insertion_in_space_is_followed_and_left(browser: Browser) -> None:
    found = anatomy(box())
    with (
        serving(SpacePage(SpaceScenario.of(found), "box.toml", found)) as shown,
        opened(browser, shown, allowed="GPU stall due to ReadPixels") as page,
    ):
        wait_for(page, "done")
        page.locator("#ranked tbody tr").nth(1).get_by_role("button").click()
        wait_for(page, "done")
        chosen = told(page, "length")
        begin(page, 0, 3)
        output = page.locator("#replay output")
        expect(output).to_have_text(re.compile(r"end: \w+"), timeout=LONG_MS)
        track = shown.ask("/api/inserted", {}).told
        assert not track["running"]
        assert track["ended"] == told(page, "ended")
        assert f"error {track['error_mm']:.2f} mm" in output.inner_text()
        assert told(page, "decisions") == str(len(track["decisions"]))
        assert track["arrays"]["planned_mm"]["shape"][1] == 3
        assert told(page, "length") == chosen  # the entry stays beside the insertion
        page.get_by_role("button", name="To the decision before").click()
        # Times are rounded, ties to either side.
        time_s = float(output.inner_text().split(" s")[0])
        assert time_s == pytest.approx(track["decisions"][-1]["time_s"], abs=0.051)
        page.locator("#ranked tbody tr").nth(0).get_by_role("button").click()
        wait_for(page, "done")
        expect(page.locator("#replay")).to_be_hidden()
        assert shown.ask("/api/insert", {"number": 10**6}).told["mistakes"][0]["key"] == "number"
        assert shown.ask("/api/insert", {"seed": -1}).told["mistakes"][0]["key"] == "seed"
        begin(page, 10, 1)
        expect(output).to_have_text(re.compile("deviation"), timeout=LONG_MS)
        page.locator("#twin summary").click()
        page.get_by_role("button", name="Stop").click(timeout=LONG_MS)
        expect(output).to_have_text(re.compile(r"end: \w+"), timeout=LONG_MS)


def test_wrong_requests_are_told(server: Served, table: npl.PolicyTable) -> None:
    plan = table.scenario.digest
    for wrong in ({"seed": -1}, {"seed": True}, {"seed": "1"}, {"curvature_error": 2}, {"curvature_error": "much"}):
        told = server.ask("/api/insert", {"plan": plan, **wrong}).told
        assert (told["kind"], told["mistakes"][0]["key"]) == ("input", *wrong)
    assert server.ask("/api/insert", {"plan": "no such"}).told["kind"] == "unknown"
