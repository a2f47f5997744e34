"""The page of a 3D plan: slices, 3D view, ranked entries, files, and the copy without a server."""

import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import SimpleITK
from playwright.sync_api import Browser, Page, Route, expect

from needleplan.anatomy import Anatomy, SpaceScenario
from needleplan.page import SpacePage, page_of
from needleplan.planning import EntryMap, SpaceEntry, SpaceTable, plan_space, rank_entries
from tests.anatomy.volumes import TEXT, anatomy, box, write
from tests.browser.browser import SCHEMES, STALL, flaws, opened, told, wait_for
from tests.cli.commands import needleplan
from tests.page.served import Served, serving

DASH = "\N{EN DASH}"
MINUS = "\N{MINUS SIGN}"


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


@pytest.fixture
def unasked(browser: Browser) -> Iterator[Page]:
    """The page of a server that has estimated no entry yet but the listed ones."""
    found = anatomy(box())
    with (
        serving(SpacePage(SpaceScenario.of(found), "box.toml", found)) as server,
        opened(browser, server, allowed=STALL) as page,
    ):
        wait_for(page, "done")
        yield page


def estimated(page: Page) -> None:
    """Wait until the estimate of the chosen entry is shown."""
    page.wait_for_selector('[data-name="success"][aria-busy="false"]')


def success(page: Page) -> list[str]:
    """Return what the panel tells on the success of the entry: estimate, interval, table."""
    return [told(page, name) for name in ("success", "interval", "by the table")]


def words_of(entry: SpaceEntry) -> list[str]:
    """Return what the panel must tell on the success of an entry."""
    low, high = entry.success.interval or (0.0, 0.0)
    estimate, table = f"{100 * entry.success.value:.1f} %", f"{100 * entry.table_success:.1f} %"
    return [estimate, f"{100 * low:.1f}{DASH}{100 * high:.1f} %", table]


def cells(page: Page, row: int) -> list[str]:
    """Return the texts of a row of the list."""
    return page.locator("#ranked tbody tr").nth(row).locator("td").all_inner_texts()


def choose_unlisted(page: Page, entries: EntryMap) -> int:
    """Click on squares of the view until an entry is chosen that is not listed, and return its number."""
    here = entries.grid.frame.world(entries.poses[:, :3])
    words = [", ".join(f"{mm:.1f}" for mm in each).replace("-", MINUS) + " mm" for each in here]
    known = {words[number] for number in entries.best(5)} | {told(page, "entry, RAS")}
    box_ = page.locator("#scene canvas").bounding_box()
    assert box_
    for across in np.linspace(0.1, 0.9, 24):
        for down in (0.4, 0.5, 0.6):
            page.mouse.click(box_["x"] + across * box_["width"], box_["y"] + down * box_["height"])
            wait_for(page, "done")
            if (chosen := told(page, "entry, RAS")) not in known:
                return words.index(chosen)
    pytest.fail("no click has chosen an entry that is not listed")


def picture(page: Page, part: str) -> bytes:
    return page.locator(part).screenshot()


@pytest.mark.slow
def test_the_numbers_are_those_of_the_ranked_entries(space: Page, entries: EntryMap) -> None:
    ranked = [entries.entry(number) for number in entries.best(5)]
    estimated(space)
    assert success(space) == words_of(ranked[0])
    assert told(space, "length") == f"{ranked[0].length_mm:.1f} mm"
    assert space.locator("#ranked caption").inner_text().lower() == "ranked by expected success, in %; by executions"
    shown = [float(cells(space, row)[1]) for row in range(len(ranked))]
    assert shown == sorted(shown, reverse=True)
    assert shown == [float(f"{100 * each.expected_success:.1f}") for each in ranked]
    assert [cells(space, row)[2] for row in range(len(ranked))] == [f"{each.success.shown}" for each in ranked]
    assert told(space, "expected") == f"{100 * ranked[0].expected_success:.1f} %"
    rows = space.locator("#ranked tbody tr")
    assert rows.count() == len(ranked)
    before = picture(space, "#scene canvas")
    rows.nth(1).get_by_role("button").click()
    wait_for(space, "done")
    estimated(space)
    assert success(space) == words_of(ranked[1])
    assert picture(space, "#scene canvas") != before
    low, high = ranked[1].success.interval or (0.0, 0.0)
    assert space.locator("#live").inner_text() == (
        f"Success {ranked[1].success.shown} %, 95 % interval {100 * low:.1f} % to {100 * high:.1f} %, "
        "by 2,000 executions."
    )


@pytest.mark.study
def test_the_table_is_told_at_once_and_a_late_estimate_stands_at_no_other_entry(
    unasked: Page, entries: EntryMap
) -> None:
    estimated(unasked)
    held: list[Route] = []
    unasked.route("**/api/estimate", lambda route: held.append(route))
    first = entries.entry(choose_unlisted(unasked, entries))
    expect(unasked.locator("#live")).to_contain_text("by the table; executions estimate it now")
    assert told(unasked, "by the table") == f"{100 * first.table_success:.1f} %"
    assert told(unasked, "success") == told(unasked, "interval") == "\N{HORIZONTAL ELLIPSIS}"
    second = entries.entry(choose_unlisted(unasked, entries))
    assert len(held) == 1  # that of the second entry waits for that of the first
    with unasked.expect_request("**/api/estimate"):
        held[0].continue_()
    while len(held) < 2:
        assert told(unasked, "success") == "\N{HORIZONTAL ELLIPSIS}"
    assert told(unasked, "by the table") == f"{100 * second.table_success:.1f} %"
    assert told(unasked, "success") == "\N{HORIZONTAL ELLIPSIS}"
    held[1].continue_()
    estimated(unasked)
    assert success(unasked) == words_of(second)
    assert first.success != second.success


@pytest.mark.slow
def test_a_refused_estimate_is_told(unasked: Page, entries: EntryMap) -> None:
    estimated(unasked)
    refusal = json.dumps({"kind": "input", "text": "The table has gone.", "mistakes": []})
    unasked.route("**/api/estimate", lambda route: route.fulfill(content_type="application/problem+json", body=refusal))
    choose_unlisted(unasked, entries)
    unasked.get_by_role("alert").filter(has_text="The table has gone.").wait_for()
    assert told(unasked, "success") == told(unasked, "interval") == DASH
    assert told(unasked, "by the table").endswith(" %")


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
    spacing, (y, z) = grid.frame.spacing_mm, (grid.frame.letters(axis) for axis in (1, 2))
    caption = space.locator('figure[data-across="0"] figcaption').inner_text()
    assert caption == f"lattice x = {at * spacing:.0f} mm; y to the right, z up"
    told_ = space.locator('figure[data-across="0"] canvas').get_attribute("aria-label")
    assert told_ == f"Slice across x, left {y[0]}, right {y[1]}, bottom {z[0]}, top {z[1]}, scale bar 10 mm"
    field = entries.success_field()[tuple(index)]
    assert f"success {100 * np.rint(field * 255) / 255:.1f} % by the table in the best direction" in words
    box_ = space.locator('figure[data-across="2"] canvas').bounding_box()
    assert box_
    space.mouse.click(box_["x"] + box_["width"] * 0.4, box_["y"] + box_["height"] / 2)
    assert int(slider.input_value()) != at
    space.get_by_label("success by the table, best direction; else tissues").uncheck()
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
def test_axe_finds_nothing_in_space(space: Page) -> None:
    for scheme in SCHEMES:
        space.emulate_media(color_scheme=scheme)
        assert flaws(space) == []


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
    assert told(copy, "states") == told(space, "states")
    listed = entries.best(5)
    assert copy.locator("#ranked caption").inner_text().lower() == "ranked by expected success, in %; by executions"
    assert copy.locator("#ranked tbody tr").count() == len(listed)
    for row, number in enumerate(listed):
        entry = entries.entry(number)
        copy.locator("#ranked tbody tr").nth(row).get_by_role("button").click()
        wait_for(copy, "done")
        assert success(copy) == words_of(entry)
        assert cells(copy, row)[1:3] == [f"{100 * entry.expected_success:.1f}", f"{entry.success.shown}"]
        assert told(copy, "length") == f"{entry.length_mm:.1f} mm"
    assert not wrong
    copy.close()


@pytest.mark.study
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
        page_ = page_of(SpaceTable.read("table.h5"), "table.h5")
    with serving(page_) as server, opened(browser, server, allowed=STALL) as page:
        wait_for(page, "done")
        page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        page.locator("#ranked tbody tr").nth(1).get_by_role("button").click()
        wait_for(page, "done")
        page.locator("summary", has_text="File").click()
        page.get_by_role("button", name="Copy as Python").click()
        page.get_by_role("alert").filter(has_text="Copied: Python").wait_for()
        exec(page.evaluate("navigator.clipboard.readText()"), {})
        estimated(page)
        shown = re.findall(r"\d+\.\d", " ".join(success(page)[:2]))
        output = capsys.readouterr().out.splitlines()[0]
        assert re.findall(r"\d+\.\d", output) == shown
        page.locator("summary", has_text="File").click()
        page.get_by_role("button", name="Copy as command").click()
        page.get_by_role("alert").filter(has_text="Copied: commands").wait_for()
        words = shlex.split(page.evaluate("navigator.clipboard.readText()"))
        if kind == "anatomy":
            done = needleplan(*words[1:])
            expected = told(page, "expected").split()
            low, high = told(page, "interval").split(DASH)
            (line,) = [each for each in done.stdout.splitlines() if f"{low} % - " in re.sub(" +", " ", each)]
            assert line.split()[1:10] == [*expected, *told(page, "success").split(), low, "%", "-", *high.split()]
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
    assert told(page, "success").endswith(" %")
    closed = anatomy(box(wall=True), TEXT)
    with (
        serving(SpacePage(SpaceScenario.of(closed), "wall.toml", closed)) as server,
        opened(browser, server, allowed=STALL) as shown,
    ):
        wait_for(shown, "done")
        assert "Impossible: no path of this needle leads" in shown.locator('[data-name="sentences"]').inner_text()
    page.close()
