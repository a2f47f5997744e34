"""`needleplan plan`."""

import json
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import needleplan as npl
from needleplan.models.tissue import NeedlePush
from needleplan.scenario import Scenario
from tests.cli.commands import needleplan, refused
from tests.conftest import SMALL


@pytest.fixture
def scenario_file(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path


@pytest.mark.slow
def test_a_scenario_becomes_a_table_and_a_figure(scenario_file: Path, tmp_path: Path) -> None:
    done = needleplan("plan", scenario_file, "-o", "table.h5", "--figure", "plan.png", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("Small\n")
    for word in ("sweep: converged", "best entry", "success", "table.h5", "plan.png"):
        assert word in done.stdout
    assert "180,072 states" in done.stderr
    assert npl.PolicyTable.read(tmp_path / "table.h5").scenario == npl.Scenario.read(scenario_file)
    assert (tmp_path / "plan.png").read_bytes().startswith(b"\x89PNG")
    assert {file.name for file in tmp_path.iterdir()} == {"small.toml", "table.h5", "plan.png"}


def test_a_file_that_appears_during_the_solve_is_not_overwritten(
    scenario_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As with `cp other.h5 table.h5` in another terminal while the solver works."""
    solve = npl.planning.plan

    def slowly(*words: Any, **options: Any) -> npl.PolicyTable:
        (tmp_path / "table.h5").write_bytes(b"another table")
        return solve(*words, **options)

    monkeypatch.setattr(npl.planning, "plan", slowly)
    done = needleplan("plan", scenario_file, "-o", "table.h5", cwd=tmp_path)
    refused(done, "table.h5", "has appeared while the command ran", "the result is in table.")
    assert (tmp_path / "table.h5").read_bytes() == b"another table"
    (kept,) = (each for each in tmp_path.glob("table.*.h5"))
    assert npl.PolicyTable.read(kept).scenario == npl.Scenario.read(scenario_file)
    monkeypatch.undo()
    assert needleplan("plan", scenario_file, "-o", "table.h5", "--force", cwd=tmp_path).returncode == 0
    assert npl.PolicyTable.read(tmp_path / "table.h5").digest == npl.PolicyTable.read(kept).digest


def test_json_holds_what_the_table_holds(scenario_file: Path, tmp_path: Path) -> None:
    done = needleplan("plan", scenario_file, "-o", "table.h5", "--json", cwd=tmp_path)
    answer = json.loads(done.stdout)
    table = npl.PolicyTable.read(tmp_path / "table.h5")
    assert (answer["status"], answer["states"], answer["backups"]) == ("converged", 180_072, table.stats.backups)
    assert (answer["digest"], answer["scenario_digest"]) == (table.digest, table.scenario.digest)
    assert answer["best_entry"]["success"] == pytest.approx(table.best_entry().success)
    assert answer["table"] == "table.h5"


def test_a_shipped_scenario_goes_by_its_name() -> None:
    done = needleplan("plan", "unreachable")
    assert done.returncode == 1
    assert "Unreachable target" in done.stdout
    assert "the target cannot be reached from the left edge" in done.stderr


def test_a_poor_plan_is_said_aloud() -> None:
    done = needleplan("plan", "four_obstacles_thesis")
    assert done.returncode == 0
    assert "warning: even the best entry on the left edge reaches the target in" in done.stderr
    assert "giving up may cost less" in done.stderr


def test_a_target_that_is_pushed_away_gets_a_margin(scenario_file: Path, tmp_path: Path) -> None:
    done = needleplan("plan", scenario_file, "-o", tmp_path / "table.h5", "--push", "0.1,0.02,0.5", "--json")
    shift = NeedlePush(0.02, 0.5).at_tip_mm(0.1)
    assert json.loads(done.stdout)["target_shift_mm"] == pytest.approx(shift)
    assert f"target: pushed away by up to {shift:.2f} mm" in done.stderr
    planned = npl.PolicyTable.read(tmp_path / "table.h5").scenario.target.radius_mm
    assert planned == pytest.approx(Scenario.read(scenario_file).target.radius_mm - shift)
    refused(needleplan("plan", scenario_file, "--push", "5,0.02,0.5"), "--push", "must be less than its radius")
    refused(needleplan("plan", scenario_file, "--push", "5,0.02"), "--push", "F,G,A or F,G,A,S,L: numbers")
    refused(needleplan("plan", scenario_file, "--push", "-1,0.02,0.5,0.1,0"), "--push F = -1", "--push L = 0")
    refused(needleplan("plan", scenario_file, "--push", "0.1,20,0.5"), "--push G = 20", "1 kPa is 0.001 N/mm^2")


def test_the_friction_of_the_shaft_widens_the_margin(scenario_file: Path) -> None:
    done = needleplan("plan", scenario_file, "--push", "0.1,0.02,0.5,0.2,60", "--json")
    shift = NeedlePush(0.02, 0.5).shift_mm(0.1, 0.2, 60.0, ahead_mm=0.0, aside_mm=0.0)
    assert json.loads(done.stdout)["target_shift_mm"] == pytest.approx(shift)
    assert shift > 1.05 * NeedlePush(0.02, 0.5).at_tip_mm(0.1)


def test_success_without_a_proof_is_said_aloud(tmp_path: Path) -> None:
    """A straight step of 0.9 mm along x rounds to no movement on a grid of 2 mm; a discount makes dwelling cheap."""
    lines = (
        'schema = "needleplan.scenario/1"', "workspace = { width_mm = 20, height_mm = 20 }",
        "target = { center_mm = [16, 10], radius_mm = 2 }", "needle = { curvature_radius_mm = 10 }",
        "motion = { headings = 24, step_mm = 0.9, straight_curvature_share = 0, tip_noise = [1.0] }",
        "grid = { spacing_mm = [2, 2], transition = 'nearest' }", "objective = { discount = 0.95 }",
        "solver = { success_bound = true }",
    )  # fmt: skip
    (tmp_path / "dwell.toml").write_text("\n".join(lines))
    done = needleplan("plan", str(tmp_path / "dwell.toml"))
    assert "warning: the success probabilities are not proven: they may be wrong by up to 100.0 %" in done.stderr


def test_an_edge_beyond_the_last_multiple_of_the_spacing(scenario_file: Path, tmp_path: Path) -> None:
    scenario_file.write_text(SMALL.replace("width_mm = 60.0", "width_mm = 60.5"))
    done = needleplan("plan", scenario_file, "-o", "table.h5", "--edge", "right", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "x 60.5 mm" in done.stdout
    done = needleplan("entry", "table.h5", "--edge", "right", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "x 60.5 mm" in done.stdout


def test_an_edge_in_an_obstacle_is_told_after_the_table_is_written(scenario_file: Path, tmp_path: Path) -> None:
    wall = "[[obstacle]]\npolygon_mm = [[-1, -1], [2, -1], [2, 41], [-1, 41]]\n[target]"
    scenario_file.write_text(SMALL.replace("[target]", wall))
    done = needleplan("plan", scenario_file, "-o", "table.h5", cwd=tmp_path)
    refused(done, 'edge = "left": must have a position outside of all obstacles; choose another edge')
    assert npl.PolicyTable.read(tmp_path / "table.h5").stats.status == "converged"


def test_a_solve_cut_short_is_no_success(scenario_file: Path, tmp_path: Path) -> None:
    scenario_file.write_text(f"{SMALL}max_sweeps = 1\n")
    done = needleplan("plan", scenario_file, "-o", "table.h5", cwd=tmp_path)
    assert done.returncode == 1
    assert "not converged: iteration limit" in done.stderr
    assert npl.PolicyTable.read(tmp_path / "table.h5").stats.status.value == "iteration_limit"


def test_mistakes_are_told_without_a_traceback(scenario_file: Path, tmp_path: Path) -> None:
    scenario_file.write_text(
        SMALL.replace("width_mm = 60.0", "width_mm = nan").replace("radius_mm = 2", "radius_mm = -2")
    )
    done = needleplan("plan", scenario_file, "-o", "table.h5", cwd=tmp_path)
    refused(done, "small.toml: 2 mistakes", "workspace.width_mm = nan", "target.radius_mm = -2", "in mm above 0")
    refused(needleplan("plan", "missing.toml"), "missing.toml: no such file")
    scenario_file.write_text(SMALL.replace("[solver]", "[grid]\nspacing_mm = [1e-7, 1e-7]\n[solver]"))
    refused(needleplan("plan", scenario_file), "small.toml: grid.spacing_mm = [1e-07, 1e-07]", "TB of memory")
    assert not (tmp_path / "table.h5").exists()


def test_outputs_that_cannot_be_written_are_told_before_planning(scenario_file: Path, tmp_path: Path) -> None:
    refused(needleplan("plan", scenario_file, "-o", tmp_path / "no" / "table.h5"), "cannot be written: no such folder")
    refused(needleplan("plan", scenario_file, "-o", scenario_file), "must end in .h5")
    key = tmp_path / "key.h5"
    refused(needleplan("plan", scenario_file, "--sign-key", key, "-o", key), "it would replace")
    refused(needleplan("plan", scenario_file, "--figure", tmp_path), "cannot be written: it is a folder")
    refused(needleplan("plan", scenario_file, "--figure", tmp_path / "plan.bmp"), "must end in .png, .pdf, .svg")
    done = needleplan("plan", scenario_file, "-o", "/dev/full")
    refused(done, "/dev/full: cannot be written: No space left on device")


def test_unknown_commands_and_options_are_told() -> None:
    for arguments in (("plam",), ("plan",), ("plan", "four_obstacles", "--tabel", "x")):
        refused(needleplan(*arguments), "usage: needleplan")


def test_a_reader_that_leaves_is_no_error(scenario_file: Path) -> None:
    plan = shlex.join([sys.executable, "-m", "needleplan", "plan", str(scenario_file), "--json"])
    command = f"{plan} | true; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout in ("141\n", "0\n")
    assert "Traceback" not in done.stderr
    assert "Broken" not in done.stderr


def test_a_full_standard_output_is_told(scenario_file: Path) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "needleplan", "plan", str(scenario_file)],
            stdout=full, stderr=subprocess.PIPE, text=True, timeout=120, check=False,
        )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.endswith("needleplan: standard output: cannot be written: No space left on device\n")


def test_an_interrupt_ends_it_cleanly(scenario_file: Path, tmp_path: Path) -> None:
    scenario_file.write_text(
        SMALL.replace("tolerance = 1e-3", 'tolerance = 1e-9\nmethod = "vi"').replace(
            "[solver]", "[grid]\nspacing_mm = [0.1, 0.1]\n[solver]"
        )
    )
    process = subprocess.Popen(
        [sys.executable, "-m", "needleplan", "plan", str(scenario_file), "-o", str(tmp_path / "table.h5")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        # A background job of a shell ignores interrupts, and so would its children.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert process.stderr is not None
    first_line = process.stderr.readline()
    os.kill(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=60)
    assert "states" in first_line
    assert process.returncode == 130
    assert output == ""
    assert errors.splitlines()[-1] == "needleplan: interrupted"
    assert "Traceback" not in errors
    assert not (tmp_path / "table.h5").exists()
