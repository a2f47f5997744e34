"""A store of tables that many tests copy."""

import shutil
from pathlib import Path

import pytest

from needleplan.sweep import Engine, Sweep, make_table_set
from tests.sweep.sweeps import write_sweep


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a whole store, of which each test has a copy."""
    folder = tmp_path_factory.mktemp("made")
    make_table_set(Sweep.read(write_sweep(folder)), folder / "store", Engine(workers=0))
    return folder / "store"


@pytest.fixture
def sweep(tmp_path: Path) -> Sweep:
    return Sweep.read(write_sweep(tmp_path))


@pytest.fixture
def store(tmp_path: Path, made: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "store"))
