"""Every command and every line of Python in the README is run; what is said to be printed is compared.

`reproduce` runs with `--quick`, and `make test` is what runs this.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests import pages

README = pages.ROOT / "README.md"
PICTURE_BYTES = 300_000


def commands() -> list[str]:
    """Return the lines of all shell blocks without their comments."""
    lines = [line for block in pages.blocks(README) if block.language == "sh" for line in block.text.splitlines()]
    return [line.split("  #")[0].strip() for line in lines]


def make(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run make with the environment under test instead of .venv, which need not be there."""
    if not shutil.which("make"):
        pytest.skip("make is not there")
    venv = os.path.relpath(sys.prefix, pages.ROOT)
    installed = [f"--old-file={venv}/{stamp}" for stamp in ("installed", "installed-test")]
    command = ["make", "--no-print-directory", *installed, f"VENV={venv}", *arguments]
    return subprocess.run(
        command,
        cwd=pages.ROOT,
        env=pages.environment(),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )


def test_the_two_commands_are_there() -> None:
    assert [command for command in commands() if command.startswith("make")] == ["make plan", "make test"]


@pytest.mark.slow
def test_make_plan(tmp_path: Path) -> None:
    done = make("plan", f"OUT={tmp_path}")
    assert done.returncode == 0, done.stdout + done.stderr
    assert {file.name for file in tmp_path.iterdir()} == {"four_obstacles.h5", "four_obstacles.png"}
    assert (tmp_path / "four_obstacles.png").stat().st_size < PICTURE_BYTES


@pytest.mark.parametrize(
    ("target", "tools", "marker"),
    [
        ("test", ("cargo fmt", "cargo clippy", "cargo test", "ruff check", "ruff format", "mypy", "lint-imports",
                  "stubtest"), "not slow and not realtime"),
        ("test-slow", ("scripts/processors", "benches/guard"), "slow"),
    ],
)  # fmt: skip
def test_the_two_test_commands_run_everything(target: str, tools: tuple[str, ...], marker: str) -> None:
    done = make("--dry-run", target)
    assert done.returncode == 0, done.stderr
    for tool in tools:
        assert tool in done.stdout
    # All tests with or without the mark: no path and no other option selects fewer.
    lines = [shlex.split(each)[1:] for each in done.stdout.splitlines() if "pytest" in each]
    assert lines[0] == ["-m", "pytest", "-m", marker, "-n", "2", "--dist", "worksteal"]
    assert lines[1:] == ([["-m", "pytest", "-m", "realtime"]] if target == "test-slow" else [])


def test_continuous_integration_runs_the_test_command() -> None:
    assert (pages.ROOT / ".ci" / "run").read_text().splitlines()[-2:] == ["make test", "make test-slow"]


@pytest.mark.slow
def test_the_rest_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "README.md"
    text = re.sub(r"^make .*$", "true", README.read_text(), flags=re.MULTILINE)
    page.write_text(text.replace("needleplan reproduce ch6\n", "needleplan reproduce ch6 --quick\n"))
    pages.run(page, tmp_path)


def test_the_python_is_ten_lines() -> None:
    (code,) = [block.text for block in pages.blocks(README) if block.language == "python"]
    assert len([line for line in code.splitlines() if line]) == 10


def test_the_picture_is_small() -> None:
    (picture,) = re.findall(r"!\[.*\]\((.*)\)", README.read_text())
    assert (pages.ROOT / picture).stat().st_size < PICTURE_BYTES
