"""`view RUN.mcap` of a 3D insertion: the path over time in slices and in 3D, force, decisions."""

import re
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Browser, Page, expect

from needleplan.anatomy import Anatomy
from needleplan.control import Insertion, InsertionReport, RunRecorder, RunSetup
from needleplan.devices import VirtualClock
from needleplan.errors import DataError
from needleplan.estimation.tip import TipSettings
from needleplan.page import SpacePage, SpaceRun
from needleplan.planning import SpaceTable
from needleplan.recording import Recording
from tests.anatomy.volumes import box, write
from tests.browser.browser import SCHEMES, STALL, TABLET, flaws, opened, told, wait_for
from tests.cli.commands import needleplan, refused
from tests.control.space_scenes import FAST, WIDE, box_table, space_station
from tests.page.served import Served, serving

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("few_executions")]

# Returns the boxes of the texts of elements, which may be wider than the elements themselves.
TEXT_BOXES = """(selector) => [...document.querySelectorAll(selector)].map((element) => {
    const range = document.createRange();
    range.selectNodeContents(element);
    const text = range.getBoundingClientRect();
    const { left, right, top, bottom } = text.width ? text : element.getBoundingClientRect();
    return [element.textContent, left, top, right, bottom];
})"""
Run = tuple[Path, InsertionReport]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A recorded insertion through a box, and its report."""
    folder = tmp_path_factory.mktemp("space")
    table = box_table()
    station = space_station(table)
    options = replace(FAST, torsion=station.torsion)
    settings = TipSettings(heading_sd_rad_sqrt_mm=0.002)
    setup = RunSetup(options, WIDE, station.registration, settings, "a fast lab")
    with (
        RunRecorder(folder / "run.mcap", table, setup, station.clock) as recorder,
        Insertion(
            table, station, options, limits=WIDE, accepted_limits="a fast lab", registration=station.registration,
            tip_settings=settings, listeners=[recorder],
        ) as insertion,
    ):  # fmt: skip
        report = insertion.run()
    return folder / "run.mcap", report


@pytest.fixture(scope="module")
def run_server(run: Run) -> Iterator[Served]:
    table = box_table()
    with serving(
        SpacePage(table.scenario, "run.mcap", None, SpaceRun(Recording.read(run[0]), table=table), table=table)
    ) as server:
        yield server


@pytest.fixture
def replayed(browser: Browser, run_server: Served) -> Iterator[Page]:
    with opened(browser, run_server, allowed=STALL) as page:
        wait_for(page, "done")
        yield page


def output(page: Page) -> str:
    """Return the text beside the slider of time."""
    return page.locator("#replay output").inner_text()


def place(page: Page) -> list[int]:
    """Return the grid point through which the slices go."""
    return [int(page.locator(f'figure[data-across="{axis}"] input').input_value()) for axis in range(3)]


def test_the_numbers_are_those_of_the_report(replayed: Page, run_server: Served, run: Run) -> None:
    report = run[1]
    track = run_server.ask("/api/recording", {}).told
    assert len(track["decisions"]) == len(report.steps)
    assert track["arrays"]["tip"]["shape"] == [len(report.executed_mm), 3]
    assert told(replayed, "ended") == str(report.outcome)
    assert told(replayed, "error").startswith(f"{report.error_in_space_mm:.2f} mm from the centre")
    assert told(replayed, "target") == f"radius of equal volume {box_table().scenario.target_radius_mm:.1f} mm"
    # The page has the positions in single precision, so that a tie is rounded to either side.
    assert float(told(replayed, "largest deviation").removesuffix(" mm")) == pytest.approx(
        report.deviation_mm, abs=0.006
    )
    assert told(replayed, "largest force") == f"{report.largest_force_n:.2f} N"
    assert told(replayed, "turns") == str(report.turns)
    assert told(replayed, "predicted at first") == f"{100 * report.predicted_success:.1f} % by the table"
    assert replayed.locator("#ranked").is_hidden()


def test_the_insertion_is_scrubbed_stepped_and_played(replayed: Page, run: Run) -> None:
    recording, report = Recording.read(run[0]), run[1]
    scene, slice_ = (replayed.locator(each) for each in ("#scene canvas", 'figure[data-across="2"] canvas'))
    end = scene.screenshot(), slice_.screenshot()
    assert output(replayed).endswith(f"error {report.error_in_space_mm:.2f} mm")
    spacing = box_table().scenario.grid.frame.spacing_mm
    assert place(replayed) == np.rint(np.array(report.executed_mm[-1]) / spacing).astype(int).tolist()
    half_s = round(recording.duration_s / 2, 1)
    slider = replayed.get_by_label("Time of the recording")
    slider.fill(str(half_s))
    replayed.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")  # painted
    assert scene.screenshot() != end[0]
    assert slice_.screenshot() != end[1]
    columns = recording.columns("/tip")
    newest = np.searchsorted(columns["time_s"] - recording.start_ns * 1e-9, half_s, side="right") - 1
    tip = np.stack([columns[f"{axis}_mm"] for axis in "xyz"], axis=1)
    # a sample at the time of the slider may be before or after it in the single precision of the page
    shown = [np.rint(each / spacing).astype(int).tolist() for each in tip[newest - 1 : newest + 2]]
    assert place(replayed) in shown
    assert output(replayed).startswith(f"{half_s:.1f} s · force ")
    assert "error" not in output(replayed)
    replayed.get_by_role("button", name="To the decision before").click()
    decisions = [
        ((each.time_ns - recording.start_ns) * 1e-9, each.values) for each in recording.messages(["/decision"])
    ]
    time_s, decision = [each for each in decisions if each[0] < half_s][-1]
    assert output(replayed).startswith(f"{time_s:.1f} s")
    assert f"{decision['action']}, success {100 * decision['success']:.1f} % by the table" in output(replayed)
    replayed.get_by_label("slices follow the tip of an insertion").uncheck()
    before = place(replayed)
    slider.focus()
    replayed.keyboard.press("Home")
    assert output(replayed).startswith("0.0 s")
    assert place(replayed) == before
    replayed.get_by_role("button", name="Play", exact=True).click()
    expect(replayed.locator("#replay output")).to_have_text(re.compile(r"^(0\.[1-9]|[1-9]\d*\.\d) s"))
    replayed.get_by_role("button", name="Pause").click()


@pytest.mark.parametrize("options", [{}, TABLET])
def test_axe_finds_nothing_in_a_replay(browser: Browser, run_server: Served, options: dict[str, Any]) -> None:
    with opened(browser, run_server, allowed=STALL, **options) as page:
        wait_for(page, "done")
        for scheme in SCHEMES:
            page.emulate_media(color_scheme=scheme)
            assert flaws(page) == []
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        box_ = page.get_by_label("Time of the recording").bounding_box()
        assert box_
        assert box_["width"] > 200


def test_a_path_far_from_the_slice_is_one_faint_stroke(replayed: Page) -> None:
    """Short faint strokes would add up to a strong one where they overlap."""
    strokes = replayed.evaluate(
        """async () => {
            const { Slices } = await import("/static/slices.js");
            const strokes = [];
            const context = {
                beginPath: () => {}, moveTo: (x) => strokes.push([x]), lineTo: (x) => strokes.at(-1).push(x),
                stroke() { strokes.at(-1).unshift(this.globalAlpha); },
            };
            const path = new Float32Array([0, 1, 2, 3, 4, 5, 6, 7, 8].flatMap((x) => [x, 0, Math.abs(x - 4) * 2]));
            const slices = Object.assign(Object.create(Slices.prototype), { volume: { spacing_mm: 2 } });
            slices.drawPath(context, path, 2, 0, (point) => [point[0], point[1]], { halo: "white" }, "red");
            return strokes;
        }"""
    )
    once = [[0.3, 0, 1, 2], [1, 2, 3, 4, 5, 6], [0.3, 6, 7, 8]]
    assert strokes == [*once, *once]  # the halo, then the line


def test_no_text_lies_over_another_one(replayed: Page) -> None:
    page = replayed
    for width in (1500, 1280, 1000, 820, 480):
        page.set_viewport_size({"width": width, "height": 900})
        page.evaluate("new Promise(drawn => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert page.locator(".chart-key span").count() == 3
        assert "target: radius of equal volume" in page.locator(".chart-key").first.inner_text()
        for texts in ("#numbers th, #numbers td", "#replay :is(output, button, input, canvas, .chart-key span)"):
            boxes = page.evaluate(TEXT_BOXES, texts)
            assert len(boxes) > 5
            for (name, *one), (other_name, *other) in combinations(boxes, 2):
                across, down = (min(one[2 + axis], other[2 + axis]) - max(one[axis], other[axis]) for axis in (0, 1))
                assert across <= 0.5 or down <= 0.5, (name, other_name)
            assert all(left >= 0 and right <= width for _, left, _, right, _ in boxes)
        slider = page.get_by_label("Time of the recording").bounding_box()
        assert slider
        assert slider["width"] > 150


def test_the_command_finds_the_plan_and_exports(browser: Browser, run: Run, tmp_path: Path) -> None:
    file = Path(shutil.copy(run[0], tmp_path / "run.mcap"))
    refused(needleplan("view", file, "--export", tmp_path / "a.html"), "box.nii.gz is not beside it", "--table")
    anatomy = write(tmp_path, box())
    box_table().write(tmp_path / "table.h5")
    for options in ([], ["--table", anatomy], ["--table", tmp_path / "table.h5"]):
        done = needleplan("view", file, *options, "--export", tmp_path / "run.html", "--force")
        assert done.returncode == 0, done.stderr
    wrong: list[str] = []
    page = browser.new_page()
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on(
        "request", lambda asked: None if asked.url.startswith(("file:", "data:", "blob:")) else wrong.append(asked.url)
    )
    page.goto((tmp_path / "run.html").as_uri())
    wait_for(page, "done")
    assert told(page, "ended") == str(run[1].outcome)
    page.get_by_label("Time of the recording").fill("1")
    assert output(page).startswith("1.0 s")
    page.close()
    assert not wrong


@pytest.mark.study
def test_the_code_of_a_replay_runs(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(run[0], "run.mcap")
    box_table().write("table.h5")
    anatomy = Anatomy.read(write(tmp_path, box()))
    recording, table = Recording.read("run.mcap"), SpaceTable.read("table.h5")
    for given, planned, source in ((None, table, "table.h5"), (anatomy, None, "anatomy.toml")):
        found = SpaceRun(recording, given, source, table=planned)
        page = SpacePage(found.scenario, "run.mcap", found.anatomy, found, table=planned)
        exec(page.code({"language": "python"}).decode(), {})
        report = run[1]
        told_ = f"{report.outcome} {round(report.error_in_space_mm, 2)} {report.turns}\n"
        assert capsys.readouterr().out == told_
        for line in page.code({"language": "command"}).decode().splitlines():
            done = needleplan(*shlex.split(line)[1:], *(["--force"] if " -o " in line else []))
            assert done.returncode == 0, done.stderr
        assert "differences  0" in done.stdout
        page.close()


def test_a_recording_that_breaks_off_is_shown_as_far_as_it_goes(browser: Browser, run: Run, tmp_path: Path) -> None:
    table, tip = box_table(), run[1].tip
    assert tip
    with RunRecorder(tmp_path / "run.mcap", table, RunSetup(), VirtualClock()) as recorder:
        for number in range(3):
            recorder.tip(number * 10**8, -2.0, tip)
    found = SpaceRun(Recording.read(tmp_path / "run.mcap"), table=table)
    with (
        serving(SpacePage(table.scenario, "run.mcap", None, found, table=table)) as server,
        opened(browser, server, allowed=STALL) as page,
    ):
        wait_for(page, "done")
        assert told(page, "ended") == "not in the recording"
        assert told(page, "predicted at first") == told(page, "largest force") == "\N{EN DASH}"
        assert output(page).startswith("0.2 s")
        page.get_by_role("button", name="To the next decision").click()
        page.get_by_role("button", name="To the decision before").click()
        assert output(page).startswith("0.0 s")


def test_another_plan_is_refused(run: Run, table_file: Path, tmp_path: Path) -> None:
    recording = Recording.read(run[0])
    with pytest.raises(DataError, match="is not the plan of this insertion"):
        SpaceRun(recording, table=box_table(straight=False))
    other = write(tmp_path, box(wall=True))
    with pytest.raises(DataError, match="is not the plan of this insertion"):
        SpaceRun(recording, Anatomy.read(other))
    refused(needleplan("view", run[0], "--table", table_file, "--export", tmp_path / "a.html"), "table")
    refused(needleplan("view", "layered", "--table", table_file), "--table", "recordings of 3D insertions")
    refused(needleplan("view", run[0], "--start=0,0,0"), "--start", "which has its own")
