"""The safety case names its evidence by test: each test is collected by pytest; other pages link to the case."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from tests import pages

PAGE = pages.ROOT / "docs/explanation/safety-case.md"
TEXT = PAGE.read_text(encoding="utf-8")
FILES = dict(re.findall(r"^\| `(\w+)` \| `(tests/[\w/]+\.py)`", TEXT, re.MULTILINE))
NAMED = re.findall(r"`(\w+)::(test_\w+)`", TEXT)
HAZARDS = re.split(r"^### (?=H\d)", TEXT, flags=re.MULTILINE)[1:]


@pytest.fixture(scope="module")
def collected() -> set[tuple[str, str]]:
    """File and name, without parameters, of every test that pytest collects in the named files."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-p", "no:cacheprovider", *FILES.values()]
    done = subprocess.run(command, cwd=pages.ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return {(file, name) for file, name in re.findall(r"^(tests/[\w/]+\.py)::(\w+)", done.stdout, re.MULTILINE)}


def test_every_named_test_is_collected(collected: set[tuple[str, str]]) -> None:
    assert len(set(NAMED)) > 60
    missing = {f"{short}::{name}" for short, name in NAMED if (FILES.get(short), name) not in collected}
    assert missing == set()


def test_every_short_name_is_used() -> None:
    assert {short for short, _ in NAMED} == set(FILES)


def test_every_hazard_has_its_sequence_its_harm_evidence_for_each_control_and_a_residual_risk() -> None:
    assert len(HAZARDS) >= 12
    for hazard in HAZARDS:
        title, words = hazard.splitlines()[0], " ".join(hazard.split())
        assert re.search(r"Sequence: .+ Situation: .+ Harm: .+ (minor|serious|critical)", words), title
        assert "Residual:" in hazard, title
        rows = [each.split("|") for each in hazard.split("## How much")[0].splitlines() if each.startswith("| ")][1:]
        assert rows, title
        for row in rows:
            assert re.search(r"`\w+::test_\w+`|benches/results/", row[3]), (title, row[1])


def test_every_source_is_cited() -> None:
    compared = TEXT.split("## Beside dVRK")[1]
    assert set(re.findall(r"\[(\d)\]", compared)) == set(re.findall(r"^(\d)\. ", compared, re.MULTILINE))


@pytest.mark.parametrize("page", ["README.md", "docs/reference/safety.md", "docs/reference/faults.md"])
def test_it_is_linked(page: str) -> None:
    assert "safety-case.md" in (pages.ROOT / page).read_text(encoding="utf-8")
