"""`plan` and `insert` in 3D."""

import json
from pathlib import Path

import numpy as np
import pytest

from needleplan.cli.table_poses import poses_of
from needleplan.planning import SpaceTable
from tests.anatomy.volumes import TEXT, box, write
from tests.cli.commands import Done, needleplan, refused

pytestmark = pytest.mark.usefixtures("few_executions")


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("box")
    done = needleplan("plan", write(folder, box()), "-o", folder / "table.h5", "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    lattice = found["lattice"]
    assert (lattice["spacing_mm"], lattice["spacing_chosen"], lattice["step_mm"]) == (4.0, False, 8.0)
    assert lattice["loss"]["obstacle_share"] == 0.0
    assert found["status"] == "converged"
    best = found["best_entry"]
    assert 0.8 < best["success_interval"][0] < best["success"] < best["success_interval"][1]
    assert best["table_success"] == pytest.approx(best["success"], abs=0.1)
    assert found["digest"] == SpaceTable.read(folder / "table.h5").digest
    return folder / "table.h5"


@pytest.mark.slow
def test_a_needle_needs_a_thickness_where_obstacles_have_no_margin(tmp_path: Path) -> None:
    unknown = TEXT.replace("diameter_mm = 0.0\n", "")
    done = needleplan("entry", write(tmp_path, box(), unknown))
    assert done.returncode == 2
    assert "needle.diameter_mm: is required where obstacles have no margin" in done.stderr
    for text in (TEXT, unknown.replace("[needle]", "margin_mm = 1.0\n[needle]")):
        done = needleplan("entry", write(tmp_path, box(), text))
        assert done.returncode == 0, done.stderr
        assert "lattice: spacing 4 mm, steps of 8 mm" in done.stdout
        assert "obstacles: 0.0 % of their volume is free on the lattice" in done.stdout


@pytest.mark.slow
def test_a_table_is_executed_from_a_start_in_ras(table: Path) -> None:
    best = json.loads(needleplan("info", table, "--json").stdout)["best_entry"]
    start = ",".join(map(str, (*best["position_mm"], *best["direction"])))
    done = needleplan("evaluate", table, f"--start={start}", "--runs", "400", "--json")
    found = json.loads(done.stdout)
    assert found["start"]["position_mm"] == pytest.approx(best["position_mm"])
    low, high = found["confidence_interval"]
    assert low - 0.05 < best["success"] < high + 0.05
    path = needleplan("path", table, f"--start={start}", "-v")
    assert path.returncode == 0, path.stderr
    assert "outcome      target" in path.stdout
    refused(needleplan("path", table, "--nearest"), "--nearest: needs a table in the plane")
    refused(needleplan("evaluate", table, "--start=1,2,3"), "must be R,A,S,DR,DA,DS")
    refused(needleplan("entry", table, "--edge", "left"), "--edge = left: holds for a table in the plane")


@pytest.mark.slow
@pytest.mark.parametrize("size", ["1e-300", "1e300", "3"])
def test_a_direction_has_any_length(table: Path, size: str) -> None:
    read = SpaceTable.read(table)
    start = read.best_entry().pose
    frame = read.scenario.grid.frame
    place, along = frame.world(start.position_mm), start.tangent @ frame.axes * float(size)
    pose = poses_of(read).start(",".join(map(repr, [*place.tolist(), *along.tolist()])))
    assert np.allclose(pose.tangent, start.tangent)


@pytest.fixture(scope="module")
def inserted(table: Path) -> tuple[Done, Path]:
    """An insertion whose recording and figure stand beside each other."""
    run = table.parent / "run.mcap"
    options = ("--speed", 10, "--rotation-speed-deg", 170, "--figure", run.with_suffix(".png"), "--json")
    return needleplan("insert", table, "--robot", "sim://space?seed=3", *options, "-o", run), run


@pytest.mark.slow
def test_a_seeded_insertion_plans_inserts_and_reports(table: Path, inserted: tuple[Done, Path]) -> None:
    done, run = inserted
    found = json.loads(done.stdout)
    assert found["ending"] in ("target", "missed"), found["cause"]
    assert (done.returncode == 0) == (found["ending"] == "target")
    assert np.hypot(np.linalg.norm(found["space"]["lateral_mm"]), found["space"]["along_mm"]) == pytest.approx(
        found["error_in_space_mm"]
    )
    assert found["true_error_in_space_mm"] == pytest.approx(found["error_in_space_mm"], abs=1)
    tip, frame = found["tip"], SpaceTable.read(table).scenario.grid.frame
    assert np.allclose(frame.local(found["tip_ras_mm"]), [tip["x_mm"], tip["y_mm"], tip["z_mm"]])
    assert run.with_suffix(".png").stat().st_size > 10_000


@pytest.mark.study
def test_plan_insert_identify_and_plan_again(tmp_path: Path) -> None:
    """A needle that bends by 0.6 of the plan: the recorded insertions show it, and the next plan reaches the target."""
    quiet = TEXT.replace("[lattice]", "tip_noise_deg = 0.5\nstraight_steps = false\n[lattice]")
    scene = write(tmp_path, box(), quiet)
    lab = tmp_path / "lab.toml"
    lab.write_text(
        'schema = "needleplan.simulation/1"\n[tissue]\ncurvature_per_mm = 0.02\n[robot]\nservo_hz = 400\n'
        "bandwidth_hz = 10\n[entry]\ndepth_mm = -2.0\n[effects]\ncurvature_error = -0.4\n"
        "heading_noise_rad_sqrt_mm = 0.002\ncoil_offset_mm = 2.0\ntracker_noise_mm = 0.05\n[[move]]\ndwell_s = 1.0\n"
    )
    first, again = tmp_path / "first.h5", tmp_path / "again.h5"
    assert needleplan("plan", scene, "-o", first).returncode == 0
    runs = [tmp_path / f"run{seed}.mcap" for seed in (1, 2)]
    for seed, run in enumerate(runs, start=1):
        needleplan("insert", first, "--robot", f"sim://{lab}?seed={seed}", "--no-replan", "--speed", "10", "-o", run)
    replayed = needleplan("recording", "replay", runs[0], "--table", first)
    assert replayed.returncode == 0, replayed.stderr
    done = needleplan("plan", scene, "--after", runs[0], "--after", runs[1], "-o", again, "--json")
    assert "contains 1" not in done.stderr
    found = json.loads(done.stdout)["curvature"]
    low, high = found["interval"]
    assert low < 0.6 < high
    assert found["ratio"] == pytest.approx(0.6, abs=0.06)
    assert len(found["insertions"]) == 2
    planned, changed = (SpaceTable.read(each).scenario.needle.curvature_radius_mm for each in (first, again))
    assert changed == pytest.approx(planned / found["ratio"])
    reached = needleplan("insert", again, "--robot", f"sim://{lab}?seed=3", "--speed", "10", "--json")
    assert reached.returncode == 0, reached.stderr
    for wrong in (("plan", "four_obstacles", "--after", runs[0]), ("plan", scene, "--after", lab)):
        refused = needleplan(*map(str, wrong))
        assert refused.returncode == 2
        assert "Traceback" not in refused.stderr


@pytest.mark.slow
def test_a_needle_that_bends_as_planned_leaves_no_reason_to_plan_again(
    inserted: tuple[Done, Path], tmp_path: Path
) -> None:
    run = inserted[1]
    done = needleplan("plan", write(tmp_path, box()), "--after", run, "--json")
    low, high = json.loads(done.stdout)["curvature"]["interval"]
    assert low <= 1 <= high
    assert "the interval contains 1" in done.stderr


@pytest.mark.slow
def test_a_run_through_another_anatomy_is_refused(inserted: tuple[Done, Path], tmp_path: Path) -> None:
    other = write(tmp_path, box(), TEXT.replace("spacing_mm = 4.0", "spacing_mm = 2.0"))
    done = needleplan("plan", other, "--after", inserted[1])
    assert done.returncode == 2
    assert "frame.json" in done.stderr


def test_info_shows_a_table_and_notices_damage(table: Path, tmp_path: Path) -> None:
    done = needleplan("info", table, "--json")
    found = json.loads(done.stdout)
    assert done.returncode == 0, done.stderr
    assert found["verified"]
    assert found["digest"] == SpaceTable.read(table).digest
    assert found["table"] == str(table)
    assert "checksums verified" in needleplan("info", table).stdout
    assert "needleplan.anatomy/1" in needleplan("info", table, "--print-scenario").stdout
    data = bytearray(table.read_bytes())
    data[-9] ^= 4
    (tmp_path / "damaged.h5").write_bytes(data)
    assert needleplan("info", tmp_path / "damaged.h5").returncode == 1


def test_options_of_the_plane_are_refused(table: Path) -> None:
    anatomy = table.parent / "anatomy.toml"
    for arguments in (
        ("plan", anatomy, "--push", "1,1,1"),
        ("plan", anatomy, "--edge", "top"),
        ("plan", anatomy, "--edge", "left"),
        ("insert", table, "--scenario", "four_obstacles"),
        ("insert", table, "--start", "0,0,0"),
        ("insert", table, "--start", "0,0,0,0,0,1"),
    ):
        done = needleplan(*map(str, arguments))
        assert done.returncode == 2, arguments
        assert "Traceback" not in done.stderr
        assert arguments[2] in done.stderr


@pytest.mark.parametrize("schema", ["", 'schema = "anatomy"\n'])
@pytest.mark.parametrize("command", ["plan", "entry", "view"])
def test_a_missing_schema_is_one_mistake(tmp_path: Path, command: str, schema: str) -> None:
    file = write(tmp_path, box(), schema + TEXT.split("\n", 1)[1])
    done = needleplan(command, file, *(("--export", tmp_path / "a.html") if command == "view" else ()))
    refused(done, "anatomy.toml: schema", 'must be "needleplan.anatomy/1"')
    assert len(done.stderr.splitlines()) == 1
