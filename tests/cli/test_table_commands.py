"""The commands that read a table."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

import needleplan as npl
from tests.cli.commands import needleplan, refused
from tests.conftest import SMALL


def test_path(table: npl.PolicyTable, table_file: Path, tmp_path: Path) -> None:
    done = needleplan("path", table_file, "--start", "0,25,0", "--json", "--figure", tmp_path / "path.svg")
    answer = json.loads(done.stdout)
    path = table.path((0, 25, 0))
    assert done.returncode == (0 if answer["outcome"] == "target" else 1)
    assert answer["poses"] == pytest.approx(path.poses)
    assert answer["length_mm"] == pytest.approx(path.length_mm)
    assert len(answer["turns"]) == len(path.turns)
    assert "<svg" in (tmp_path / "path.svg").read_text()


@pytest.mark.parametrize(
    ("kept", "noise_deg", "start", "helps"),
    [
        ("heading_refinement", 1.0, "0,35,40", "motion.headings"),
        ("success_refinement", 6.0, "0,17,-10", "grid.success_refinement"),
    ],
)
def test_a_prediction_outside_of_the_interval_says_what_helps(
    kept: str, noise_deg: float, start: str, helps: str, tmp_path: Path
) -> None:
    scenario = npl.Scenario.read("four_obstacles")
    noise = replace(scenario.motion, tip_noise_step_deg=noise_deg)
    # The rule of this refinement would resolve the noise, or the steps.
    coarse = replace(scenario.grid, spacing_mm=(4.0, 4.0), **{kept: 1})
    npl.plan(replace(scenario, grid=coarse, motion=noise)).write(tmp_path / "table.h5")
    done = needleplan("evaluate", tmp_path / "table.h5", "--start", start)
    assert helps in done.stderr


def test_path_from_the_best_entry(table_file: Path) -> None:
    done = needleplan("path", table_file)
    assert done.returncode == 0
    assert "outcome      target" in done.stdout


def test_a_path_that_fails_says_no(table_file: Path) -> None:
    done = needleplan("path", table_file, "--start", "19,10,0,1")
    assert done.returncode == 1
    assert "the path does not reach the target: collision" in done.stderr


def test_evaluate(table: npl.PolicyTable, table_file: Path) -> None:
    done = needleplan("evaluate", table_file, "--start", "0,30,-10,1", "--runs", "500", "--seed", "7", "--json")
    answer = json.loads(done.stdout)
    found = table.rollout((0, 30, math.radians(-10), 1), 500, 7)
    assert (answer["success"], answer["predicted_success"]) == (found.success, found.predicted_success)
    assert answer["confidence_interval"] == pytest.approx(found.interval)
    assert sum(answer["outcomes"].values()) == 500
    nearest = needleplan("evaluate", table_file, "--runs", "500", "--nearest")
    assert nearest.returncode == 0
    assert "of 500 runs, 95 % interval" in nearest.stdout
    assert "predicted" in nearest.stdout


def test_no_success_at_all_says_no(table_file: Path) -> None:
    done = needleplan("evaluate", table_file, "--start", "19.9,10,0,1", "--runs", "10")
    assert done.returncode == 1
    assert "no run reached the target" in done.stderr


def test_entry(table: npl.PolicyTable, table_file: Path) -> None:
    answer = json.loads(needleplan("entry", table_file, "--edge", "top", "--at", "30", "--json").stdout)
    best = table.best_entry("top", x_mm=30)
    assert (answer["x_mm"], answer["y_mm"], answer["bevel"]) == (30, 40, best.pose.bevel)
    assert answer["heading_deg"] == pytest.approx(math.degrees(best.pose.heading_rad))
    assert answer["success"] == pytest.approx(best.success)
    assert "best entry" in needleplan("entry", table_file).stdout


def test_info(table: npl.PolicyTable, table_file: Path) -> None:
    done = needleplan("info", table_file)
    assert done.returncode == 0
    assert "checksums verified" in done.stdout
    assert table.digest in done.stdout
    answer = json.loads(needleplan("info", table_file, "--json").stdout)
    assert answer["verified"] is True
    assert answer["states"] == table.stats.states
    assert needleplan("info", table_file, "--print-scenario").stdout == table.scenario.to_toml()


def test_a_wrong_checksum(table_file: Path, tmp_path: Path) -> None:
    data = bytearray(table_file.read_bytes())
    data[len(data) // 2] ^= 1
    path = tmp_path / "altered.h5"
    path.write_bytes(data)
    done = needleplan("info", path, "--json")
    assert done.returncode == 1
    assert json.loads(done.stdout)["verified"] is False
    assert "has been altered since it was written" in done.stderr
    for command in ("path", "evaluate", "entry"):
        refused(needleplan(command, path), "altered.h5: has been altered since it was written")


def test_files_that_are_no_tables(table_file: Path, tmp_path: Path) -> None:
    short = tmp_path / "short.h5"
    short.write_bytes(table_file.read_bytes()[:10_000])
    refused(needleplan("info", short), "short.h5: is truncated: 9,488 of")
    refused(needleplan("entry", __file__), "is not a policy table")
    refused(needleplan("info", tmp_path / "missing.h5"), "cannot be read: No such file or directory")


@pytest.mark.parametrize("start", ["0,25", "a,b,c", "0,25,0,1,2", "nan,25,0", "0,25,0,3", "0,99,0", "1e9,2,0,1", ""])
def test_starts_that_are_no_poses(table_file: Path, start: str) -> None:
    refused(needleplan("path", table_file, f"--start={start}"), "needleplan: ")


def test_a_heading_beyond_a_full_turn_is_refused_in_degrees(table_file: Path) -> None:
    refused(needleplan("path", table_file, "--start=0,25,15,2"), "numbers with commas between them, BEVEL -1 or 1")
    rule = "--start = 0,25,375: its heading must lie between -360 and 360 degrees"
    refused(needleplan("path", table_file, "--start=0,25,375"), rule)


def test_numbers_that_cannot_be(table_file: Path) -> None:
    refused(needleplan("evaluate", table_file, "--runs", "0"), "runs = 0: must be a whole number from 1")
    refused(needleplan("evaluate", table_file, "--seed", "-1"), "seed = -1: must be a whole number")
    refused(
        needleplan("evaluate", table_file, "--runs", "many"),
        "argument --runs: must be a whole number such as 500 or 1e4, of at most 18 digits, not",
    )
    refused(needleplan("entry", table_file, "--at", "99"), "y_mm = 99.0: must lie in the workspace")


def test_a_figure_that_cannot_be_drawn_is_refused_before_the_work(table_file: Path, tmp_path: Path) -> None:
    refused(needleplan("path", table_file, "--figure", tmp_path / "path.bmp"), "must end in .png, .pdf, .svg")
    done = needleplan("plan", "four_obstacles", "-o", tmp_path / "t.h5", "--figure", tmp_path / "plan.bmp")
    refused(done, "must end in .png, .pdf, .svg")
    assert list(tmp_path.iterdir()) == []


def test_a_table_is_signed_and_verified(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL)
    (tmp_path / "lab.key").write_text("4f1d2c3b4a59687796a5b4c3d2e1f001\n")
    (tmp_path / "other.key").write_text("another secret of a laboratory\n")
    (tmp_path / "short.key").write_text("secret\n")
    done = needleplan("plan", "small.toml", "-o", "table.h5", "--sign-key", "lab.key", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "signature not verified" in needleplan("info", "table.h5", cwd=tmp_path).stdout
    assert "signature verified" in needleplan("info", "table.h5", "--verify-key", "lab.key", cwd=tmp_path).stdout
    assert needleplan("path", "table.h5", "--verify-key", "lab.key", cwd=tmp_path).returncode == 0
    for command in (("path", "table.h5"), ("entry", "table.h5"), ("evaluate", "table.h5"), ("insert", "table.h5")):
        refused(needleplan(*command, "--verify-key", "other.key", cwd=tmp_path), "is signed with another key")
    done = needleplan("info", "table.h5", "--verify-key", "other.key", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    refused(needleplan("path", "table.h5", "--verify-key", "short.key", cwd=tmp_path), "short.key: key = 6 bytes")
    refused(needleplan("path", "table.h5", "--verify-key", "no.key", cwd=tmp_path), "no.key: cannot be read")
    refused(needleplan("plan", "small.toml", "--sign-key", "lab.key", cwd=tmp_path), "requires --output")
