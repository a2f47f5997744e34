"""The code of every page in docs is run, what it is said to print is compared, and every link leads somewhere."""

from __future__ import annotations

import re
import subprocess
from dataclasses import MISSING, Field, fields
from pathlib import Path
from typing import Any

import pytest

from needleplan import scenario
from needleplan.cli.program import make_parser
from needleplan.config import REQUIRED
from tests import pages

PAGES = sorted((pages.ROOT / "docs").rglob("*.md"))
OTHER_PAGES = [pages.ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "rust/ppvi/README.md")]
CLASSES = {"motion": scenario.TipMotion}
PARTS = ("workspace", "obstacle", "target", "needle", "layer", "tissue", "motion", "grid", "objective", "solver")


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_code_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    pages.run(page, tmp_path)


@pytest.mark.parametrize("page", [*PAGES, *OTHER_PAGES], ids=lambda page: str(page.relative_to(pages.ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    assert not pages.broken_links(page)


@pytest.mark.parametrize("part", PARTS)
def test_the_scenario_reference_has_every_key_and_default(part: str) -> None:
    text = (pages.ROOT / "docs/reference/scenario.md").read_text()
    sections = re.split(r"^## ", text, flags=re.MULTILINE)
    (section,) = [each for each in sections if each.startswith((f"[{part}]", f"[[{part}]]", f"[[needle.{part}]]"))]
    told: dict[str, str] = {}
    for row in section.splitlines():
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        for key in re.findall(r"`(\w+)`", cells[0]) if row.startswith("| `") else ():
            told[key] = cells[2].strip("`")
    assert told == {
        each.name: default(each)
        for each in fields(CLASSES.get(part) or getattr(scenario, part.capitalize()))
        if each.name != "layers"
    }


@pytest.mark.slow
def test_the_command_line_reference_has_every_option() -> None:
    text = (pages.ROOT / "docs/reference/cli.md").read_text()
    groups = dict(re.findall(r"^\| `(\[[A-Z]+\])` \| ([^|]*) \|", text.partition("\n## ")[0], re.MULTILINE))
    assert groups
    sections = dict(re.findall(r"^## ([\w-]+)\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL))
    assert set(make_parser().commands()) == set(sections)
    for command, section in sections.items():
        synopsis = section.split("`")[1]
        for group, members in groups.items():
            synopsis = synopsis.replace(group, members)
        usage = shown(command, "--help").partition("\nexamples:")[0]
        options = set(re.findall(r"--[a-z-]+", usage)) - {"--help"}
        assert options == set(re.findall(r"--[a-z-]+", synopsis)) | options & {"--output"}, command


def shown(*arguments: str) -> str:
    """Return what the program prints."""
    environment = {**pages.environment(), "COLUMNS": "200"}
    return subprocess.run(
        ["needleplan", *arguments], env=environment, capture_output=True, text=True, check=True, timeout=60
    ).stdout


def default(field: Field[Any]) -> str:
    """Return the default of a key as the reference tells it."""
    if field.default is MISSING or field.default is REQUIRED:
        return "required"
    if field.default is None:
        return "none"
    if isinstance(field.default, bool):
        return str(field.default).lower()
    if isinstance(field.default, tuple):
        return str(list(field.default))
    return f'"{field.default}"' if isinstance(field.default, str) else str(field.default)


def test_the_index_lists_every_page() -> None:
    index = (pages.ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"\]\(([a-z-]+/[a-z-]+\.md)\)", index))
    there = {str(each.relative_to(pages.ROOT / "docs")) for each in (pages.ROOT / "docs").glob("*/*.md")}
    assert listed == there


@pytest.mark.parametrize("page", [page for page in PAGES if page.parent.name == "how-to"], ids=lambda page: page.stem)
def test_a_how_to_page_does_one_job(page: Path) -> None:
    assert len(page.read_text(encoding="utf-8").split()) <= 900


def test_the_readme_is_short() -> None:
    assert len((pages.ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120
