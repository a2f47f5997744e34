"""The safety case names its evidence by test: each named test is there; other pages link to the case."""

import ast
import re
from pathlib import Path

from tests import pages

PAGE = pages.ROOT / "docs/reference/safety-case.md"
TEXT = PAGE.read_text(encoding="utf-8")
NAMED = re.findall(r"`([\w/]+)::(test_\w+)`", TEXT)
HAZARDS = re.split(r"^### (?=H\d)", TEXT, flags=re.MULTILINE)[1:]


def functions_in(file: Path) -> set[str]:
    """Return the names of the test functions of a file: pytest collects what is defined in the module itself."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")}


def test_every_named_test_is_there() -> None:
    assert len(set(NAMED)) > 60
    tests = {file: functions_in(pages.test_file(file)) for file in {file for file, _ in NAMED}}
    assert {f"{file}::{name}" for file, name in NAMED if name not in tests[file]} == set()


def test_every_hazard_has_its_sequence_its_harm_evidence_for_each_control_and_a_residual_risk() -> None:
    assert len(HAZARDS) >= 12
    for hazard in HAZARDS:
        title, words = hazard.splitlines()[0], " ".join(hazard.split())
        assert re.search(r"Sequence: .+ Situation: .+ Harm: .+ (minor|serious|critical)", words), title
        assert "Residual:" in hazard, title
        rows = [each.split("|") for each in hazard.split("## How much")[0].splitlines() if each.startswith("| ")][1:]
        assert rows, title
        for row in rows:
            assert re.search(r"`[\w/]+::test_\w+`|benches/results/", row[3]), (title, row[1])
