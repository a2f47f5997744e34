"""From recorded insertions by a 3D table to the effect that the plan lacks, and to the next plan."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from needleplan.anatomy import Anatomy, SpaceScenario
from needleplan.control import recorded_insertion
from needleplan.diagnosis import Library
from needleplan.diagnosis.catalogue import base_of
from needleplan.identification.insertion_path import insertion_path
from needleplan.models import simulate
from needleplan.models.effects import effect_named
from needleplan.reports.diagnosis import folder
from needleplan.reports.diagnosis.diagnosed_anatomy import planned_path_model
from tests.anatomy.volumes import TEXT, box, write
from tests.cli.commands import needleplan

BEND_PER_MM = 0.006
RADIUS_MM = 60.0
ROBOT = "[robot]\nservo_hz = 200\nbandwidth_hz = 10.0\n"
TWIN = """schema = "needleplan.simulation/1"
[entry]
depth_mm = -2.0
[tissue]
curvature_per_mm = 0.01
{robot}
[effects]
heading_noise_rad_sqrt_mm = {noise}
pre_bend_per_mm = {bend}
tracker_noise_mm = {tracker}
coil_offset_mm = {coil}
[[move]]
dwell_s = 15.0
"""


def twin(place: Path, name: str, **values: float) -> Path:
    file = place / f"{name}.toml"
    file.write_text(TWIN.format(robot=ROBOT, **({"noise": 0.0005, "bend": 0.0, "tracker": 0.1, "coil": 3.0} | values)))
    return file


def insert(place: Path, table: Path, lab: Path, name: str, speed_mm_s: float = 20.0) -> Path:
    run, limits = place / f"{name}.mcap", place / "limits.toml"
    limits.write_text("[safety]\ninsertion_velocity_mm_s = 25.0\n")
    fast = ("--speed", speed_mm_s, "--rotation-speed-deg", 570, "--limits", limits, "--accept-limits", "a fast lab")
    done = needleplan("insert", table, "--robot", f"sim://{lab}?seed={len(name)}", "-o", run, "--no-replan", *fast)
    assert run.exists(), done.stderr
    return run


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    place = tmp_path_factory.mktemp("scene")
    text = TEXT.replace("[needle]", '[[anatomy.curvature]]\nlabel = "target"\nradius_mm = 45.0\n[needle]')
    anatomy = write(place, box(), text)
    table = place / "table.h5"
    assert needleplan("plan", anatomy, "-o", table).returncode == 0
    return anatomy, table


@pytest.mark.slow
@pytest.mark.usefixtures("few_executions")
def test_without_a_hidden_effect_the_path_is_that_of_the_planned_model(
    scene: tuple[Path, Path], tmp_path: Path
) -> None:
    anatomy, table = scene
    lab = twin(tmp_path, "exact", noise=1e-9, tracker=0.0, coil=6.0)
    run = insert(tmp_path, table, lab, "run")
    scenario = SpaceScenario.of(Anatomy.read(anatomy))
    path = insertion_path(recorded_insertion(str(run), scenario), scenario)
    said = simulate(planned_path_model(scenario, [path]).model, path.record.motion()).output
    seen = np.array([path.record[name] for name in ("x_mm", "y_mm", "z_mm")])
    assert np.ptp(seen[0]) > 30
    # The coil is 6 mm behind the tip: without the bend between them, the tip is 0.3 mm off.
    assert np.nanmax(abs(seen - said)) < 0.1


@pytest.mark.slow
@pytest.mark.usefixtures("few_executions")
def test_a_bent_needle_is_named_and_planned_for(
    scene: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    effects = [effect_named(name) for name in ("pre_bend", "curvature_layer", "coil_behind")]
    monkeypatch.setattr(folder, "default_library", lambda model: Library(effects, base_of(model)[0]))  # all take long
    anatomy, table = scene
    lab = twin(tmp_path, "bent", bend=BEND_PER_MM)
    first, second = (insert(tmp_path, table, lab, name) for name in ("a", "bb"))
    third = insert(tmp_path, table, lab, "ccc", 12.0)
    still = tmp_path / "still.mcap"
    assert needleplan("simulate", lab, "-o", still).returncode == 0
    found = tmp_path / "found"
    trials = (first, second, "--holdout", third, "--noise", still, "--rate", 20)
    done = needleplan("diagnose", anatomy, *trials, "-o", found, "--json")
    assert done.returncode == 0, done.stderr + done.stdout
    (effect,) = json.loads((found / "diagnosis.json").read_text())["effects"]
    assert effect["name"] == "pre_bend"
    assert effect["parameters"]["size"]["value"] == pytest.approx(BEND_PER_MM, rel=0.2)
    needle = Anatomy.read(found / "anatomy.toml").file.needle
    assert needle.curvature_radius_mm == pytest.approx(1 / math.hypot(1 / RADIUS_MM, BEND_PER_MM), rel=0.1)
    assert needleplan("plan", found / "anatomy.toml", "-o", found / "again.h5").returncode == 0


def test_other_files_and_options_are_refused(tmp_path: Path) -> None:
    anatomy = write(tmp_path, box())
    done = needleplan("diagnose", anatomy, "data.csv", "--surface", 3, "-o", tmp_path / "found")
    assert done.returncode == 2
    assert "--surface = 3.0: is for models: the model is an anatomy" in done.stderr
    assert "DATA = data.csv: must be a recording (.mcap)" in done.stderr
    assert not (tmp_path / "found").exists()
