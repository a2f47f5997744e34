"""Every command and every line of Python in the README is run; what is said to be printed is compared.

`reproduce` runs with `--quick`, and `make test` is what runs this.
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from statistics import median
from typing import Any

import pytest
from PIL import Image, ImageChops, ImageStat

import moving_picture
from tests import pages

README = pages.ROOT / "README.md"
PICTURE_BYTES = 300_000

# Absolute and relative difference that a number may have from the README: of plans and 10,000 executions; of an
# insertion in the lab, in which another processor's rounding may change single steps.
TOLERANCES = {"python": (0.01, 0.0), "sh": (1.0, 0.25)}


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
                  "stubtest"), "not slow and not study and not realtime"),
        ("test-slow", (), "slow and not study"),
        ("studies", ("scripts/processors", "rustup", "benches/guard", "--test bounds"), "study"),
    ],
)  # fmt: skip
def test_the_test_commands_run_everything(target: str, tools: tuple[str, ...], marker: str) -> None:
    done = make("--dry-run", target)
    assert done.returncode == 0, done.stderr
    for tool in tools:
        assert tool in done.stdout
    # All tests with or without the mark: no other option selects fewer, and the files are all that contain the mark.
    found = [each for each in done.stdout.splitlines() if "pytest" in each and "--collect-only" not in each]
    lines = [shlex.split(each)[1:] for each in found]
    processes = "3" if target == "test-slow" else "2"
    commands = [["-m", "pytest", "-m", marker, "-n", processes, "--dist", "worksteal"]]
    marks = {"test": [""], "test-slow": ["slow", "realtime"], "studies": ["study"]}[target]
    if target == "test-slow":
        commands.append(["-m", "pytest", "-m", "realtime"])
    for line, command, mark in zip(lines, commands, marks, strict=True):
        assert line[: len(command)] == command
        assert {pages.ROOT / name for name in line[len(command) :]} == files_with(mark)


def files_with(mark: str) -> set[Path]:
    """Return the files that contain a mark; all are files of tests, so that no other file marks tests for them."""
    files = {file for file in (pages.ROOT / "tests").rglob("*.py") if mark and f"mark.{mark}" in file.read_text()}
    assert all(file.name.startswith("test_") for file in files)
    return files


@pytest.mark.slow
def test_the_rest_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "README.md"
    text = re.sub(r"^make .*$", "true", README.read_text(), flags=re.MULTILINE)
    page.write_text(text.replace("needleplan reproduce ch6\n", "needleplan reproduce ch6 --quick\n"))
    pages.run(page, tmp_path, TOLERANCES)


def test_the_pictures_are_small_and_one_moves() -> None:
    pictures = re.findall(r"!\[.*\]\((.*)\)", README.read_text())
    assert all((pages.ROOT / picture).stat().st_size < PICTURE_BYTES for picture in pictures)
    with Image.open(pages.ROOT / "docs" / "images" / "steering.gif") as moving:
        assert moving.n_frames > 20  # type: ignore[attr-defined]
    assert [picture for picture in pictures if picture.endswith(".gif")] == ["docs/images/steering.gif"]


@pytest.mark.study
def test_the_moving_picture_is_what_its_script_draws(tmp_path: Path) -> None:
    moving_picture.write(tmp_path / "again.gif")
    with Image.open(tmp_path / "again.gif") as again, Image.open(pages.ROOT / "docs/images/steering.gif") as kept:
        assert (again.size, again.n_frames) == (kept.size, kept.n_frames)  # type: ignore[attr-defined]
        for each in (again, kept):
            each.seek(each.n_frames - 1)  # type: ignore[attr-defined]
        apart = ImageChops.difference(again.convert("L"), kept.convert("L"))
        assert ImageStat.Stat(apart).mean[0] < 2  # of 255 shades; versions of matplotlib draw text differently


def result(name: str) -> Any:
    """Return a result of the benches."""
    return json.loads((pages.ROOT / "benches" / "results" / f"{name}.json").read_text(encoding="utf-8"))


def told(label: str) -> list[float]:
    """Return the numbers in the last cells of the row of a table of the README that begins with a label."""
    (row,) = [line for line in README.read_text(encoding="utf-8").splitlines() if line.startswith(f"| {label}")]
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    return [float(number) for number in re.findall(r"\d+(?:\.\d+)?", " ".join(cells[1:]).replace(",", ""))]


def rounded(value: float) -> float:
    """Return a number with two significant digits."""
    return float(f"{value:.2g}")


def test_the_times_are_those_of_the_bench() -> None:
    found = {each["name"]: each["solves"] for each in result("peers")["results"]}
    peer = min(found["quantecon-mpi"])
    rows = {
        "from the scenario file": ("whole-way", median),
        "solve and policy by directional sweeps": ("lattice-2", median),
        "the same, 1 thread": ("lattice-1", median),
        "our solver for any sparse MDP": ("tabular-2", median),
        "QuantEcon.py, modified policy": ("quantecon-mpi", min),
        "prioritized partitions": ("ppvi-6x4-H1", min),
    }
    for label, (name, summary) in rows.items():
        seconds, ratio = told(label)
        assert seconds == rounded(summary(found[name])), label
        assert ratio == pytest.approx(peer / summary(found[name]), rel=0.02), label  # two digits
    assert min(map(min, (found[name] for name in found if name.startswith("ppvi")))) == min(found["ppvi-6x4-H1"])


def test_the_numbers_of_the_diagnosis_are_those_of_the_bench() -> None:
    text = (pages.ROOT / "benches" / "results" / "diagnosis_evidence.md").read_text(encoding="utf-8")
    for rule, row in (
        (r"Of the (\d+) sets with hidden causes: (\d+) and (\d+)", "forces of a [generator by another hand]"),
        (r"of the (\d+) in which no effect is missing: (\d+) and (\d+)", "the same, {} data sets"),
    ):
        counted = re.search(rule, text)
        assert counted is not None
        sets, rightly, wrongly = map(int, counted.groups())
        assert told(row.format(sets)) == [rightly, wrongly]
        assert f" {sets} data sets" in README.read_text(encoding="utf-8")
    gap, error = (result("circle")["total"][key] for key in ("gap", "error_mm"))
    assert told("eight effects hidden") == [
        100,
        round(100 * gap[1] / gap[0], 1),
        round(error[0], 1),
        round(error[1], 1),
    ]


def test_numbers_of_a_page_may_differ_by_the_tolerance() -> None:
    assert pages.agrees("a 1.00 mm", "a 1.01 mm", 0.02, 0.0)
    assert not pages.agrees("a 1.00 mm", "a 1.03 mm", 0.02, 0.0)
    assert pages.agrees("100 steps", "90 steps", 0.0, 0.1)
    assert not pages.agrees("target: 1 mm", "missed: 1 mm", 1.0, 0.5)
    assert not pages.agrees("1 mm", "1 mm, 2 mm", 1.0, 0.5)
    assert pages.agrees("a ... b", "a 7 b")
    assert not pages.agrees("a 6 b", "a 7 b")
    assert pages.agrees("success 95.4 % of 1,200 runs", "success 95.9 % of 1,201 runs")
    assert not pages.agrees("exit code 1", "exit code 2")
    assert pages.agrees("size 9... N\n0.01 s", "size 9.37 N\n0.02 s")
    assert not pages.agrees("lugre2 of 4 trials", "lugre3 of 4 trials")
