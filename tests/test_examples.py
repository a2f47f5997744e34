"""The folders that a lab copies: the commands of each README run."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests import pages

EXAMPLES = pages.ROOT / "examples"
FOLDERS = sorted(file.parent for file in EXAMPLES.glob("*/README.md"))


def test_all_folders_are_listed_and_their_links_lead_somewhere() -> None:
    listed = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert [folder.name for folder in FOLDERS if f"]({folder.name})" not in listed] == []
    for folder in FOLDERS:
        assert not pages.broken_links(folder / "README.md")
        assert len((folder / "README.md").read_text(encoding="utf-8").splitlines()) <= 40


@pytest.mark.slow
@pytest.mark.parametrize("name", [folder.name for folder in FOLDERS])
def test_the_commands_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = shutil.copytree(EXAMPLES / name, tmp_path / name)
    monkeypatch.chdir(folder)
    pages.run(folder / "README.md", folder)
