"""The documentation site: it builds without warnings, has every page, and its links work without a network."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import pytest
from matplotlib import pyplot
from matplotlib.figure import Figure

import docstrings
import figures
import interface
import links
import notebooks
import stage
from contents import sections
from tests import pages

SCENES = sorted((pages.ROOT / "docs" / "gallery").rglob("*.py"))
NOTEBOOKS = sorted((pages.ROOT / "docs" / "notebooks").glob("*.ipynb"))


@pytest.mark.slow
def test_the_site_builds(tmp_path: Path) -> None:
    command = [sys.executable, str(pages.ROOT / "docs/site/build.py"), str(tmp_path)]
    done = subprocess.run(command, cwd=pages.ROOT, capture_output=True, text=True, timeout=900, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    built = tmp_path / "html"
    for page in (pages.ROOT / "docs").glob("*/*.md"):
        assert (built / page.relative_to(pages.ROOT / "docs").with_suffix(".html")).is_file(), page
    for book in NOTEBOOKS:
        first = notebooks.read(tmp_path / "source" / "notebooks" / book.name).cells[1]
        shown = [output.get("data", {}) for output in first.outputs]
        assert any("image/png" in each or "<img " in each.get("text/html", "") for each in shown), f"{book}: no picture"
    for scene in SCENES:
        page = (built / scene.relative_to(pages.ROOT / "docs").with_suffix(".html")).read_text(encoding="utf-8")
        assert f"sphx_glr_{scene.stem}_001.png" in page, f"{scene} shows no picture"
    table = (built / "interface" / "needleplan.html").read_text(encoding="utf-8")
    assert 'id="needleplan.PolicyTable.lookup_many"' in table
    assert list(links.external_sources(built)) == []


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


def test_there_are_five_notebooks() -> None:
    assert len(NOTEBOOKS) >= 5


def test_the_gallery_has_scenes_with_a_title_and_a_text() -> None:
    assert len(SCENES) >= 20
    assert len({scene.name for scene in SCENES}) == len(SCENES)
    for scene in SCENES:
        title, rule, gap, *text = str(ast.get_docstring(ast.parse(scene.read_text(encoding="utf-8")))).splitlines()
        assert (rule, gap, bool(text)) == ("=" * len(title), "", True), scene


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
    assert stage.relinked(f"{text}\n```text\n[e](../../Makefile)\n```\n", original, Path("how-to/view.md")) == (
        f"[a](../reference/cli.md#view) [b]({stage.SOURCES}/Makefile) [c](../results/view.md) [d](https://x.y)\n"
        "```text\n[e](../../Makefile)\n```\n"
    )


def test_tables_of_docstrings() -> None:
    lines = ["A |v|, `|x|`.", "", "| a | b |", "|---|---|", "| 1 | 2 |", "after"]
    docstrings.prepare(None, "", "", None, None, lines)
    assert lines == [
        r"A \|v\|, `|x|`.", "", "", ".. list-table::", "   :header-rows: 1", "", "   * - a", "     - b", "   * - 1",
        "     - 2", "", "after",
    ]  # fmt: skip


def test_the_sections_of_the_list_of_pages() -> None:
    found = sections((pages.ROOT / "docs" / "README.md").read_text(encoding="utf-8"))
    assert [each.folder for each in found] == ["tutorials", "notebooks", *stage.SECTIONS[1:]]
    assert "](../how-to/install.md)" in found[0].text
    assert sum(len(each.pages) for each in found) == len([*(pages.ROOT / "docs").glob("*/*.md"), *NOTEBOOKS])


def test_every_public_name_has_one_place() -> None:
    owners: dict[int, str] = {}
    first = interface.page("needleplan", owners)
    assert ".. autoclass:: needleplan.PolicyTable" in first
    assert "``PolicyTable``: see :py:obj:`needleplan.PolicyTable`." in interface.page("needleplan.planning", owners)
