"""The first lines of each panel: verdict, nearest risk, next step; several targets; a browser without WebGL."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

import needleplan as npl
from needleplan.page import DiagnosisFile, DiagnosisPage, page_of
from needleplan.planning import TargetMap, rank_for_targets
from tests.anatomy.test_several_targets import TWO
from tests.anatomy.volumes import anatomy, box
from tests.browser.browser import STALL, drag, flaws, opened, told, wait_for
from tests.page.diagnosed import written
from tests.page.served import Served, serving

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("few_executions")]

WITHOUT_WEBGL = """const get = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return kind.startsWith("webgl") ? null : get.call(this, kind, ...more);
};"""


def sentences(page: Page) -> list[str]:
    return page.locator('[data-name="sentences"] p').all_inner_texts()


def test_a_plan_in_sentences(page: Page, table: npl.PolicyTable) -> None:
    verdict, risk, next_step = sentences(page)
    assert verdict == f"The needle reaches the target in {told(page, 'realised')} of the executions with tip noise."
    distance_mm = table.path(table.best_entry()).clearance_mm
    assert re.fullmatch(rf"The planned path passes obstacle \w+ at {distance_mm:.1f} mm\.", risk)
    assert next_step.startswith("Next: insert it")
    drag(page, "entry", 0, 60)
    wait_for(page, "done")
    best = f"Next: take the best entry, which reaches the target with {100 * table.best_entry().success:.1f} %."
    assert sentences(page)[-1] == best


@pytest.fixture(scope="module")
def several_server() -> Iterator[Served]:
    with serving(page_of(anatomy(box(), TWO), "box.toml")) as server:
        yield server


@pytest.fixture(scope="module")
def targets() -> TargetMap:
    return rank_for_targets(anatomy(box(), TWO), threads=1)


def test_the_targets_of_one_plan(browser: Browser, several_server: Served, targets: TargetMap, tmp_path: Path) -> None:
    best = targets.best(5)
    with opened(browser, several_server, allowed=STALL) as page:
        wait_for(page, "done")
        choice = page.locator("#targets select")
        assert choice.locator("option").all_inner_texts() == list(targets.names)
        listed = page.locator("#ranked tbody tr td:nth-child(2)").all_inner_texts()
        assert listed == [f"{entry.score:.2f}" for entry in best]
        shown: list[list[str]] = []
        for name in targets.names:
            choice.select_option(name)
            expect(page.locator('[data-name="sentences"]')).to_contain_text(f"target {name} in")
            wait_for(page, "done")
            entry = best[0].targets[name]
            assert told(page, "success") == f"{100 * entry.success.value:.1f} %"
            assert told(page, "length") == f"{entry.length_mm:.1f} mm"
            assert f"{best[0].expected_number:.2f} of the 2 targets" in sentences(page)[2]
            shown.append(sentences(page))
        assert shown[0] != shown[1]
        assert flaws(page) == []
        with page.expect_download() as download:
            page.locator("summary", has_text="File").click()
            page.get_by_role("button", name="Download page").click()
        download.value.save_as(tmp_path / "plan.html")
    copy = browser.new_page()
    copy.goto((tmp_path / "plan.html").as_uri())
    wait_for(copy, "done")
    assert sentences(copy) == shown[0]
    copy.locator("#targets select").select_option(index=1)
    expect(copy.locator('[data-name="sentences"]')).to_contain_text(f"target {targets.names[1]} in")
    assert sentences(copy) == shown[1]
    copy.close()


def test_a_browser_without_webgl_says_so(browser: Browser, several_server: Served) -> None:
    with opened(browser, several_server, allowed=STALL, color_scheme="light") as page:
        page.add_init_script(WITHOUT_WEBGL)
        page.reload()
        wait_for(page, "done")
        assert "has no WebGL 2" in page.locator("#scene").inner_text()
        assert len(sentences(page)) == 4
        assert flaws(page) == []
        page.emulate_media(color_scheme="dark")
        assert flaws(page) == []


def test_a_diagnosis_in_sentences_with_its_budget(browser: Browser, tmp_path: Path) -> None:
    file = DiagnosisFile.read(written(tmp_path))
    stages = file.document["budget"]["all"]
    with serving(DiagnosisPage(file)) as server, opened(browser, server) as page:
        wait_for(page, "done")
        verdict, size, cause, next_step = sentences(page)
        assert verdict == "The missing effect is known."
        assert (
            size == f"The given model is off by {stages[0]['rms'] / file.document['noise']['rms']:.1f} times the noise."
        )
        assert cause == f"The causes below close {100 * sum(each['share'] for each in stages[1:]):.0f} % of this gap."
        assert next_step.startswith("Next: ")
        rows = page.locator('[data-name="budget"] tbody tr')
        assert rows.count() == len(stages) + len(file.document["effects"]) + 1
        shares = [int(each.split()[0]) for each in rows.locator("td:nth-child(3)").all_inner_texts() if each]
        assert shares[:2] == [round(100 * each["share"]) for each in stages[1:3]]
        assert flaws(page) == []
