"""The sdist builds in a clean environment, and the wheel of it plans in another one, without any extra."""

import os
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tests import pages

pytestmark = pytest.mark.study

# Time in s for compiling the solver on a busy machine.
TIMEOUT_S = 1500

# Largest size of a new environment in MB, with needleplan and its libraries, without compiled files.
MOST_MB = 150

# Files of the packages that are no part of a wheel: the module that is compiled anew.
NOT_SHIPPED = (".so", ".pyc")


def run(*command: object, folder: Path, **environment: str) -> str:
    """Run a command in an environment that knows nothing of this repository, and return what it prints."""
    kept = {name: os.environ[name] for name in ("PATH", "HOME", "CARGO_HOME", "RUSTUP_HOME") if name in os.environ}
    done = subprocess.run(
        [str(each) for each in command], cwd=folder, env=kept | {"PIP_DISABLE_PIP_VERSION_CHECK": "1"} | environment,
        capture_output=True, text=True, timeout=TIMEOUT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def environment(folder: Path, *packages: object) -> Path:
    """Make a virtual environment with packages and return the folder of its programs."""
    run(sys.executable, "-m", "venv", "--without-pip", folder, folder=folder.parent)
    pip = (sys.executable, "-m", "pip", "--python", folder / "bin" / "python")
    run(*pip, "install", "--quiet", "--no-compile", *packages, folder=folder.parent)
    return folder / "bin"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("packaging")
    maturin = Path(sys.executable).parent / "maturin"
    if not maturin.exists():
        if os.environ.get("CI") == "true":
            pytest.fail("maturin is missing")
        pytest.skip("maturin is not installed")
    run(maturin, "sdist", "--out", folder, folder=pages.ROOT)
    (source,) = folder.glob("needleplan-*.tar.gz")
    with tarfile.open(source) as archive:
        assert not [name for name in archive.getnames() if name.endswith(".so")]
    # The sdist has all files of its crates; their dependencies are compiled already. Cargo would take a file that is
    # older than its last build as unchanged.
    with tarfile.open(source) as archive:
        archive.extractall(folder / "sdist", filter="data")
    for file in (folder / "sdist").rglob("*.rs"):
        file.touch()
    (manifest,) = (folder / "sdist").glob("*/rust/needleplan-py/Cargo.toml")
    # What PyO3 was compiled for is not compiled again.
    kept = {"CARGO_TARGET_DIR": str(pages.ROOT / "target"), "PYO3_PYTHON": sys.executable}
    run("cargo", "check", "--quiet", "--manifest-path", manifest, folder=folder, **kept)
    words = ("--release", "--locked", "--interpreter", sys.executable, "--out", folder)
    run(maturin, "build", *words, folder=pages.ROOT, **kept)
    (built,) = folder.glob("needleplan-*.whl")
    return built


def test_the_wheel_has_every_file_of_the_packages(wheel: Path) -> None:
    assert "-abi3-" in wheel.name
    with zipfile.ZipFile(wheel) as archive:
        names = {*archive.namelist()}
    root = pages.ROOT / "python"
    shipped = {
        str(path.relative_to(root))
        for package in ("needleplan", "needleplan_thesis")
        for path in (root / package).rglob("*")
        if path.is_file() and not path.name.endswith(NOT_SHIPPED)
    }
    assert not shipped - names
    assert {"needleplan/py.typed", "needleplan/_ppvi.pyi", "needleplan/_ppvi.abi3.so"} <= names
    assert not [name for name in names if "test" in name.split("/")[0]]


def test_the_wheel_plans_without_an_extra(wheel: Path, tmp_path: Path) -> None:
    tools = environment(tmp_path / "new", wheel)
    for words in (
        ("plan", "four_obstacles", "-o", "table.h5"), ("info", "table.h5"), ("path", "table.h5", "--start", "0,30,15"),
        ("view", "table.h5", "--export", "plan.html"),
    ):  # fmt: skip
        run(tools / "needleplan", *words, folder=tmp_path)
    assert "Four obstacles" in (tmp_path / "plan.html").read_text(encoding="utf-8")
    size = sum(
        path.stat().st_size for path in (tmp_path / "new").rglob("*") if path.is_file() and not path.is_symlink()
    )
    assert size < MOST_MB * 1e6
