"""What the package index and the installation say about the project is complete and true."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from needleplan.recording.rosbag import DEFINITIONS
from tests import pages

ROOT = pages.ROOT
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CARGO = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]
# Every file that `make plan`, `make test`, `make docs` and the tools they call write.
WRITTEN = (
    ".venv/bin/python", ".venv/rust/cargo/bin/cargo", "target/release/lib.rlib", "out/four_obstacles.h5",
    "out/site/index.html",
    "dist/needleplan.whl", "build/lib", ".hypothesis/examples", ".mypy_cache/cache", ".pytest_cache/v",
    ".ruff_cache/content", ".import_linter_cache/data", "python/needleplan/_ppvi.abi3.so",
    "python/needleplan/__pycache__/a.pyc", "tests/__pycache__/a.pyc", "benches/python/__pycache__/a.pyc",
)  # fmt: skip
OF_THE_USER = ("table.h5", "docs/mine.h5")


def git(*arguments: str, folder: Path) -> str:
    return subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, check=True).stdout


def test_every_place_has_the_same_version() -> None:
    version = PROJECT["version"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert CARGO["package"]["version"] == version
    assert {each["version"] for each in CARGO["dependencies"].values() if "path" in each} == {version}
    assert set(re.findall(r"^ *version: (.*)$", citation, re.MULTILINE)) == {version}
    assert f"<version>{version}</version>" in (DEFINITIONS.parent / "package.xml").read_text()


def test_the_description_on_the_package_index_is_the_readme_with_absolute_addresses() -> None:
    done = subprocess.run([ROOT / "scripts" / "description", "--check"], timeout=60, check=False)
    assert done.returncode == 0, "run scripts/description"
    assert PROJECT["readme"] == "python/README.md"
    text = (ROOT / "python" / "README.md").read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)\s]+)\)", text)
    assert all(target.startswith(("https://", "#")) for target in targets)
    linked = re.findall(rf"{re.escape(pages.HOME)}(?:blob|tree)/main/([^)\s#]+)|{re.escape(pages.RAW)}([^)\s#]+)", text)
    assert len(linked) > 10
    assert not [path for pair in linked for path in pair if path and not (ROOT / path).exists()]


def test_make_clean_removes_all_that_was_written_and_nothing_else(tmp_path: Path) -> None:
    if not (shutil.which("make") and shutil.which("git") and (ROOT / ".git").exists()):
        pytest.skip("make, git, or the history is not there")
    folder = tmp_path / "needleplan"
    for name in git("ls-files", folder=ROOT).splitlines():
        if name.startswith(("python/", "tests/", "docs/README")) or "/" not in name:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            if (ROOT / name).is_file():
                shutil.copy(ROOT / name, folder / name)
    tracked = {path for path in folder.rglob("*") if path.is_file()}
    for name in (*WRITTEN, *OF_THE_USER):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    done = subprocess.run(["make", "clean"], cwd=folder, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert {path for path in folder.rglob("*") if path.is_file()} == tracked | {folder / name for name in OF_THE_USER}


def test_what_is_written_is_ignored_by_git() -> None:
    if not (shutil.which("git") and (ROOT / ".git").exists()):
        pytest.skip("git, or the history is not there")
    ignored = git("check-ignore", "--no-index", *WRITTEN, folder=ROOT).splitlines()
    assert {*WRITTEN} - {*ignored} == set()
