"""The page of a plan in space: slices, view in space, ranked entries, files, and the copy without a server."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page

from needleplan.anatomy import Anatomy, SpaceScenario
from needleplan.page import SpacePage
from needleplan.planning import EntryMap, SpaceTable, plan_space, rank_entries
from tests.anatomy.volumes import TEXT, anatomy, box, write
from tests.browser.browser import opened, told, wait_for
from tests.cli.commands import needleplan
from tests.page.served import Served, serving

MINUS = "\N{MINUS SIGN}"
# Chromium says this of screenshots of WebGL when it has no graphics card.
STALL = "GPU stall due to ReadPixels"


@pytest.fixture(scope="module")
def entries() -> EntryMap:
    return rank_entries(anatomy(box()), threads=1)


@pytest.fixture(scope="module")
def space_server() -> Iterator[Served]:
    found = anatomy(box())
    with serving(SpacePage(SpaceScenario.of(found), "box.toml", found)) as server:
        yield server


@pytest.fixture
def space(browser: Browser, space_server: Served) -> Iterator[Page]:
    with opened(browser, space_server, allowed=STALL) as page:
        wait_for(page, "done")
        yield page


def picture(page: Page, part: str) -> bytes:
    return page.locator(part).screenshot()


def test_the_numbers_are_those_of_the_ranked_entries(space: Page, entries: EntryMap) -> None:
    ranked = [entries.entry(number, runs=0) for number in entries.best(20)]
    assert told(space, "predicted") == f"{100 * ranked[0].success:.1f} %"
    assert told(space, "length") == f"{ranked[0].length_mm:.1f} mm"
    realised = entries.realised(entries.best(1)[0], 2000)
    assert told(space, "realised") == f"{100 * realised:.1f} %"
    rows = space.locator("#ranked tbody tr")
    assert rows.count() == len(ranked)
    assert rows.nth(1).locator("td").nth(1).inner_text() == f"{100 * ranked[1].success:.1f} %"
    before = picture(space, "#scene canvas")
    rows.nth(1).get_by_role("button").click()
    wait_for(space, "done")
    assert told(space, "predicted") == f"{100 * ranked[1].success:.1f} %"
    assert picture(space, "#scene canvas") != before
    assert "realised" in space.locator("#live").inner_text()


@pytest.mark.slow
def test_the_slices_follow_sliders_keys_and_clicks(space: Page, entries: EntryMap) -> None:
    slider = space.get_by_label("Slice across x").and_(space.locator("input"))
    before = picture(space, 'figure[data-across="0"] canvas')
    slider.focus()
    for _ in range(3):
        space.keyboard.press("ArrowLeft")
    at = int(slider.input_value())
    assert picture(space, 'figure[data-across="0"] canvas') != before
    grid = entries.grid
    index = [int(space.locator(f'figure[data-across="{axis}"] input').input_value()) for axis in range(3)]
    assert index[0] == at
    place = grid.frame.world(np.array(index) * grid.frame.spacing_mm)
    words = space.locator("#there").inner_text()
    assert words.startswith("R, A, S " + ", ".join(f"{mm:.1f}" for mm in place).replace("-", MINUS) + " mm; ")
    success = entries.success_field()[tuple(index)]
    assert f"success {100 * np.rint(success * 255) / 255:.1f} %" in words
    box_ = space.locator('figure[data-across="2"] canvas').bounding_box()
    assert box_
    space.mouse.click(box_["x"] + box_["width"] * 0.4, box_["y"] + box_["height"] / 2)
    assert int(slider.input_value()) != at
    space.get_by_label("success of the best direction; else tissues").uncheck()
    assert picture(space, 'figure[data-across="2"] canvas') != before


@pytest.mark.slow
def test_a_menu_is_used_with_the_keyboard(space: Page) -> None:
    summary = space.locator("summary", has_text="File")
    summary.focus()
    space.keyboard.press("Enter")
    button = space.get_by_role("button", name="Copy as command")
    assert button.is_visible()
    space.keyboard.press("Tab")
    space.keyboard.press("Escape")
    assert button.is_hidden()
    assert space.evaluate("document.activeElement.textContent") == "File"


@pytest.mark.slow
def test_the_view_turns_and_a_click_chooses_an_entry(space: Page, entries: EntryMap) -> None:
    canvas = space.locator("#scene canvas")
    before = picture(space, "#scene canvas")
    canvas.focus()
    space.keyboard.press("ArrowLeft")
    space.keyboard.press("+")
    assert picture(space, "#scene canvas") != before
    box_ = canvas.bounding_box()
    assert box_
    # Some square of the entry region is left of the middle: clicks on a grid of points find one.
    chosen = told(space, "entry, RAS")
    for across in np.linspace(0.1, 0.6, 16):
        for down in (0.4, 0.5, 0.6):
            space.mouse.click(box_["x"] + across * box_["width"], box_["y"] + down * box_["height"])
            wait_for(space, "done")
            if told(space, "entry, RAS") != chosen:
                here = entries.grid.frame.world(entries.poses[:, :3])
                words = {", ".join(f"{mm:.1f}" for mm in each).replace("-", MINUS) + " mm" for each in here}
                assert told(space, "entry, RAS") in words
                return
    pytest.fail("no click has chosen another entry")


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_in_space(browser: Browser, space_server: Served, scheme: str) -> None:
    with opened(browser, space_server, allowed=STALL, color_scheme=scheme) as page:
        wait_for(page, "done")
        found = Axe().run(page).response["violations"]
        assert [f"{each['id']}: {each['nodes'][0]['target']}" for each in found] == []


@pytest.mark.slow
def test_files_and_the_copy_without_a_server(space: Page, browser: Browser, entries: EntryMap, tmp_path: Path) -> None:
    for name, file in (("Download success", "success.nii.gz"), ("Download page", "plan.html")):
        with space.expect_download() as download:
            space.locator("summary", has_text="File").click()
            space.get_by_role("button", name=name).click()
        download.value.save_as(tmp_path / file)
    image = SimpleITK.GetArrayFromImage(SimpleITK.ReadImage(str(tmp_path / "success.nii.gz")))
    assert np.allclose(image.transpose(2, 1, 0), entries.success_field())
    copy = browser.new_page()
    wrong: list[str] = []
    copy.on("pageerror", lambda error: wrong.append(str(error)))
    copy.on(
        "request", lambda asked: None if asked.url.startswith(("file:", "data:", "blob:")) else wrong.append(asked.url)
    )
    copy.goto((tmp_path / "plan.html").as_uri())
    wait_for(copy, "done")
    for name in ("predicted", "realised", "length", "entry, RAS", "states"):
        assert told(copy, name) == told(space, name)
    copy.locator("#ranked tbody tr").nth(2).get_by_role("button").click()
    wait_for(copy, "done")
    assert told(copy, "predicted") == f"{100 * entries.entry(entries.best(3)[2], runs=0).success:.1f} %"
    assert not wrong
    copy.close()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["anatomy", "table"])
def test_what_is_copied_computes_what_is_shown(
    browser: Browser, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    file = write(tmp_path, box())
    found = Anatomy.read(file)
    page_ = SpacePage(SpaceScenario.of(found), "anatomy.toml", found)
    if kind == "table":
        plan_space(SpaceScenario.of(found)).write("table.h5")
        page_.close()
        page_ = SpacePage(SpaceTable.read("table.h5"), "table.h5")
    with serving(page_) as server, opened(browser, server, allowed=STALL) as page:
        wait_for(page, "done")
        page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        page.locator("#ranked tbody tr").nth(1).get_by_role("button").click()
        wait_for(page, "done")
        page.locator("summary", has_text="File").click()
        page.get_by_role("button", name="Copy as Python").click()
        page.get_by_role("alert").filter(has_text="Copied: Python").wait_for()
        exec(page.evaluate("navigator.clipboard.readText()"), {})
        predicted, realised = (float(told(page, name).split()[0]) / 100 for name in ("predicted", "realised"))
        printed = [float(each) for each in re.findall(r"0\.\d{3}|1\.000", capsys.readouterr().out.splitlines()[0])]
        assert printed == pytest.approx([predicted, realised], abs=1e-9)
        page.locator("summary", has_text="File").click()
        page.get_by_role("button", name="Copy as command").click()
        page.get_by_role("alert").filter(has_text="Copied: commands").wait_for()
        words = shlex.split(page.evaluate("navigator.clipboard.readText()"))
        if kind == "anatomy":
            done = needleplan(*words[1:])
            assert told(page, "predicted") in done.stdout
        else:
            assert words == ["needleplan", "view", "table.h5"]
        with page.expect_download() as download:
            page.locator("summary", has_text="File").click()
            page.get_by_role("button", name="Download table").click()
        download.value.save_as("again.h5")
        assert SpaceTable.read("again.h5").digest == plan_space(SpaceScenario.of(found)).digest


@pytest.mark.slow
def test_a_table_and_an_impossible_anatomy(browser: Browser, tmp_path: Path) -> None:
    file = write(tmp_path, box())
    assert needleplan("plan", file, "-o", tmp_path / "space.h5").returncode == 0
    done = needleplan("view", tmp_path / "space.h5", "--export", tmp_path / "table.html")
    assert done.returncode == 0, done.stderr
    page = browser.new_page()
    page.goto((tmp_path / "table.html").as_uri())
    wait_for(page, "done")
    assert told(page, "predicted").endswith(" %")
    closed = anatomy(box(wall=True), TEXT)
    with (
        serving(SpacePage(SpaceScenario.of(closed), "wall.toml", closed)) as server,
        opened(browser, server, allowed=STALL) as shown,
    ):
        wait_for(shown, "done")
        assert shown.locator("#message").inner_text().startswith("Impossible: no path of this needle leads")
    page.close()
