"""The code of every page in docs is run, what it is said to print is compared, and every link leads somewhere."""

import re
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


def test_the_command_line_reference_names_every_command_and_only_options_that_it_has() -> None:
    text = (pages.ROOT / "docs/reference/cli.md").read_text()
    sections = dict(re.findall(r"^## ([\w-]+)\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL))
    parsers = make_parser().commands()
    assert set(parsers) == set(sections)
    for command, section in sections.items():
        named = set(re.findall(r"--[a-z-]+", "".join(re.findall(r"^\| `(--[^|]*) \|", section, re.MULTILINE))))
        assert named <= set(re.findall(r"--[a-z-]+", parsers[command].format_help())), command


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


# What `...` may stand for in a printed output: times, secrets, lines that the program leaves out itself, a series, or
# lines of a table beside those shown.
ELLIPSES = re.compile(r"\.\.\. s$|#token=\.\.\.|^\.\.\. \d+ more lines|\+ \.\.\.\)|^\.\.\.$")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_printed_outputs_are_real_numbers(page: Path) -> None:
    blocks = re.findall(r"```(?:text|console)\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    lines = [line.strip() for block in blocks for line in block.splitlines() if "..." in line]
    assert [line for line in lines if not ELLIPSES.search(line)] == []
