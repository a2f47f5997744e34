"""The documentation site: it builds without warnings, has every page, and its links work without a network."""

import json
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure
from PIL import Image
from playwright.sync_api import Browser

import docstrings
import figures
import interface
import links
import notebooks
import stage
import validation
from needleplan.cli.program import make_parser
from tests import pages

SCENES = sorted((pages.ROOT / "docs" / "gallery").rglob("*.py"))
NOTEBOOKS = sorted((pages.ROOT / "docs" / "notebooks").glob("*.ipynb"))


def built(folder: Path, *options: str) -> Path:
    """Build the site. Fails if the build says anything: a warning, or a broken link."""
    command = [sys.executable, str(pages.ROOT / "docs/site/build.py"), *options, str(folder)]
    done = subprocess.run(command, cwd=pages.ROOT, capture_output=True, text=True, timeout=1800, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return folder


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the site, without what scenes and notebooks print."""
    return built(tmp_path_factory.mktemp("site"), "--quick")


@pytest.mark.first
@pytest.mark.study
def test_the_site_builds(site: Path) -> None:
    html = site / "html"
    for page in (pages.ROOT / "docs").glob("*/*.md"):
        assert (html / page.relative_to(pages.ROOT / "docs").with_suffix(".html")).is_file(), page
    table = (html / "interface" / "needleplan.html").read_text(encoding="utf-8")
    assert 'id="needleplan.PolicyTable.lookup_many"' in table
    assert list(links.external_sources(html)) == []


@pytest.mark.study
def test_scenes_and_notebooks_run_and_show_pictures(tmp_path: Path) -> None:
    folder = built(tmp_path / "site")
    html = folder / "html"
    for book in NOTEBOOKS:
        first = notebooks.read(folder / "source" / "notebooks" / book.name).cells[1]
        shown = [output.get("data", {}) for output in first.outputs]
        assert any("image/png" in each or "<img " in each.get("text/html", "") for each in shown), f"{book}: no picture"
    for scene in SCENES:
        page = (html / scene.relative_to(pages.ROOT / "docs").with_suffix(".html")).read_text(encoding="utf-8")
        assert f"sphx_glr_{scene.stem}_001.png" in page, f"{scene} shows no picture"
        with Image.open(html / "_images" / f"sphx_glr_{scene.stem}_001.png") as picture:
            shades = np.asarray(picture.convert("L"))
        edges = (shades[0], shades[-1], shades[:, 0], shades[:, -1])
        assert min(edge.min() for edge in edges) > 200, f"something is cut off at the edge of the picture of {scene}"
    assert list(links.external_sources(html)) == []
    assert len(list((html / "_downloads").rglob("report.html"))) == 1


@pytest.mark.first
@pytest.mark.study
def test_a_table_of_peers_is_sorted_by_a_click(site: Path, browser: Browser) -> None:
    page = browser.new_page()
    page.goto((site / "html" / "validation" / "solvers.html").as_uri())
    table = page.locator("article table").first
    heading = table.get_by_role("button", name="best")
    for order in ("ascending", "descending"):
        heading.click()
        column = table.locator("tbody tr td:nth-child(4)").all_inner_texts()
        values = [float(each) for each in column if each]
        assert len(values) > 10
        assert values == sorted(values, reverse=order == "descending")
        assert table.locator(f'th[aria-sort="{order}"]').inner_text() == "best"
    page.close()


@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_is_kept_without_output_and_its_links_lead_somewhere(file: Path) -> None:
    book = notebooks.read(file)
    nbformat.validate(book)
    code = [each for each in book.cells if each.cell_type == "code"]
    assert all(each.outputs == [] and each.execution_count is None for each in code)
    assert book.cells[0].source.startswith("# ")
    assert book.cells[1].cell_type == "code"
    text = "\n".join(each.source for each in book.cells if each.cell_type == "markdown")
    found = re.findall(r"\]\(([^)#:]+)", text)
    assert found
    assert all((file.parent / link).is_file() for link in found)


def test_figures_that_pyplot_does_not_know_are_saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    saved = []
    monkeypatch.setattr(figures, "figure_rst", lambda files, _folder: saved.extend(files))
    names = {"figure": Figure(), "shown": pyplot.figure(), "number": 1}
    paths = iter([tmp_path / "1.png", tmp_path / "2.png"])
    figures.scrape(None, {"example_globals": names, "image_path_iterator": paths}, {"src_dir": tmp_path})
    pyplot.close("all")
    assert saved == [tmp_path / "1.png"]
    assert saved[0].read_bytes().startswith(b"\x89PNG")


def test_broken_links_are_found(tmp_path: Path) -> None:
    (tmp_path / "one.html").write_text(
        '<p id="here"><a href="two.html#there">1</a><a href="two.html#nowhere">2</a><a href="#here">3</a>'
        '<a href="three.html">4</a><img src="lost.png"><a href="https://example.org/x">5</a>'
    )
    (tmp_path / "two.html").write_text('<p id="there"><script src="https://example.org/x.js"></script>')
    assert links.broken(tmp_path) == [f"one.html: {link}" for link in ("two.html#nowhere", "three.html", "lost.png")]
    assert list(links.external_sources(tmp_path)) == ["two.html: https://example.org/x.js"]


def test_links_to_files_that_are_no_pages_lead_to_the_repository() -> None:
    original = stage.DOCS / "how-to" / "view.md"
    text = "[a](../reference/cli.md#view) [b](../../Makefile) [c](../../benches/results/view.md) [d](https://x.y)"
    text += f" [f]({stage.SOURCES}/docs/reference/table.md#units) ![g]({stage.PICTURES}/docs/images/view.png)"
    assert stage.relinked(f"{text}\n```text\n[e](../../Makefile)\n```\n", original, Path("how-to/view.md")) == (
        f"[a](../reference/cli.md#view) [b]({stage.SOURCES}/Makefile) [c](../results/view.md) [d](https://x.y) "
        "[f](../reference/table.md#units) ![g](../images/view.png)\n"
        "```text\n[e](../../Makefile)\n```\n"
    )


def test_the_commands_of_the_site_have_their_help() -> None:
    text = stage.with_help(stage.COMMANDS.read_text(encoding="utf-8"))
    assert text.count("\n```text\nusage: needleplan ") == len(make_parser().commands())
    assert "--figure FILE" in text.partition("\n## path\n")[2].partition("\n## ")[0]


def test_tables_of_docstrings() -> None:
    lines = ["A |v|, `|x|`.", "", "| a | b |", "|---|---|", "| 1 | 2 |", "after"]
    docstrings.prepare(None, "", "", None, None, lines)
    assert lines == [
        r"A \|v\|, `|x|`.", "", "", ".. list-table::", "   :header-rows: 1", "", "   * - a", "     - b", "   * - 1",
        "     - 2", "", "after",
    ]  # fmt: skip


def test_every_public_name_has_one_place() -> None:
    owners: dict[int, str] = {}
    first = interface.page("needleplan", owners)
    assert ".. autoclass:: needleplan.PolicyTable" in first
    assert "``PolicyTable``: see :py:obj:`needleplan.PolicyTable`." in interface.page("needleplan.planning", owners)


def test_the_results_keep_the_origins_apart() -> None:
    rows = json.loads((validation.RESULTS / "reproduce.json").read_text(encoding="utf-8"))
    assert {row["origin"] for row in rows if row["verdict"] in ("met", "missed")} == {"own goal"}
    assert {row["origin"] for row in rows if row["id"].startswith("ch6/five entries/")} == {"earlier computation"}
    for row in rows:
        assert bool(row["source"]) is (row["origin"] == "thesis"), row["id"]
        assert (row["factor"] is not None) is (row["verdict"] == "same order"), row["id"]
        assert row["published"] is None or row["origin"] == "thesis", row["id"]
        if row["verdict"] == "reproduced" and all(isinstance(row[key], int | float) for key in ("published", "ours")):
            assert row["ours"] == row["published"] or 1 / 1.5 < row["ours"] / row["published"] < 1.5, row["id"]


def test_the_counts_of_the_verdicts_are_those_of_the_rows() -> None:
    rows = json.loads((validation.RESULTS / "reproduce.json").read_text(encoding="utf-8"))
    page = (validation.RESULTS / "reproduce.md").read_text(encoding="utf-8")
    assert page == validation.counts(rows)
    tables = validation.tables_of(page)
    assert len(tables) == len(validation.ORIGINS)
    assert sum(int(table.splitlines()[-1].split("|")[-2]) for table in tables) == len(rows)


def test_tables_of_a_result_file() -> None:
    assert validation.tables_of("a\n\n| x |\n|---|\n| 1 |\n\nb\n\n| y |\n|---|\n") == [
        "| x |\n|---|\n| 1 |",
        "| y |\n|---|",
    ]


def test_the_history_has_the_ratio_of_the_last_run_to_the_first() -> None:
    run = {"date": "2026-01-01T00:00", "commit": "one", "figures": {"solve": 2.0}, "instructions": {"look up": 100}}
    later = {**run, "commit": "two", "figures": {"solve": 1.0, "new": 3.0}, "instructions": {"look up": 110}}
    text = validation.history([run, later])
    assert "| solve | 2 | 1 | 0.50 |" in text
    assert "| new |  | 3 |  |" in text
    assert "| look up | 100 | 110 | 1.10 |" in text
