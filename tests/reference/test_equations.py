"""Display equations of the explanations have numbers, and the code cites numbers that are there."""

import re
from pathlib import Path

import pytest

from tests.pages import ROOT

PAGES = sorted((ROOT / "docs" / "explanation").glob("*.md"))
_CODE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
_CITATION = re.compile(r"[Ee]quations? \((\d+)\)(?: (?:and|to)\s+\((\d+)\))? of\s+docs/explanation/([\w-]+\.md)")


def numbers(page: Path) -> list[int]:
    """Return the numbers at the ends of lines of a page, in their order."""
    return [int(number) for number in re.findall(r" {4}\((\d+)\)$", page.read_text(encoding="utf-8"), re.MULTILINE)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_display_equations_are_numbered_in_their_order(page: Path) -> None:
    assert numbers(page) == list(range(1, len(numbers(page)) + 1))
    text = _CODE.sub("", page.read_text(encoding="utf-8"))
    unnumbered = [line for line in text.splitlines() if re.match(r" {4}\S.* =[^=]", line)]
    assert [line for line in unnumbered if not re.search(r" {4}\(\d+\)$", line) and line.lstrip()[0] not in "-|"] == []


def test_the_code_cites_equations_that_are_there() -> None:
    cited = []
    for file in sorted((ROOT / "python").rglob("*.py")):
        for first, last, name in _CITATION.findall(file.read_text(encoding="utf-8")):
            cited.append(name)
            there = numbers(ROOT / "docs" / "explanation" / name)
            assert {int(first), int(last or first)} <= set(there), f"{file}: {name} has the equations {there}"
    assert len(set(cited)) >= 7
