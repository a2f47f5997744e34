"""`view RUN.mcap`: a recorded insertion beside its plan, over time."""

import re
import time
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, Route, expect

import needleplan as npl
from needleplan.control import path_distances_mm
from needleplan.page import Opened
from needleplan.page import Page as PlanePage
from needleplan.recording import EVENT, Recorder, Recording
from tests.browser.browser import opened, wait_for, wait_for_new_picture
from tests.cli.commands import needleplan, refused
from tests.page.served import served

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run(table_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("run") / "run.mcap"
    done = needleplan("insert", table_file, "--speed", "10", "-o", file)
    assert file.exists(), done.stderr
    return file


def output(page: Page) -> str:
    """Return the text beside the slider of time."""
    return page.locator("#replay output").inner_text()


def test_a_recording_is_scrubbed_and_played(browser: Browser, run: Path) -> None:
    recording = Recording.read(run)
    tip = recording.columns("/tip")
    what = Opened.of_recording(recording)
    with served(what.scenario, opened=what) as server, opened(browser, server) as page:
        wait_for(page, "done")
        track = server.ask("/api/recording", {}).told
        assert track["duration_s"] == pytest.approx(recording.duration_s)
        assert len(track["decisions"]) == recording.counts["/decision"]
        assert track["arrays"]["tip"]["shape"] == [len(tip["x_mm"]), 3]
        assert output(page).startswith(f"{recording.duration_s:.1f} s")
        assert "end" in output(page)
        end = page.locator("#plane canvas").screenshot()
        # The planned path ends at the rim of the target; the deviation inside of it is that from its straight end.
        tip_mm = np.stack([tip["x_mm"], tip["y_mm"]], 1)
        assert what.start is not None
        poses = npl.plan(what.scenario).path(what.start).poses[:, :2]
        ahead = (poses[-1] - poses[-2]) / np.linalg.norm(poses[-1] - poses[-2])
        line = np.vstack([poses, poses[-1] + 2 * what.scenario.target.radius_mm * ahead])
        away = path_distances_mm(line, tip_mm[-1:])[0]
        assert f"deviation {away:.2f} mm" in output(page)
        page.locator("#replay input").fill(str(round(recording.duration_s / 2, 1)))
        wait_for_new_picture(page, end)
        decision = [each for each in track["decisions"] if each["time_s"] <= recording.duration_s / 2][-1]
        assert f"success {100 * decision['success']:.1f} %" in output(page)
        page.focus("#replay input")
        page.keyboard.press("Home")
        assert output(page).startswith("0.0 s")
        page.get_by_role("button", name="Play", exact=True).click()
        expect(page.locator("#replay output")).to_have_text(re.compile(r"^(0\.[1-9]|[1-9]\d*\.\d) s"))
        page.get_by_role("button", name="Pause").click()


def test_a_plan_is_done_with_its_recording(browser: Browser, run: Path) -> None:
    """However late the recording comes, a page that calls its plan done shows the recording beside it."""

    def late(route: Route) -> None:
        time.sleep(1)
        route.continue_()

    what = Opened.of_recording(Recording.read(run))
    with served(what.scenario, opened=what) as server:
        context = browser.new_context()
        page = context.new_page()
        page.route("**/api/recording", late)
        page.goto(server.address)
        wait_for(page, "done")
        assert re.fullmatch(r"\d+\.\d s · .*deviation \d+\.\d\d mm.* end: \w+", output(page)), output(page)
        context.close()


def test_the_code_of_a_recording_computes_its_plan(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = PlanePage(Opened.of_recording(Recording.read(run)))
    start = page.start()
    request = {"scenario": start["scenario"], "start": start["start"], "runs": 100}
    exec(page.files.code({**request, "language": "python"}).decode(), {})
    assert "in 100 runs" in capsys.readouterr().out
    assert page.files.code({**request, "language": "command"}).decode().startswith("cat > ")
    page.close()


def test_the_exported_page_replays(browser: Browser, run: Path, tmp_path: Path) -> None:
    done = needleplan("view", run, "--export", tmp_path / "run.html")
    assert done.returncode == 0, done.stderr
    page = browser.new_page()
    page.goto((tmp_path / "run.html").as_uri())
    wait_for(page, "done")
    page.locator("#replay input").fill("1")
    assert output(page).startswith("1.0 s")
    page.close()


def test_other_recordings_are_refused(tmp_path: Path) -> None:
    with Recorder(tmp_path / "run.mcap") as recorder:
        recorder.channel("/event", EVENT).put(recorder.session.monotonic_ns, {"name": "begin", "cause": "operator"})
    refused(needleplan("view", tmp_path / "run.mcap"), "run.mcap", "only recordings of `needleplan insert`")
    refused(needleplan("view", tmp_path / "run.mcap", "--start", "0,0,0"), "--start", "recording")
