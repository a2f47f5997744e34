"""`view FOLDER`: a diagnosis before and after, trial by trial."""

import json
import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

import needleplan as npl
from needleplan.cli import main
from needleplan.page import DiagnosisFile, DiagnosisPage
from needleplan.reports.diagnosis import traces_of
from needleplan.reports.diagnosis.document import held_out_rms
from tests.browser.browser import opened, wait_for
from tests.cli.commands import needleplan, refused
from tests.page.diagnosed import ODD, found, written
from tests.page.served import Served, serving

MINUS = "\N{MINUS SIGN}"
TABLET = {"viewport": {"width": 820, "height": 1180}, "has_touch": True, "is_mobile": True, "device_scale_factor": 2}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("diagnosed"))


@pytest.fixture(scope="module")
def diagnosis_server(folder: Path) -> Iterator[Served]:
    with serving(DiagnosisPage(DiagnosisFile.read(folder))) as server:
        yield server


@pytest.fixture
def shown(browser: Browser, diagnosis_server: Served) -> Iterator[Page]:
    with opened(browser, diagnosis_server) as page:
        wait_for(page, "done")
        yield page


def picture(page: Page) -> bytes:
    return page.locator("#curves canvas").screenshot()


def three(value: float) -> str:
    """Return a number as the page writes it."""
    return f"{value:.3g}".replace("-", MINUS)


@pytest.mark.slow
def test_the_result_is_that_of_the_diagnosis(shown: Page) -> None:
    diagnosis = found()
    size = diagnosis.effects[0].estimates["size"]
    assert shown.locator("#title").inner_text() == "Diagnosis: missing effect: viscous friction"
    assert "The missing effect is known" in shown.locator('[data-name="verdict"]').inner_text()
    text = shown.locator("[data-effect] tbody").inner_text()
    told = [float(each.replace(MINUS, "-")) for each in re.findall(rf"[\d.]+e{MINUS}\d+", text)]
    assert told == pytest.approx([size.value, size.low, size.high], rel=5e-3)
    assert "N s/mm\N{SUPERSCRIPT TWO}" in text
    given = shown.get_by_role("table", name="The given model beside the data").locator("tbody tr")
    assert given.count() == len(diagnosis.estimates())
    (friction,) = [row for row in given.all_inner_texts() if row.startswith("friction")]
    assert "outside" in friction
    beyond = "each => each.getBoundingClientRect().right > each.closest('#found').getBoundingClientRect().right"
    assert shown.locator("#found td, #found th").evaluate_all(f"cells => cells.filter({beyond}).length") == 0
    held = held_out_rms(diagnosis)
    assert held
    for name, value in (("before", held["before_rms"]), ("after", held["after_rms"]), ("noise", held["floor_rms"])):
        assert f"{three(value)} N" in shown.locator(f'[data-gap="{name}"]').inner_text()
    rows = shown.get_by_role("table", name="Residual RMS, N").locator("tbody tr")
    assert rows.count() == 3
    assert ODD in rows.nth(0).inner_text()
    facts = shown.get_by_role("table", name="Provenance").inner_text()
    assert diagnosis.digest in facts
    assert "data of trial 2" in facts
    hypotheses = shown.locator("h2:text-is('Hypotheses') + ul li")
    assert "% viscous: it leads" in hypotheses.nth(0).inner_text()
    assert "nats behind" in hypotheses.nth(1).inner_text()


def test_trials_curves_and_values_are_chosen(shown: Page) -> None:
    before = picture(shown)
    shown.get_by_role("button", name="trial 2 held out").click()
    assert picture(shown) != before
    assert "held out: residual" in shown.locator("#live").inner_text()
    slider = shown.get_by_label("Sample of the trial")
    slider.fill("100")
    trace = traces_of(found())[2]
    assert trace.after is not None
    told = shown.locator(".place output").inner_text().replace(MINUS, "-")
    for part in (f"{trace.motion.time_s[100]:.2f} s", f"depth {trace.motion.depth_mm[100]:.1f} mm",
                 f"measured {trace.measured[0, 100]:.3f} N", f"after {trace.after[0, 100]:.3f} N"):  # fmt: skip
        assert part in told
    whole = picture(shown)
    shown.get_by_label("model before").uncheck()
    assert picture(shown) != whole
    shown.get_by_label("model before").check()
    assert picture(shown) == whole
    shown.get_by_role("button", name="Zoom in").click()
    assert picture(shown) != whole
    shown.get_by_role("button", name="Whole").click()
    assert picture(shown) == whole
    shown.get_by_label("Horizontal axis").select_option("depth")
    assert picture(shown) != whole
    box = shown.locator("#curves canvas").bounding_box()
    assert box
    shown.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 50)
    assert shown.locator(".place output").inner_text().replace(MINUS, "-") != told


@pytest.mark.study
def test_everything_is_done_with_the_keyboard(shown: Page) -> None:
    what = "[document.activeElement.name, document.activeElement.textContent, document.activeElement.type].join('|')"
    reached = []
    for _ in range(20):
        shown.keyboard.press("Tab")
        reached.append(shown.evaluate(what))
        if "trial 1" in reached[-1]:
            shown.keyboard.press("Enter")
            assert shown.locator("#live").inner_text().startswith("Trial trial 1, training")
        if reached[-1].startswith("after|"):
            before = picture(shown)
            shown.keyboard.press("Space")
            assert picture(shown) != before
        if "|range" in reached[-1]:
            told = shown.locator(".place output").inner_text()
            shown.keyboard.press("ArrowRight")
            assert shown.locator(".place output").inner_text() != told
            assert "measured" in str(shown.get_by_label("Sample of the trial").get_attribute("aria-valuetext"))
            break
    else:
        pytest.fail(f"the slider was not reached: {reached}")


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"color_scheme": "light"}, {"color_scheme": "dark"}, TABLET])
def test_axe_finds_nothing_in_a_diagnosis(browser: Browser, diagnosis_server: Served, options: dict[str, Any]) -> None:
    with opened(browser, diagnosis_server, **options) as page:
        wait_for(page, "done")
        page.locator("summary", has_text="File").click()
        flaws = Axe().run(page).response["violations"]
        assert [f"{each['id']}: {each['nodes'][0]['target']}" for each in flaws] == []
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        light = picture(page)
        page.locator("summary", has_text="File").click()
        page.get_by_role("button", name="Theme").click()
        assert picture(page) != light


@pytest.mark.study
def test_what_is_copied_finds_the_same(
    shown: Page, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder.parent)
    shown.context.grant_permissions(["clipboard-read", "clipboard-write"])
    shown.locator("summary", has_text="File").click()
    shown.get_by_role("button", name="Copy as Python").click()
    shown.get_by_role("alert").filter(has_text="Copied: Python").wait_for()
    exec(shown.evaluate("navigator.clipboard.readText()"), {})
    assert capsys.readouterr().out == "named viscous\n"
    shown.locator("summary", has_text="File").click()
    shown.get_by_role("button", name="Copy as command").click()
    shown.get_by_role("alert").filter(has_text="Copied: commands").wait_for()
    first, second = shown.evaluate("navigator.clipboard.readText()").splitlines()
    assert main(shlex.split(first)[1:]) == 0
    assert json.loads(Path("again/diagnosis.json").read_text())["verdict"] == "named"
    assert second == "needleplan view again"


@pytest.mark.study
def test_a_diagnosis_without_a_name_has_a_next_motion(browser: Browser, tmp_path: Path) -> None:
    with (
        serving(DiagnosisPage(DiagnosisFile.read(written(tmp_path, alone=True)))) as server,
        opened(browser, server) as page,
    ):
        wait_for(page, "done")
        assert page.locator("[data-effect]").count() == 0
        assert "Missing data: no held-out trial" in page.locator("#found").inner_text()
        motion = page.get_by_label("Depth over time of the next motion")
        expect(motion).to_be_visible()
        assert page.evaluate("document.querySelector('.motion').width > 200")
        assert "next_motion.toml" in page.locator("#found").inner_text()


@pytest.mark.slow
def test_without_curves_the_rest_is_shown(browser: Browser, folder: Path, tmp_path: Path) -> None:
    place = Path(shutil.copytree(folder, tmp_path / "found"))
    (place / "traces.h5").unlink()
    with serving(DiagnosisPage(DiagnosisFile.read(place))) as server, opened(browser, server) as page:
        wait_for(page, "done")
        assert "traces.h5 is missing" in page.get_by_role("alert").inner_text()
        assert page.locator("#curves").is_hidden()
        box = page.locator("#found").bounding_box()
        assert box
        assert box["width"] > 600
        assert box["x"] + box["width"] / 2 == pytest.approx(640, abs=10)
        assert page.locator("[data-effect]").is_visible()


@pytest.mark.slow
def test_the_file_and_the_widget_show_the_diagnosis(browser: Browser, folder: Path, tmp_path: Path) -> None:
    done = needleplan("view", folder, "--export", tmp_path / "found.html")
    assert done.returncode == 0, done.stderr
    (tmp_path / "notebook.html").write_text(f"<!doctype html><p>{npl.view(found())._repr_html_()}")
    wrong: list[str] = []
    context = browser.new_context(viewport={"width": 1280, "height": 800}, offline=True)
    context.grant_permissions(["clipboard-read", "clipboard-write"])
    page = context.new_page()
    page.on("console", lambda message: wrong.append(message.text))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on(
        "request", lambda asked: None if asked.url.startswith(("file:", "data:", "blob:")) else wrong.append(asked.url)
    )
    page.goto((tmp_path / "found.html").as_uri())
    wait_for(page, "done")
    page.get_by_role("button", name="trial 1 training").click()
    assert "measured" in page.locator(".place output").inner_text()
    assert page.get_by_role("button", name="Download page").is_hidden()
    page.locator("summary", has_text="File").click()
    page.get_by_role("button", name="Copy as command").click()
    page.get_by_role("alert").filter(has_text="Copied").wait_for()
    assert page.evaluate("navigator.clipboard.readText()").startswith("needleplan diagnose base.toml data.csv")
    page.goto((tmp_path / "notebook.html").as_uri())
    frame = page.frame_locator("iframe")
    frame.locator('[data-gap="after"]').wait_for()
    frame.locator("summary", has_text="File").click()
    frame.get_by_role("button", name="Copy as Python").click()
    frame.get_by_role("alert").filter(has_text="diagnose again").wait_for()
    assert not wrong, wrong
    context.close()


@pytest.mark.slow
def test_what_is_no_diagnosis_is_refused(folder: Path, tmp_path: Path) -> None:
    refused(needleplan("view", tmp_path, "--no-browser"), "holds no diagnosis.json")
    (tmp_path / "diagnosis.json").write_text((folder / "diagnosis.json").read_text()[:5000])
    refused(needleplan("view", tmp_path / "diagnosis.json", "--no-browser"), "diagnosis.json", "is damaged")
    refused(needleplan("view", folder, "--start", "0,0,0"), "--start", "diagnosis")
    refused(needleplan("view", tmp_path / "none.json", "--no-browser"), "none.json", "cannot be read")
