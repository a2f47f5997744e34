"""The generator knows nothing of what it is to judge."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

HERE = Path(__file__).parent
FILES = sorted(HERE.glob("*.py"))


def imported(file: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {each.name for each in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{each.name}" for each in node.names}
    return names


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_nothing_that_is_judged_is_imported(file: Path) -> None:
    judged = {name for name in imported(file) if name.startswith("needleplan")}
    if file.name.startswith("test_"):  # the tests may read files as the product does, and no more
        judged = {name for name in judged if not name.startswith("needleplan.recording.")}
    assert not judged
    assert "importlib" not in imported(file)


def test_the_check_sees_imports() -> None:
    seen = imported(HERE / "force.py")
    assert "tests.blind.contact.touch" in seen
    assert "numpy" in seen
