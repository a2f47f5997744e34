"""The best plane through an anatomy."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from needleplan.anatomy import FREE, OBSTACLE, TARGET, SpaceScenario
from needleplan.planning import Outcome, best_plane
from needleplan.planning._best_plane import plane_scenario
from needleplan.scenario import Scenario
from tests.anatomy.volumes import TEXT, anatomy, box, write
from tests.cli.commands import needleplan

FINE = TEXT.replace("spacing_mm = 4.0", "spacing_mm = 2.0")


@pytest.fixture(scope="module")
def scenario() -> SpaceScenario:
    return SpaceScenario.of(anatomy(box(), FINE))


@pytest.mark.parametrize("angle", [0.0, 1.0, math.pi / 2, 2.5])
def test_a_plane_shows_what_the_lattice_has_there(scenario: SpaceScenario, angle: float) -> None:
    made = plane_scenario(scenario, angle)
    assert made is not None
    planar, origin, axes, entries = made
    random = np.random.default_rng(3)
    size = (planar.workspace.width_mm, planar.workspace.height_mm)
    points = random.uniform((0, 0), size, (600, 2))
    codes = scenario.codes(origin + points @ axes)
    touched = np.array([any(each.touches(x, y) for each in planar.obstacles) for x, y in points])
    # Pixels are half a spacing wide, so that a point near a border may be on the other side.
    assert np.mean(touched == (codes >= OBSTACLE)) > 0.93
    target = np.hypot(*(points - planar.target.center_mm).T) <= planar.target.radius_mm
    assert np.mean(target == (codes == TARGET)) > 0.95
    for y in entries:
        assert scenario.codes(origin + np.array([0.0, y]) @ axes) == FREE


@pytest.mark.slow
def test_the_best_plane_is_planned_and_its_entry_is_free(scenario: SpaceScenario) -> None:
    plane = best_plane(scenario)
    pose = plane.pose(plane.entry)
    assert scenario.codes(np.array(pose.position_mm)) == FREE
    assert np.linalg.norm(pose.tangent) == pytest.approx(1)
    path = plane.table.path(plane.entry)
    assert path.outcome is Outcome.TARGET
    codes = scenario.codes(plane.origin_mm + path.poses[:, :2] @ plane.axes)
    assert np.isin(codes, (FREE, TARGET)).all()
    assert plane.success > 0.5


@pytest.mark.study
def test_the_command_writes_a_scenario(tmp_path: Path) -> None:
    file = tmp_path / "plane.toml"
    done = needleplan("entry", write(tmp_path, box(), FINE), "--plane-out", file, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["plane"]
    assert 0 < found["success"] <= 1
    assert found["length_mm"] > 20
    assert Scenario.read(file).title.endswith("best plane")
