"""`needleplan insert --table_set` in the simulated lab, and what it refuses."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import needleplan as npl
from needleplan.cli import main
from needleplan.recording import Recording
from needleplan.sweep import Engine, Sweep, SweptParameter, make_table_set
from tests.cli.commands import needleplan
from tests.control.scenes import small_table


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tables") / "table.h5"
    small_table().write(path)
    return path


def stored(folder: Path, scenario: npl.Scenario, *radii_mm: float) -> Path:
    scenario.write(folder / "sweep.toml")
    radii = SweptParameter("needle.curvature_radius_mm", values=radii_mm or (28.0, 33.0, 37.0))
    make_table_set(Sweep(str(folder / "sweep.toml"), [radii]), folder / "store", Engine(workers=0))
    return folder / "store"


@pytest.mark.study
def test_it_follows_a_stored_table_and_then_a_new_one_and_replays(table: Path, tmp_path: Path) -> None:
    scenario = small_table().scenario
    store, run, simulation = stored(tmp_path, scenario), tmp_path / "run.mcap", tmp_path / "lab.toml"
    simulation.write_text(
        'schema = "needleplan.simulation/1"\n[tissue]\ncurvature_per_mm = 0.025\n[robot]\nservo_hz = 400\n'
        "bandwidth_hz = 10\n[effects]\ncoil_offset_mm = 2.0\ntracker_noise_mm = 0.05\n"
        "heading_noise_rad_sqrt_mm = 0.0\ncurvature_error = 0.3\n[[move]]\ndwell_s = 1.0\n"
    )
    options = ["--speed", "10", "--rotation-speed-deg", "573", "--table-set", str(store), "-o", str(run), "--json"]
    done = needleplan("insert", table, "--robot", f"sim://{simulation}?seed=4", *options)
    assert run.exists(), done.stderr
    events = [each.values for each in Recording.read(run).messages(["/event"])]
    swaps = [each for each in events if each["name"] == "table_swapped"]
    assert [each["cause"] for each in swaps[:2]] == ["table set", "replan"]
    decisions = [each.values["table"] for each in Recording.read(run).messages(["/decision"])]
    assert swaps[0]["digest"] in decisions
    again = needleplan("recording", "replay", run, "--table", table, "--table-set", store, "--json")
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout)["same"]
    (tmp_path / "other").mkdir()
    wrong = needleplan(
        "recording",
        "replay",
        run,
        "--table",
        table,
        "--table-set",
        stored(tmp_path / "other", scenario, 29.0),
        "--json",
    )
    assert wrong.returncode == 1
    assert any(each.startswith("it follows the new tables") for each in json.loads(wrong.stdout)["differences"])
    without = needleplan("recording", "replay", run, "--table", table)
    assert without.returncode == 2
    assert "table set: is missing: the insertion used its tables" in without.stderr


@pytest.mark.slow
def test_a_table_set_of_another_task_is_refused(
    table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = small_table().scenario
    moved = replace(scenario, target=replace(scenario.target, center_mm=(50.0, 25.5)))
    store = stored(tmp_path, moved)
    assert main(["insert", str(table), "--robot", "sim://", "--table-set", str(store)]) == 2
    assert "has no table that differs from" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--no-replan"], "must be left out with --no-replan"),
        ([], "no table set"),
    ],
)
def test_what_is_refused_before_anything_moves(
    options: list[str], told: str, table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["insert", str(table), "--robot", "sim://", "--table-set", str(tmp_path / "none"), *options]) == 2
    assert told in capsys.readouterr().err
