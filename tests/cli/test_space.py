"""`plan` and `insert` in space."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from needleplan.planning import SpaceTable
from tests.anatomy.volumes import box, write
from tests.cli.commands import needleplan

LAX = ("--accept-limits", "a fast lab")


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("box")
    done = needleplan("plan", write(folder, box()), "-o", folder / "table.h5", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["status"] == "converged"
    assert found["best_entry"]["success"] > 0.8
    assert found["digest"] == SpaceTable.read(folder / "table.h5").digest
    return folder / "table.h5"


def test_a_seeded_insertion_plans_inserts_and_reports(table: Path, tmp_path: Path) -> None:
    figure = tmp_path / "run.png"
    speeds = ("--speed", "10", "--rotation-speed-deg", "170")
    robot = ("--robot", "sim://space?seed=3")
    done = needleplan("insert", table, *robot, *speeds, "--figure", figure, "--json")
    found = json.loads(done.stdout)
    assert found["ending"] in ("target", "missed"), found["cause"]
    assert (done.returncode == 0) == (found["ending"] == "target")
    assert np.hypot(np.linalg.norm(found["space"]["lateral_mm"]), found["space"]["along_mm"]) == pytest.approx(
        found["error_in_space_mm"]
    )
    assert found["true_error_in_space_mm"] == pytest.approx(found["error_in_space_mm"], abs=1)
    assert figure.stat().st_size > 10_000


def test_options_of_the_plane_are_refused(table: Path) -> None:
    anatomy = table.parent / "anatomy.toml"
    for arguments in (
        ("plan", anatomy, "--push", "1,1,1"),
        ("plan", anatomy, "--edge", "top"),
        ("insert", table, "--scenario", "four_obstacles"),
        ("insert", table, "--start", "0,0,0"),
        ("insert", table, "--start", "0,0,0,0,0,1"),
    ):
        done = needleplan(*map(str, arguments))
        assert done.returncode == 2, arguments
        assert "Traceback" not in done.stderr
        assert arguments[2] in done.stderr
